//! A question that is answered step by step, so that no call takes long: the test, and if it fails, the search for what
//! would fit.

use super::demand::{Demand, Walk};
use super::{Ask, NotAdmitted, Objection};
use crate::time::Duration;

/// A question that is being answered; see [`Admission::begin`](super::Admission::begin).
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    ask: Ask,
    walk: Walk,
    search: Option<Search>,
}

/// The search for the shortest longer interval at which a channel fits that was refused.
#[derive(Clone, Copy, Debug)]
struct Search {
    why: Objection,
    /// The longest interval that was refused.
    refused: u64,
    /// The one that is looked at.
    candidate: u64,
    /// The shortest that fits.
    fits: Option<u64>,
    doublings: u8,
    halvings: u8,
}

impl Trial {
    pub(super) fn new(ask: &Ask) -> Self {
        Self { ask: *ask, walk: Walk::default(), search: None }
    }

    /// What is asked for.
    pub const fn ask(&self) -> &Ask {
        &self.ask
    }

    /// Goes on by so many points; `None`: not decided yet.
    pub(super) fn advance(&mut self, demand: &Demand<'_>, points: u16) -> Option<Result<(), NotAdmitted>> {
        let Some(search) = &mut self.search else {
            return match demand.advance(&self.ask, &mut self.walk, points)? {
                Ok(()) => Some(Ok(())),
                Err(why) => self.refuse(why),
            };
        };
        let interval = Duration::from_ticks(search.candidate);
        let fits = match self.ask.rate.with_interval(interval) {
            Some(rate) => demand.advance(&Ask { rate, ..self.ask }, &mut self.walk, points)?.is_ok(),
            None => false,
        };
        self.walk = Walk::default();
        search.next(fits).map(Err)
    }

    fn refuse(&mut self, why: Objection) -> Option<Result<(), NotAdmitted>> {
        // A longer interval is of no use.
        if why == Objection::Blocking {
            return Some(Err(NotAdmitted { why, fits_at: None }));
        }
        let refused = self.ask.rate.interval().as_ticks();
        let candidate = refused.saturating_mul(2);
        self.search =
            Some(Search { why, refused, candidate, fits: None, doublings: DOUBLINGS, halvings: HALVINGS });
        self.walk = Walk::default();
        None
    }
}

impl Search {
    /// The candidate fits or not. Chooses the next; or this is the end, and the answer.
    fn next(&mut self, fits: bool) -> Option<NotAdmitted> {
        if fits {
            self.fits = Some(self.candidate);
        } else {
            self.refused = self.candidate;
        }
        match self.fits {
            Some(fits) if self.halvings > 0 => {
                self.halvings = self.halvings.saturating_sub(1);
                self.candidate = self.refused.midpoint(fits);
            }
            None if self.doublings > 1 => {
                self.doublings = self.doublings.saturating_sub(1);
                self.candidate = self.refused.saturating_mul(2);
            }
            found => {
                return Some(NotAdmitted { why: self.why, fits_at: found.map(Duration::from_ticks) });
            }
        }
        None
    }
}

/// How often the interval is doubled to find one that fits.
pub(super) const DOUBLINGS: u8 = 6;

/// How often the span between one that fits and one that does not is halved.
pub(super) const HALVINGS: u8 = 3;
