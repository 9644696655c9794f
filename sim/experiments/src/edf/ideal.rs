//! The best that frames allow: whenever the bus is free, the earliest deadline of all nodes is served.
//!
//! No protocol could do this, for no node knows what waits in the others. Each frame takes the time that it
//! takes under the mapping on identifiers, so only the order differs.

use super::Releases;
use super::message_set::{INTERMISSION_BITS, MessageSet, bits_of};
use super::outcome::{Meter, Run};
use cosmic_core::can::BitRate;
use cosmic_core::network::soft::PriorityMap;
use cosmic_core::time::Instant;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Serves the messages until a deadline is missed, or until `end`.
pub(super) fn run(set: &MessageSet, load: f64, mut releases: Releases, end: Instant) -> Run {
    let timings = set.timings(load);
    let mut meter = Meter::new(timings.len());
    let map = PriorityMap::of(BitRate::MAX);
    let mut waiting = BinaryHeap::new();
    let mut now = Instant::EPOCH;
    while now <= end {
        while let Some((message, count, released_at)) = releases.pop(now, &timings) {
            waiting.push(Reverse((timings[message].deadline_of(released_at), message, count)));
        }
        let Some(Reverse((deadline, message, count))) = waiting.pop() else {
            now = releases.next_at();
            continue;
        };
        let priority = map.priority(deadline.saturating_since(now));
        let bits = bits_of(set.messages[message].frame(count, priority));
        let sent_at = now + BitRate::MAX.bits(bits - INTERMISSION_BITS);
        if sent_at > end {
            break;
        }
        meter.sent(message, bits);
        if sent_at > deadline {
            return meter.missed(&timings);
        }
        now = now + BitRate::MAX.bits(bits);
    }
    meter.all_met(&timings)
}
