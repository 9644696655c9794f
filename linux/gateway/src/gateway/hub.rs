//! What all tasks of a gateway share, and what it does with an event.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cosmic_core::protocol::LayoutHash;
use tokio::sync::Notify;
use zenoh::Wait as _;
use zenoh::sample::Sample;

use super::origins::Origins;
use super::outlet::Outlet;
use crate::clock::Reading;
use crate::config::ChannelConfig;
use crate::counters::{Counters, Metrics, Outcome};
use crate::crossing::{Crossing, Watch};
use crate::encoding::Envelope;
use crate::keys::Name;
use crate::network::{Admitted, Door, Network};
use crate::segment::{Incoming, Leaving, Left, Segment};

/// What all tasks of a gateway share.
pub(super) struct Hub {
    pub(super) network: Network,
    pub(super) segments: Vec<Arc<Segment>>,
    pub(super) channels: Vec<ChannelConfig>,
    /// For each segment and channel: its way to IP, if it may leave.
    pub(super) outlets: Vec<Vec<Option<Outlet>>>,
    /// What comes from IP and belongs to no segment.
    pub(super) unassigned: Counters,
    pub(super) door: Door,
    /// Where events come from.
    pub(super) origins: Origins,
    pub(super) metrics: Metrics,
    pub(super) changed: Arc<Notify>,
    pub(super) has_company: AtomicBool,
    /// Who is told of each event.
    pub(super) watch: Option<Box<Watch>>,
}

impl Hub {
    /// There is something to forward to.
    pub(super) fn can_forward(&self) -> bool {
        self.segments.len() > 1 || self.has_company.load(Ordering::Relaxed)
    }

    /// An event of a segment. Never waits.
    pub(super) fn on_event(&self, segment: usize, channel: usize, event: Leaving) {
        let (of, config) = (&self.segments[segment], &self.channels[channel]);
        let told = Crossing::of(config).from(&of.name, Some(event.publisher));
        let left = match of.take(channel, config, &event) {
            Ok(left) => left,
            Err(outcome) => {
                of.outgoing.count(outcome);
                return self.tell(&told, outcome);
            }
        };
        let told = told.left(left.to_deadline);
        let incoming = Incoming { content: &event.content, layout: LayoutHash::UNSTATED, left };
        let wanted_here = self.give(channel, Some(segment), &incoming, &told);
        let on_ip = self.outlets[segment][channel].as_ref().filter(|it| it.wanted.load(Ordering::Relaxed));
        let Some(outlet) = on_ip else {
            if !wanted_here {
                of.outgoing.count(Outcome::Unwanted);
                self.tell(&told, Outcome::Unwanted);
            }
            return;
        };
        let envelope = Envelope {
            class: config.class,
            node: Some(event.publisher),
            layout: LayoutHash::UNSTATED,
            sender: self.network.sender,
            sequence: outlet.sequence.fetch_add(1, Ordering::Relaxed),
            sent_at: Reading::now(),
            to_deadline: left.to_deadline,
            to_expiry: left.to_expiry,
            content: event.content,
        };
        let put = outlet.publisher.put(envelope.encode()).wait();
        let outcome = if put.is_ok() { Outcome::Forwarded } else { Outcome::NotSent };
        of.outgoing.count(outcome);
        self.tell(&told, outcome);
    }

    /// An event from IP. Never waits.
    pub(super) fn on_sample(&self, channel: usize, sample: &Sample) {
        if let Err(outcome) = self.pass(channel, sample) {
            self.unassigned.count(outcome);
            if self.watch.is_none() {
                return;
            }
            let told = Crossing::of(&self.channels[channel]);
            match self.network.keys.read_event(sample.key_expr().as_str()) {
                Some(key) => self.tell(&told.from(&key.segment, None), outcome),
                None => self.tell(&told, outcome),
            }
        }
    }

    fn tell(&self, crossing: &Crossing<'_>, outcome: Outcome) {
        if let Some(watch) = &self.watch {
            watch(crossing, outcome);
        }
    }

    fn pass(&self, channel: usize, sample: &Sample) -> Result<(), Outcome> {
        let config = &self.channels[channel];
        let is_own = |name: &Name| self.segments.iter().any(|segment| segment.name == *name);
        let admitted = self.door.admit(sample, config.subject, is_own, &self.unassigned)?;
        let Admitted { segment: origin, envelope, age } = admitted;
        if self.origins.note(channel, &origin) {
            self.changed.notify_one();
        }
        let left = Left { to_deadline: envelope.to_deadline, to_expiry: envelope.to_expiry };
        // An event whose sender states no expiry gets that of the channel, from when it was sent.
        let left = left.at_most(config).after(age).ok_or(Outcome::Expired)?;
        let incoming = Incoming { content: &envelope.content, layout: envelope.layout, left };
        let told = Crossing::of(config).from(&origin, envelope.node).left(left.to_deadline);
        // Interest may have ended while the event was on its way, or we do not lead any more.
        if self.give(channel, None, &incoming, &told) { Ok(()) } else { Err(Outcome::Unwanted) }
    }

    /// Gives an event to all segments where somebody wants it, but the one it comes from. Returns whether there is one.
    fn give(&self, channel: usize, from: Option<usize>, event: &Incoming<'_>, told: &Crossing<'_>) -> bool {
        let mut any = false;
        for (at, segment) in self.segments.iter().enumerate() {
            if Some(at) != from && segment.is_interested(channel) {
                let outcome = segment.give(channel, &self.channels[channel], event);
                self.tell(&told.to(&segment.name), outcome);
                any = true;
            }
        }
        any
    }
}
