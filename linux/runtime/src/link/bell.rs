//! How a link learns that there is something to send.
//!
//! Its task is woken. That takes a change of tasks, often of threads, for each frame, and one more for its outcome: far
//! more than the frame itself. So a link that can write without waiting leaves its writing end here, and whoever makes a
//! frame due writes it in the same breath.

use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use super::{End, Handover};

/// The writing end of a link. Never waits: what it cannot write at once it keeps, and tells the link's task.
pub(crate) trait Outgoing: Send {
    /// There may be something to send. Takes no more than it can write, or keep.
    fn send(&mut self, due: &mut dyn FnMut() -> Option<Handover>);
}

/// Rung whenever there is something to send.
#[derive(Default)]
pub(crate) struct Bell {
    /// Wakes the task of a link that has left nothing here.
    task: Notify,
    /// Held while it writes, so that nothing is handed over any more once a link has taken it away.
    outgoing: Mutex<Option<Box<dyn Outgoing>>>,
}

impl Bell {
    /// There may be something to send. Called without a lock of the end. Work: what the link can take at once, no more
    /// than one frame and one withdrawal of each class.
    pub(crate) fn ring(&self, end: &dyn End) {
        match &mut *self.outgoing() {
            Some(outgoing) => outgoing.send(&mut || end.hand_over(true)),
            None => self.task.notify_one(),
        }
    }

    /// Waits until it is rung, and nobody writes at once.
    pub(crate) async fn rung(&self) {
        self.task.notified().await;
    }

    /// From now on this writes. Taken away when what is returned is dropped.
    pub(super) fn leave(&self, outgoing: Box<dyn Outgoing>) -> Left<'_> {
        *self.outgoing() = Some(outgoing);
        Left(self)
    }

    fn outgoing(&self) -> MutexGuard<'_, Option<Box<dyn Outgoing>>> {
        // Whoever panicked did so in the core, which does not; the writing end is as it was.
        self.outgoing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// While it is held, whoever makes a frame due writes it.
pub(super) struct Left<'a>(&'a Bell);

impl Drop for Left<'_> {
    fn drop(&mut self) {
        *self.0.outgoing() = None;
    }
}
