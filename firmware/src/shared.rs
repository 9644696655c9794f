//! The HRT message buffers, which the two halves of the node share.

use core::cell::UnsafeCell;

use cosmic_core::HardAccess;
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::time::GlobalClock;

use crate::node::Buffers;

/// The buffers of the node: there is one on a chip.
static BUFFERS: Cell = Cell(UnsafeCell::new(HrtBuffers::new(GlobalClock::unsynchronised())));

struct Cell(UnsafeCell<Buffers>);

// SAFETY: `Locked::with` is the only access. It turns interrupts off, and the core has one processor, so
// no two accesses overlap; the core's closures do not call it again.
unsafe impl Sync for Cell {}

/// Access with interrupts off, for the time of one copy.
#[derive(Clone, Copy)]
pub struct Locked;

impl HardAccess<Buffers> for Locked {
    #[inline]
    fn with<R>(&mut self, access: impl FnOnce(&mut Buffers) -> R) -> R {
        // SAFETY: as for `Sync`.
        cortex_m::interrupt::free(|_| access(unsafe { &mut *BUFFERS.0.get() }))
    }
}
