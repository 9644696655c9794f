//! Admission at run time: whether a soft real-time channel that the plan does not know still fits.
//!
//! The plan proves that the channels it knows keep their deadlines. A further one may break that proof, so it is
//! *asked for* before it is published: [`Admission`] holds what the plan [reserves](Reservations) and what it has
//! admitted besides, and answers by a test that is *safe*: whatever it admits, the planner's analysis of the same set
//! accepts. What it refuses, it says why, and at which longer interval the channel would fit.
//!
//! # The test
//! Let Δ = Δt_p + reload. The analysis (`cosmic-plan`, `analysis::soft`) bounds the response of channel i by a least
//! solution of `s = B + work(s, X) − C_i + others(s)`, for each X = a + D_i + Δ at which the work with deadlines before X
//! grows. So it suffices that
//!
//! ```text
//! demand(X) = B + Σ_j min(⌈(X − Δ + J_j) / T_j⌉, ⌈(X − D_j + J_j) / T_j⌉) C_j + others(X − Δ) ≤ X − Δ
//! ```
//!
//! for each such X from the earliest deadline on: then `X − Δ − C_i` is not less than that solution. The test walks
//! from one X to the next, until the straight line above `demand` is below `X − Δ`; from there on it stays below, since
//! all together take no more than the whole bus. It gives up, and refuses, after [`Admission::MOST_POINTS`]: a set that
//! needs more is close to the limit.
//!
//! Channels with deadlines of 248 Δt_p and more are not in the order of deadlines before that time; for them it
//! suffices that all that can be pending then is sent within 248 Δt_p.

mod control;
mod demand;
mod plan;
mod reservations;
mod timing;
mod trial;

pub use control::{AdmissionControl, AdmissionCounters};
pub use plan::{AdmissionPlan, Offer, PlannedPublication, Unplanned};
pub use reservations::{CalendarDemand, Faults, Guarded, Load, Reservations, SoftLoad};
pub use timing::AdmissionTiming;
pub use trial::Trial;

use crate::can::{Etag, TxNode};
use crate::event_layer::EventRate;
use crate::time::{Duration, Instant};
use crate::uid::Subject;
use demand::Demand;

/// A channel that a node asks for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Ask {
    /// Who will publish.
    pub tx_node: TxNode,
    /// The channel, which is bound before it is asked for.
    pub etag: Etag,
    /// How often.
    pub rate: EventRate,
    /// From publication until an event is to be sent.
    pub deadline: Duration,
    /// Bytes of an event at most.
    pub len: u8,
}

/// Why a channel is not admitted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Objection {
    /// All channels together would take more than the bus has, or so nearly that it cannot be told.
    Utilisation,
    /// The deadline is too short for what can be before it on the bus, whatever the rate; or zero.
    Blocking,
    /// The channel itself might be late.
    Late,
    /// This channel might be late.
    Suffers(OtherChannel),
    /// A non real-time or foreign frame with a deadline might be late, which is planned.
    LessUrgent(u16),
    /// As many channels are admitted as there is room for.
    Full,
}

/// A soft real-time channel that is on the segment already.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum OtherChannel {
    /// It is planned.
    Planned(Subject),
    /// It was admitted before.
    Admitted(Etag),
}

/// A channel is not admitted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NotAdmitted {
    /// Why.
    pub why: Objection,
    /// At this longer interval, with all else as it was asked for, it would be admitted now.
    pub fits_at: Option<Duration>,
}

/// A channel that was admitted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Admitted {
    /// What was asked for.
    pub ask: Ask,
    /// Until when it holds, if it is not asked for again before.
    pub expires_at: Instant,
}

/// What is on a segment: what its plan reserves, and up to `N` channels that were admitted besides.
#[derive(Clone, Debug)]
pub struct Admission<'a, const N: usize> {
    reservations: &'a Reservations<'a>,
    admitted: [Option<Admitted>; N],
}

impl<'a, const N: usize> Admission<'a, N> {
    /// How many points of time a test looks at, at most.
    pub const MOST_POINTS: u16 = 256;

    /// How many tests an answer takes, at most: one, and those for what would fit.
    pub const MOST_TESTS: u8 = 1 + trial::DOUBLINGS + trial::HALVINGS;

    /// Nothing is admitted yet.
    pub const fn new(reservations: &'a Reservations<'a>) -> Self {
        Self { reservations, admitted: [None; N] }
    }

    /// What is admitted.
    pub fn admitted(&self) -> impl Iterator<Item = &Admitted> {
        self.admitted.iter().flatten()
    }

