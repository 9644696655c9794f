//! Keeps what contradicts the plan from the services of a node, and tells of it.

use super::judge::Verdict;
use super::{Contradiction, Seal};
use crate::can::{Frame, Id, TxNode};
use crate::event_layer::ExceptionKind;
use crate::time::{Duration, Instant};

/// A frame that was refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Refusal {
    /// Why.
    pub contradiction: Contradiction,
    /// Its identifier, in which its sender claims to be somebody.
    pub id: Id,
    /// When it came.
    pub at: Instant,
}

/// What a sealed node has refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Refusals {
    counts: [u32; Contradiction::ALL.len()],
    /// Frames that may have been true, and were not believed: *leaving*, withdrawn interest, released ids. Wraps.
    pub ignored: u32,
    /// The last one.
    pub last: Option<Refusal>,
}

impl Refusals {
    /// How many frames were refused for this. Wraps.
    pub fn count(&self, contradiction: Contradiction) -> u32 {
        self.counts.get(contradiction as usize).copied().unwrap_or(0)
    }
}

/// The seal of a node, and what was refused because of it.
#[derive(Clone, Debug)]
pub(crate) struct Warden {
    seal: &'static Seal,
    refusals: Refusals,
    /// What is to be told, and when that which was told last, or is to be, happened.
    untold: [bool; Contradiction::ALL.len()],
    told_at: [Option<Instant>; Contradiction::ALL.len()],
}

impl Warden {
    pub(crate) const fn new(seal: &'static Seal) -> Self {
        const KINDS: usize = Contradiction::ALL.len();
        Self {
            seal,
            refusals: Refusals { counts: [0; KINDS], ignored: 0, last: None },
            untold: [false; KINDS],
            told_at: [None; KINDS],
        }
    }

    pub(crate) const fn seal(&self) -> &'static Seal {
        self.seal
    }

    pub(crate) const fn refusals(&self) -> &Refusals {
        &self.refusals
    }

    /// Returns whether the services are to hear of a control frame. O(nodes + channels) of the plan.
    pub(crate) fn admits(&mut self, frame: &Frame, at: Instant, own: Option<TxNode>) -> bool {
        match self.seal.judge(frame, own) {
            Verdict::Believed => true,
            Verdict::Ignored => {
                self.refusals.ignored = self.refusals.ignored.wrapping_add(1);
                false
            }
            Verdict::Refused(contradiction) => {
                self.refuse(contradiction, frame.id, at);
                false
            }
        }
    }

    /// Counts a contradiction, and has it told, unless one of its kind was just told.
    pub(crate) fn refuse(&mut self, contradiction: Contradiction, id: Id, at: Instant) {
        let kind = contradiction as usize;
        if let Some(count) = self.refusals.counts.get_mut(kind) {
            *count = count.wrapping_add(1);
        }
        self.refusals.last = Some(Refusal { contradiction, id, at });
        let (Some(untold), Some(told_at)) = (self.untold.get_mut(kind), self.told_at.get_mut(kind)) else {
            return;
        };
        // Far from it in either direction: a clock that was set back silences nobody.
        if told_at.is_none_or(|told| at.signed_since(told).unsigned_abs() >= TOLD_EVERY.as_ticks()) {
            (*untold, *told_at) = (true, Some(at));
        }
    }

    /// What the application is to be told now; call until it returns `None`.
    pub(crate) fn take(&mut self) -> Option<ExceptionKind> {
        let kind = self.untold.iter().position(|untold| *untold)?;
        *self.untold.get_mut(kind)? = false;
        Contradiction::ALL.get(kind).map(|contradiction| contradiction.exception())
    }
}

/// Between two exceptions of one kind.
const TOLD_EVERY: Duration = Duration::from_secs(1);
