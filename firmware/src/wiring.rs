//! Which frames a node receives, and where they go.

use boards::bxcan_rx::{AcceptanceFilter, RxFifo};

/// The acceptance filters of a node that takes everything: hard real-time frames into the urgent FIFO,
/// all others into the other one. No two overlap.
pub const FILTERS: [AcceptanceFilter; 9] = {
    let hard = AcceptanceFilter { fifo: RxFifo::Urgent, id: 0, mask: PRIORITY };
    let mut filters = [hard; 9];
    // A priority other than 0 has at least one of its eight bits set.
    let mut bit = 0;
    while bit < 8 {
        let set = 1 << (PRIORITY_SHIFT + bit);
        filters[bit + 1] = AcceptanceFilter { fifo: RxFifo::Other, id: set, mask: set };
        bit += 1;
    }
    filters
};

const PRIORITY_SHIFT: usize = 21;
const PRIORITY: u32 = 0xFF << PRIORITY_SHIFT;