    /// Admits a channel for this long, or says why not. One that was admitted and is asked for again, as it was, goes on
    /// without a test: who was there first does not lose to who came later.
    ///
    /// O([`MOST_TESTS`](Self::MOST_TESTS) · [`MOST_POINTS`](Self::MOST_POINTS) · all channels). For less in one call, use
    /// [`begin`](Self::begin) and [`step`](Self::step).
    ///
    /// # Errors
    /// [`NotAdmitted`]; what was admitted to this node on this channel before goes on as it was.
    pub fn ask(&mut self, now: Instant, ask: &Ask, lease: Duration) -> Result<(), NotAdmitted> {
        if self.renew(now, ask, lease) {
            return Ok(());
        }
        let mut trial = self.begin(ask);
        loop {
            if let Some(answer) = self.step(&mut trial, now, lease, Self::MOST_POINTS) {
                return answer;
            }
        }
    }

    /// Lets a channel go on for this long, if it was admitted exactly as it is asked for now. Returns whether it was. O(`N`).
    pub fn renew(&mut self, now: Instant, ask: &Ask, lease: Duration) -> bool {
        self.expire(now);
        let place = self.position(ask.tx_node, ask.etag).and_then(|at| self.admitted.get_mut(at));
        let same = place.and_then(Option::as_mut).filter(|known| known.ask == *ask);
        same.map(|known| known.expires_at = now + lease).is_some()
    }

    /// Begins to answer a question. Others may be withdrawn or expire meanwhile, but only one may be answered at a time.
    pub fn begin(&self, ask: &Ask) -> Trial {
        Trial::new(ask)
    }

    /// Goes on to answer a question; `None`: not decided yet. O(`points` · all channels), and it is decided after
    /// [`MOST_TESTS`](Self::MOST_TESTS) · [`MOST_POINTS`](Self::MOST_POINTS) points.
    ///
    /// The answer may be an error, as of [`ask`](Self::ask).
    pub fn step(
        &mut self,
        trial: &mut Trial,
        now: Instant,
        lease: Duration,
        points: u16,
    ) -> Option<Result<(), NotAdmitted>> {
        self.expire(now);
        let ask = *trial.ask();
        let known = self.position(ask.tx_node, ask.etag);
        let full = Err(NotAdmitted { why: Objection::Full, fits_at: None });
        if known.is_none() && !self.admitted.iter().any(Option::is_none) {
            return Some(full);
        }
        let decided = trial.advance(&Demand::new(self.reservations, &self.admitted, known), points)?;
        Some(decided.and_then(|()| self.enter(known, &ask, now + lease).or(full)))
    }

    /// How many channels a point is about, in [`step`](Self::step).
    pub fn channels(&self) -> usize {
        let reserved = self.reservations.soft.len().saturating_add(self.reservations.above.len());
        self.admitted().count().saturating_add(reserved).saturating_add(1)
    }

    /// The node does not publish on the channel any more. Returns whether it was admitted. O(`N`).
    pub fn withdraw(&mut self, tx_node: TxNode, etag: Etag) -> bool {
        let place = self.position(tx_node, etag).and_then(|at| self.admitted.get_mut(at));
        place.is_some_and(|place| place.take().is_some())
    }

    /// Withdraws all of a node. O(`N`).
    pub fn withdraw_all(&mut self, tx_node: TxNode) {
        for place in &mut self.admitted {
            place.take_if(|admitted| admitted.ask.tx_node == tx_node);
        }
    }

    /// Ends everything. O(`N`).
    pub fn clear(&mut self) {
        self.admitted = [None; N];
    }

    /// Ends what was not asked for again. O(`N`).
    pub fn expire(&mut self, now: Instant) {
        for place in &mut self.admitted {
            place.take_if(|admitted| now >= admitted.expires_at);
        }
    }

    /// When [`expire`](Self::expire) has something to do. O(`N`).
    pub fn next_wakeup(&self) -> Instant {
        self.admitted().map(|admitted| admitted.expires_at).fold(Instant::FAR_FUTURE, Instant::min)
    }

    fn enter(&mut self, known: Option<usize>, ask: &Ask, expires_at: Instant) -> Result<(), Objection> {
        let at = known.or_else(|| self.admitted.iter().position(Option::is_none)).ok_or(Objection::Full)?;
        *self.admitted.get_mut(at).ok_or(Objection::Full)? = Some(Admitted { ask: *ask, expires_at });
        Ok(())
    }

    fn position(&self, tx_node: TxNode, etag: Etag) -> Option<usize> {
        let is_it = |place: &Option<Admitted>| {
            place.is_some_and(|it| (it.ask.tx_node, it.ask.etag) == (tx_node, etag))
        };
        self.admitted.iter().position(is_it)
    }
}
