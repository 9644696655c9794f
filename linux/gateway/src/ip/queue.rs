//! Events that wait for a subscriber.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use cosmic_core::event_layer::Policy;
use cosmic_core::time::Instant;
use tokio::sync::Notify;
use tokio::sync::futures::Notified;

use super::Received;

pub(super) struct Queue {
    policy: Policy,
    events: Mutex<VecDeque<Received<Vec<u8>>>>,
    told: Notify,
}

impl Queue {
    pub(super) const fn new(policy: Policy) -> Self {
        Self { policy, events: Mutex::new(VecDeque::new()), told: Notify::const_new() }
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Received<Vec<u8>>>> {
        self.events.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues an event by the policy. Returns whether there was room.
    pub(super) fn push(&self, event: Received<Vec<u8>>) -> bool {
        let mut events = self.lock();
        let fits = match self.policy {
            Policy::Latest => {
                events.clear();
                events.push_back(event);
                true
            }
            Policy::Fifo(depth) | Policy::DeadlineOrder(depth)
                if events.len() >= usize::from(depth.get()) =>
            {
                false
            }
            Policy::Fifo(_) => {
                events.push_back(event);
                true
            }
            Policy::DeadlineOrder(_) => {
                let key = |event: &Received<Vec<u8>>| event.deadline.unwrap_or(Instant::FAR_FUTURE);
                let at = events.partition_point(|other| key(other) <= key(&event));
                events.insert(at, event);
                true
            }
        };
        drop(events);
        self.told.notify_one();
        fits
    }

    pub(super) fn pop(&self) -> Option<Received<Vec<u8>>> {
        self.lock().pop_front()
    }

    pub(super) fn told(&self) -> Notified<'_> {
        self.told.notified()
    }
}
