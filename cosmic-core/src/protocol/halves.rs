//! Joins the two frames of a binding.

use super::{Answer, Half, SupplyEtag};
use crate::can::TxNode;
use crate::uid::Subject;

/// First halves that wait for their second. When all places are taken, the oldest gives way: its answer
/// is lost, and asked for again.
#[derive(Clone, Debug)]
pub(crate) struct Halves {
    waiting: [Option<SupplyEtag>; Self::PLACES],
    oldest: usize,
}

/// A whole answer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Supply {
    pub(crate) sender: TxNode,
    pub(crate) requester: TxNode,
    pub(crate) subject: Subject,
    pub(crate) answer: Answer,
}

impl Halves {
    /// A sender's two halves follow each other in its queue, so only halves of different senders mix.
    const PLACES: usize = 4;

    pub(crate) const fn new() -> Self {
        Self { waiting: [None; Self::PLACES], oldest: 0 }
    }

    /// The answer that `frame` completes. Constant time.
    pub(crate) fn join(&mut self, frame: SupplyEtag) -> Option<Supply> {
        match frame.half() {
            Half::First => {
                self.keep(frame);
                None
            }
            Half::Second => self.waiting.iter_mut().find_map(|place| {
                let subject = (*place)?.joined(&frame)?;
                *place = None;
                let (sender, requester, answer) = (frame.sender(), frame.requester(), frame.answer());
                Some(Supply { sender, requester, subject, answer })
            }),
        }
    }

    fn keep(&mut self, frame: SupplyEtag) {
        // A first half again, or a new one for the same question, displaces the old.
        let same =
            |kept: &SupplyEtag| (kept.sender(), kept.requester()) == (frame.sender(), frame.requester());
        let at = self.waiting.iter().position(|place| place.as_ref().is_some_and(same));
        let at = at.or_else(|| self.waiting.iter().position(Option::is_none)).unwrap_or_else(|| {
            self.oldest = self.oldest.wrapping_add(1) % Self::PLACES;
            self.oldest
        });
        if let Some(place) = self.waiting.get_mut(at) {
            *place = Some(frame);
        }
    }
}
