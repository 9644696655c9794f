//! A watchdog that is fed while the whole node makes progress, and no longer.
//!
//! A node that hangs must not hang for good. A watchdog that a timer feeds would only prove that the timer runs. Here it
//! is fed when, since it was fed last, the calendar task and the event task have each taken a turn, and each task of the
//! application that is counted has said that it goes on. Turns are asked for, so that a quiet node is a healthy one.
//!
//! Who feeds is a task of the lowest priority: a task above it that never ends starves it, which is how that is found.
//!
//! A node takes part by its types; one that does not has nothing of this in its image:
//!
//! ```ignore
//! static PROGRESS: Progress<2> = Progress::new(); // two tasks of the application are counted
//!
//! impl System for Arm {
//!     type Observer = (&'static Progress<2>, Log);
//!     // ...
//! }
//!
//! #[task(priority = 1, shared = [node])]
//! async fn supervise(cx: supervise::Context, watchdog: Watchdog) {
//!     PROGRESS.supervise(watchdog, PERIOD, cx.shared.node).await
//! }
//!
//! async fn measure(cx: measure::Context) {
//!     loop {
//!         ticker.tick().await;
//!         PROGRESS.made::<0>();
//!         // ...
//!     }
//! }
//! ```
//!
//! A task that waits for events of others must not say so by their coming alone: silence of the bus is no reason for a
//! reset, which would not end it.

use core::sync::atomic::{AtomicU32, Ordering};

use cosmic_core::time::Duration;
use rtic_core::Mutex;

use crate::board::{Board as _, Watchdog};
use crate::node::Node;
use crate::observer::{CalendarObserver, Observer, Observes};
use crate::system::System;

/// Who has made progress since the watchdog was fed: the two tasks of the node, and `TASKS` of the application.
#[derive(Debug)]
pub struct Progress<const TASKS: usize>(AtomicU32);

impl<const TASKS: usize> Progress<TASKS> {
    const ALL: u32 = {
        assert!(TASKS <= MOST_TASKS, "30 tasks of the application at most");
        u32::MAX >> (MOST_TASKS - TASKS)
    };

    /// Nobody has yet.
    pub const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Task `TASK` of the application, from 0 on, goes on.
    #[inline]
    pub fn made<const TASK: usize>(&self) {
        const { assert!(TASK < TASKS, "the number of a task that is counted") };
        self.mark(1 << (OWN_TASKS + TASK));
    }

    /// Feeds the watchdog in each period in which everybody has made progress, for ever. Its time must be longer than
    /// two periods. For a task of the lowest priority.
    pub async fn supervise<T: System>(
        &self,
        mut watchdog: impl Watchdog,
        period: Duration,
        mut node: impl Mutex<T = Node<T>>,
    ) -> ! {
        loop {
            // Whoever sleeps takes a turn.
            node.lock(|node| node.wake_both());
            T::Board::delay_until(T::Board::now() + period).await;
            if self.take_complete() {
                watchdog.feed();
            }
        }
    }

    /// Returns whether everybody has made progress since the last call that returned so.
    fn take_complete(&self) -> bool {
        self.0.compare_exchange(Self::ALL, 0, Ordering::Relaxed, Ordering::Relaxed).is_ok()
    }

    #[inline]
    fn mark(&self, bit: u32) {
        self.0.fetch_or(bit, Ordering::Relaxed);
    }
}

impl<const TASKS: usize> Default for Progress<TASKS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const TASKS: usize> Observer for &'static Progress<TASKS> {
    type Calendar = Self;

    #[inline]
    fn attended(&mut self) {
        self.mark(EVENTS);
    }
}

impl<C, const TASKS: usize> Observes<C> for &'static Progress<TASKS> {}

impl<const TASKS: usize> CalendarObserver for &'static Progress<TASKS> {
    #[inline]
    fn running(&mut self, runs: bool) {
        if !runs {
            self.mark(CALENDAR);
        }
    }
}

const CALENDAR: u32 = 1 << 0;
const EVENTS: u32 = 1 << 1;
const OWN_TASKS: usize = 2;
const MOST_TASKS: usize = 30;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_complete_when_everybody_has_made_progress_since() {
        static PROGRESS: Progress<2> = Progress::new();
        let mut observer = &PROGRESS;
        let mut calendar = &PROGRESS;
        for _ in 0..2 {
            calendar.running(true);
            observer.attended();
            PROGRESS.made::<0>();
            PROGRESS.made::<1>();
            assert!(!PROGRESS.take_complete(), "the calendar task has begun, and not ended");
            calendar.running(false);
            assert!(PROGRESS.take_complete());
            assert!(!PROGRESS.take_complete());
        }
        // What was missing may come later.
        observer.attended();
        calendar.running(false);
        PROGRESS.made::<1>();
        assert!(!PROGRESS.take_complete());
        PROGRESS.made::<0>();
        assert!(PROGRESS.take_complete());
    }

    #[test]
    fn a_node_of_which_no_task_is_counted_is_its_own_two() {
        static PROGRESS: Progress<0> = Progress::new();
        let mut observer = &PROGRESS;
        let mut calendar = &PROGRESS;
        calendar.running(false);
        assert!(!PROGRESS.take_complete());
        observer.attended();
        assert!(PROGRESS.take_complete());
    }
}
