//! A signal that wakes one task, and says what for.
//!
//! That of `rtic-sync` can carry a value, and is not all zero at the start: a static that has one in it would be copied
//! from flash as a whole. The waker stays where it is: a task of RTIC has the same one all its life.

use core::cell::UnsafeCell;
use core::future::poll_fn;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::{Poll, Waker};

/// What was raised and not taken yet, a bit for each cause. One task waits for it.
pub(crate) struct Signal {
    /// Written in critical sections only.
    raised: AtomicU32,
    waker: UnsafeCell<Option<Waker>>,
}

// SAFETY: the waker is reached in critical sections only.
unsafe impl Sync for Signal {}

impl Signal {
    /// Nothing is raised.
    pub(crate) const fn new() -> Self {
        Self { raised: AtomicU32::new(0), waker: UnsafeCell::new(None) }
    }

    /// Raises these bits, and wakes who waits for any.
    #[inline]
    pub(crate) fn raise(&self, bits: u32) {
        critical_section::with(|_| {
            let before = self.raised.load(Ordering::Relaxed);
            self.raised.store(before | bits, Ordering::Relaxed);
            // Otherwise whoever raised the first has woken the task.
            if before == 0
                // SAFETY: in a critical section; a waker does not come back here.
                && let Some(waker) = unsafe { &*self.waker.get() }
            {
                waker.wake_by_ref();
            }
        });
    }

    /// The bits that were raised since the last call.
    #[inline]
    pub(crate) fn take(&self) -> u32 {
        if self.raised.load(Ordering::Relaxed) == 0 {
            return 0;
        }
        critical_section::with(|_| {
            let bits = self.raised.load(Ordering::Relaxed);
            self.raised.store(0, Ordering::Relaxed);
            bits
        })
    }

    /// Takes the bits that are raised. If there are none, the next wake this task.
    #[inline]
    pub(crate) fn poll(&self, waker: &Waker) -> Poll<u32> {
        let mut bits = self.take();
        if bits == 0 && self.register(waker) {
            // What was raised in between has woken nobody.
            bits = self.take();
        }
        if bits == 0 { Poll::Pending } else { Poll::Ready(bits) }
    }

    /// Waits until something is raised, and takes it.
    pub(crate) fn wait(&self) -> impl Future<Output = ()> {
        poll_fn(|context| self.poll(context.waker()).map(|_| ()))
    }

    /// Returns whether the task was not the one that is woken already.
    #[inline]
    fn register(&self, waker: &Waker) -> bool {
        critical_section::with(|_| {
            // SAFETY: in a critical section; to clone or to drop a waker does not come back here.
            let place = unsafe { &mut *self.waker.get() };
            let is_new = !place.as_ref().is_some_and(|there| there.will_wake(waker));
            if is_new {
                *place = Some(waker.clone());
            }
            is_new
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::task::Wake;

    #[derive(Default)]
    struct Woken(AtomicU32);

    impl Wake for Woken {
        fn wake(self: Arc<Self>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn it_wakes_once_until_its_bits_are_taken() {
        let (signal, woken) = (Signal::new(), Arc::new(Woken::default()));
        let waker = Waker::from(Arc::clone(&woken));
        let times = || woken.0.load(Ordering::Relaxed);
        // Before anybody waits.
        signal.raise(4);
        assert_eq!(signal.poll(&waker), Poll::Ready(4));
        for turn in 1..3 {
            assert_eq!(signal.poll(&waker), Poll::Pending);
            signal.raise(1);
            signal.raise(2);
            assert_eq!(times(), turn);
            assert_eq!(signal.poll(&waker), Poll::Ready(3));
        }
        // The bits are gone, and another task may wait.
        let other = Arc::new(Woken::default());
        assert_eq!(signal.poll(&Waker::from(Arc::clone(&other))), Poll::Pending);
        signal.raise(1);
        assert_eq!((times(), other.0.load(Ordering::Relaxed)), (2, 1));
    }
}
