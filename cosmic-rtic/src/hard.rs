//! The HRT message buffers, which the two halves of a node share.

use core::cell::UnsafeCell;

use cosmic_core::HardAccess;

/// Where they are: part of the node's [`Storage`](crate::Storage).
pub(crate) struct HardCell<B>(UnsafeCell<B>);

// SAFETY: after construction the content is reached by `Hard::with` only, inside a critical section, so no
// two contexts are in it at once. Nor does one context enter it twice: see there.
unsafe impl<B: Send> Sync for HardCell<B> {}

impl<B> HardCell<B> {
    pub(crate) const fn new(buffers: B) -> Self {
        Self(UnsafeCell::new(buffers))
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
    pub(crate) const fn new(cell: &'static HardCell<B>) -> Self {
        Self(cell)
    }
}

impl<B: Send> HardAccess<B> for Hard<B> {
    #[inline]
    fn with<R>(&mut self, access: impl FnOnce(&mut B) -> R) -> R {
        // SAFETY: the critical section keeps all other contexts out. In this one, `access` comes from the core or
        // from this crate: neither holds a second `Hard` in it, and nobody else is handed one.
        critical_section::with(|_| access(unsafe { &mut *self.0.0.get() }))
    }
}
