//! What goes away leaves nothing: the short form of `cargo xtask experiment gateway memory`.

use cosmic_gateway_bench::churn::{FORGOTTEN, Who, measure};
use cosmic_gateway_bench::cost::COUNTING;
use stats_alloc::StatsAlloc;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<std::alloc::System> = COUNTING;

#[test]
fn subjects_that_went_away_leave_nothing_of_ours() {
    let ways = [Who::OnSegment, Who::Staying, Who::StayingAlone];
    let found = measure(200, &ways, FORGOTTEN).unwrap();
    // The least leak, of a key or a channel for each, is some hundred bytes.
    assert!(found.broken().is_empty(), "{found}");
}
