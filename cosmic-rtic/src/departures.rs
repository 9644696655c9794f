//! Who waits until a frame has left the node.

use core::task::Waker;

/// Tasks that wait until a non real-time frame has left the node.
#[derive(Debug)]
pub(crate) struct Departures {
    wakers: [Option<Waker>; TASKS],
}

impl Departures {
    pub(crate) const NOBODY: Self = Self { wakers: [const { None }; TASKS] };

    /// The task is woken by the next departure.
    pub(crate) fn register(&mut self, waker: &Waker) {
        if self.wakers.iter().flatten().any(|other| other.will_wake(waker)) {
            return;
        }
        match self.wakers.iter_mut().find(|place| place.is_none()) {
            Some(place) => *place = Some(waker.clone()),
            // It looks again at once.
            None => waker.wake_by_ref(),
        }
    }

    /// A frame has left: they look whether it was theirs.
    pub(crate) fn wake(&mut self) {
        self.wakers.iter_mut().filter_map(Option::take).for_each(Waker::wake);
    }
}

/// So many tasks of a node sleep while they send messages. Further ones look again and again.
const TASKS: usize = 4;
