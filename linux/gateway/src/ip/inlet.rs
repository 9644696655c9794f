//! Where the events of a subscription come in.

use std::sync::Arc;

use cosmic_core::Subject;
use cosmic_core::event_layer::{Attributes, Context};
use cosmic_core::protocol::LayoutHash;
use cosmic_core::time::Duration;
use zenoh::sample::Sample;

use super::queue::Queue;
use super::{Origin, Received, now};
use crate::counters::{Counters, Outcome};
use crate::network::{Admitted, Door};

pub(super) struct Inlet {
    pub(super) door: Door,
    pub(super) subject: Subject,
    pub(super) queue: Arc<Queue>,
    pub(super) counters: Counters,
    pub(super) attributes: Attributes,
    pub(super) layout: LayoutHash,
}

impl Inlet {
    /// Counts what becomes of an event.
    pub(super) fn pass(&self, sample: &Sample) {
        let outcome = self.take(sample).err().unwrap_or(Outcome::Forwarded);
        self.counters.count(outcome);
    }

    fn take(&self, sample: &Sample) -> Result<(), Outcome> {
        let received_at = now();
        let admitted = self.door.admit(sample, self.subject, |_| false, &self.counters)?;
        let Admitted { segment, envelope, age } = admitted;
        if self.layout.conflicts_with(envelope.layout) {
            return Err(Outcome::LayoutMismatch);
        }
        let (deadline, validity) = match self.attributes {
            Attributes::Soft(soft) => (Some(soft.deadline), Some(soft.validity)),
            Attributes::NonRealTime(quality) => (None, quality.validity),
            Attributes::Hard(hard) => (Some(hard.period), Some(hard.period)),
        };
        let left = |of_event: Option<Duration>, of_channel: Option<Duration>| match (of_event, of_channel) {
            (Some(left), Some(most)) => Some(left.min(most)),
            (left, most) => left.or(most),
        };
        let to_expiry = left(envelope.to_expiry, validity);
        if to_expiry.is_some_and(|left| left <= age) {
            return Err(Outcome::Expired);
        }
        let sent_at = received_at.saturating_sub(age);
        let event = Received {
            content: envelope.content,
            context: Context::EMPTY,
            class: envelope.class,
            origin: Origin { segment, node: envelope.node },
            received_at,
            deadline: left(envelope.to_deadline, deadline).map(|left| sent_at + left),
            expires_at: to_expiry.map(|left| sent_at + left),
        };
        if self.queue.push(event) { Ok(()) } else { Err(Outcome::QueueFull) }
    }
}
