//! What the plan of a cluster says of soft real-time channels beside it: constants of `cosmic-plan`.

use super::Reservations;
use crate::event_layer::{AnnounceError, EventRate, Gate};
use crate::services::Declaration;
use crate::time::Duration;
use crate::uid::{NodeUid, Subject};

/// What becomes of a soft real-time channel that a node announces and the plan does not know.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Unplanned {
    /// The node asks the broker's node, and publishes when that has admitted it.
    Ask,
    /// It cannot be announced.
    Refuse,
    /// Its events are sent as non real-time ones, of the least importance: they hold up no deadline.
    NonRealTime,
}

/// A soft real-time channel at a node that publishes it by the plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PlannedPublication {
    /// The node.
    pub publisher: NodeUid,
    /// The channel.
    pub subject: Subject,
    /// How often.
    pub rate: EventRate,
    /// From publication until an event is to be sent.
    pub deadline: Duration,
    /// Bytes of an event at most.
    pub len: u8,
}

/// What a soft real-time channel that is announced is to be.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Offer {
    /// How often events come, if that is stated.
    pub rate: Option<EventRate>,
    /// From publication until an event is to be sent.
    pub deadline: Duration,
    /// Bytes of an event at most.
    pub len: usize,
}

/// What the plan of a cluster says of soft real-time channels.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AdmissionPlan {
    /// What becomes of those that it does not know.
    pub unplanned: Unplanned,
    /// Those that it knows.
    pub planned: &'static [PlannedPublication],
    /// What is on the segment by plan.
    pub reservations: Reservations<'static>,
}

impl AdmissionPlan {
    /// Returns whether the plan has this node publish on this channel, at least so often, with a deadline at most as late
    /// and events at least as long. O(planned publications).
    pub fn covers(&self, publisher: NodeUid, subject: Subject, offer: &Offer) -> bool {
        let is_it =
            |planned: &&PlannedPublication| (planned.publisher, planned.subject) == (publisher, subject);
        self.planned.iter().find(is_it).is_some_and(|planned| planned.covers(offer))
    }
}

impl AdmissionPlan {
    /// Whether a node may announce this, and whether it may publish at once. O(planned publications).
    ///
    /// # Errors
    /// It may not, by this plan.
    pub(crate) fn permits(
        &self,
        publisher: NodeUid,
        declaration: &Declaration,
    ) -> Result<Gate, AnnounceError> {
        let Some(offer) = declaration.offer.filter(|_| declaration.publishes) else { return Ok(Gate::Open) };
        if self.covers(publisher, declaration.subject, &offer) {
            return Ok(Gate::Open);
        }
        match self.unplanned {
            Unplanned::Ask if offer.rate.is_none() => Err(AnnounceError::NoRate),
            Unplanned::Ask => Ok(Gate::Closed),
            Unplanned::Refuse => Err(AnnounceError::OutsidePlan),
            Unplanned::NonRealTime => Ok(Gate::NonRealTime),
        }
    }
}

impl PlannedPublication {
    fn covers(&self, offer: &Offer) -> bool {
        offer.rate.is_some_and(|rate| {
            rate.interval() >= self.rate.interval() && rate.tolerance() <= self.rate.tolerance()
        }) && offer.deadline >= self.deadline
            && offer.len <= usize::from(self.len)
    }
}
