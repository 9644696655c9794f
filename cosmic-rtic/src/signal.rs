//! A signal that wakes one task.
//!
//! That of `rtic-sync` can carry a value, and is not all zero at the start: a static that has one in it would be copied
//! from flash as a whole.

use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Poll;

use rtic_common::waker_registration::CriticalSectionWakerRegistration;

/// Raised or not. One task waits for it.
pub(crate) struct Signal {
    raised: AtomicBool,
    waker: CriticalSectionWakerRegistration,
}

impl Signal {
    /// Not raised.
    pub(crate) const fn new() -> Self {
        Self { raised: AtomicBool::new(false), waker: CriticalSectionWakerRegistration::new() }
    }

    /// Raises it, and wakes who waits for it.
    #[inline]
    pub(crate) fn raise(&self) {
        self.raised.store(true, Ordering::Release);
        self.waker.wake();
    }

    /// Waits until it is raised, and takes it back.
    pub(crate) fn wait(&self) -> impl Future<Output = ()> {
        poll_fn(|context| {
            // First the waker, or one that is raised in between wakes nobody.
            self.waker.register(context.waker());
            if self.raised.swap(false, Ordering::Acquire) { Poll::Ready(()) } else { Poll::Pending }
        })
    }
}
