//! An instant that one task waits for, by a compare channel of its own: that of the calendar.
//!
//! The queue of the others is a list behind a critical section, and who comes from it has to look twice. From the timer to
//! the calendar task that would be most of the way.

use core::future::poll_fn;
use core::pin::pin;
use core::task::Poll;

use rtic_common::waker_registration::CriticalSectionWakerRegistration;

/// The task that waits.
pub(crate) struct Alarm {
    waker: CriticalSectionWakerRegistration,
}

/// The compare channel, and the clock that it compares.
pub(crate) trait Compare {
    /// Local time.
    fn ticks() -> u64;
    /// Interrupts at the instant with these low bits from now on, once in a turn of the counter.
    fn set(low: u32);
}

impl Alarm {
    pub(crate) const fn new() -> Self {
        Self { waker: CriticalSectionWakerRegistration::new() }
    }

    /// Waits until `instant` or until `other` has ended. One task at a time: two would wake each other in turns.
    #[inline]
    pub(crate) async fn until<C: Compare>(&self, instant: u64, other: impl Future<Output = ()>) {
        let mut other = pin!(other);
        let mut is_set = false;
        poll_fn(|context| {
            // It is the more urgent one, and costs less to look at.
            if C::ticks() >= instant {
                return Poll::Ready(());
            }
            // Each time, since who rings takes the waker, and it rings in each turn of the counter.
            self.waker.register(context.waker());
            if !is_set {
                is_set = true;
                C::set(instant as u32);
            }
            // It may have passed before it was set.
            if C::ticks() >= instant {
                return Poll::Ready(());
            }
            other.as_mut().poll(context)
        })
        .await;
    }

    /// For the interrupt: the instant may have come.
    #[inline]
    pub(crate) fn ring(&self) {
        self.waker.wake();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::sync::atomic::{AtomicU64, Ordering};
    use core::task::{Context, Waker};
    use std::sync::Arc;
    use std::task::Wake;

    static NOW: AtomicU64 = AtomicU64::new(0);
    static SET: AtomicU64 = AtomicU64::new(0);

    struct Timer;

    impl Compare for Timer {
        fn ticks() -> u64 {
            NOW.load(Ordering::Relaxed)
        }

        fn set(low: u32) {
            SET.store(low.into(), Ordering::Relaxed);
        }
    }

    #[derive(Default)]
    struct Woken(AtomicU64);

    impl Wake for Woken {
        fn wake(self: Arc<Self>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn it_rings_at_the_instant_and_not_a_turn_of_the_counter_before() {
        let (alarm, woken) = (Alarm::new(), Arc::new(Woken::default()));
        let waker = Waker::from(Arc::clone(&woken));
        let mut context = Context::from_waker(&waker);
        let instant = (1 << 32) + 5;
        let mut waiting = pin!(alarm.until::<Timer>(instant, core::future::pending()));
        assert!(waiting.as_mut().poll(&mut context).is_pending());
        assert_eq!(SET.load(Ordering::Relaxed), 5);
        for (now, is_there) in [(5, false), (instant, true)] {
            NOW.store(now, Ordering::Relaxed);
            let before = woken.0.load(Ordering::Relaxed);
            alarm.ring();
            assert_eq!(woken.0.load(Ordering::Relaxed), before + 1);
            assert_eq!(waiting.as_mut().poll(&mut context).is_ready(), is_there);
        }
        // What has passed is not waited for, and what else was waited for ends it, too.
        let mut passed = pin!(alarm.until::<Timer>(7, core::future::pending()));
        assert!(passed.as_mut().poll(&mut context).is_ready());
        let mut ended = pin!(alarm.until::<Timer>(u64::MAX, core::future::ready(())));
        assert!(ended.as_mut().poll(&mut context).is_ready());
    }
}
