//! The HRT message buffers, which the two halves of a node share.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use cosmic_core::HardAccess;

/// Where they are: part of the node's [`Storage`](crate::Storage). They come there at the start only: initial values of a
/// static that are not all zero would be kept in flash, with the queues beside them.
pub(crate) struct HardCell<B>(UnsafeCell<MaybeUninit<B>>);

// SAFETY: after construction the content is reached by `Hard::with` only, inside a critical section, so no
// two contexts are in it at once. Nor does one context enter it twice: see there.
unsafe impl<B: Send> Sync for HardCell<B> {}

impl<B> HardCell<B> {
    /// A place without buffers.
    pub(crate) const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// The buffers, in their place. Once, since it borrows that for good.
    pub(crate) fn start(&'static mut self, buffers: B) -> &'static Self {
        self.0.get_mut().write(buffers);
        self
    }
}

/// Access to the HRT message buffers, in a critical section for the time of one call of the core. Nobody can make
/// or copy one but the runtime.
///
/// What the core does there is bounded: it copies at most one event and a dozen words of state, or looks through
/// the node's slots when a channel is announced, subscribed to or given up. So the calendar task, whose instants
/// a critical section delays, waits no longer than that. The other way round it makes no difference that the
/// calendar task itself enters it, since nothing runs above that task.
pub struct Hard<B: 'static>(&'static HardCell<B>);

impl<B> Hard<B> {
    /// Of buffers that were [started](HardCell::start).
    pub(crate) const fn new(cell: &'static HardCell<B>) -> Self {
        Self(cell)
    }
}

impl<B: Send> HardAccess<B> for Hard<B> {
    #[inline]
    fn with<R>(&mut self, access: impl FnOnce(&mut B) -> R) -> R {
        // SAFETY: the buffers are there, since whoever has a shared reference to the cell got it from `start`. The critical
        // section keeps all other contexts out. In this one, `access` comes from the core or
        // from this crate: neither holds a second `Hard` in it, and nobody else is handed one.
        critical_section::with(|_| access(unsafe { (*self.0.0.get()).assume_init_mut() }))
    }
}
