//! What all tasks of a gateway share, and what it does with an event.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cosmic_core::Subject;
use cosmic_core::can::Payload;
use cosmic_core::event_layer::Delivered;
use cosmic_core::protocol::LayoutHash;
use tokio::sync::Notify;
use zenoh::Wait as _;
use zenoh::sample::{Sample, SampleKind};

use super::outlet::Outlet;
use crate::clock::Reading;
use crate::config::ChannelConfig;
use crate::counters::{Counters, Metrics, Outcome};
use crate::encoding::Envelope;
use crate::network::Network;
use crate::segment::{Incoming, Left, Segment};
use crate::sequence::Windows;

/// What all tasks of a gateway share.
pub(super) struct Hub {
    pub(super) network: Network,
    pub(super) segments: Vec<Arc<Segment>>,
    pub(super) channels: Vec<ChannelConfig>,
    pub(super) by_subject: HashMap<Subject, usize>,
    /// For each segment and channel: its way to IP, if it may leave.
    pub(super) outlets: Vec<Vec<Option<Outlet>>>,
    /// What comes from IP and belongs to no segment.
    pub(super) unassigned: Counters,
    /// What has come from IP.
    pub(super) windows: Windows,
    pub(super) metrics: Metrics,
    pub(super) changed: Arc<Notify>,
    pub(super) has_company: AtomicBool,
}

impl Hub {
    /// There is something to forward to.
    pub(super) fn can_forward(&self) -> bool {
        self.segments.len() > 1 || self.has_company.load(Ordering::Relaxed)
    }

    /// An event of a segment. Never waits.
    pub(super) fn on_event(&self, segment: usize, channel: usize, event: &Delivered<Payload>) {
        let (of, config) = (&self.segments[segment], &self.channels[channel]);
        let (node, left) = match of.take(channel, config, event) {
            Ok(taken) => taken,
            Err(outcome) => {
                of.outgoing.count(outcome);
                return;
            }
        };
        let incoming = Incoming { content: event.content.as_slice(), layout: LayoutHash::UNSTATED, left };
        let others =
            self.segments.iter().enumerate().filter(|(at, other)| *at != segment && other.wants(channel));
        let wanted_here = others.map(|(_, other)| other.give(channel, config, &incoming)).count() > 0;
        let on_ip = self.outlets[segment][channel].as_ref().filter(|it| it.wanted.load(Ordering::Relaxed));
        let Some(outlet) = on_ip else {
            of.outgoing.count_many(Outcome::Unwanted, u64::from(!wanted_here));
            return;
        };
        let envelope = Envelope {
            class: config.class,
            node: Some(node),
            layout: LayoutHash::UNSTATED,
            sender: self.network.sender,
            sequence: outlet.sequence.fetch_add(1, Ordering::Relaxed),
            sent_at: Reading::now(),
            to_deadline: left.to_deadline,
            to_expiry: left.to_expiry,
            content: event.content.as_slice().to_vec(),
        };
        let put = outlet.publisher.put(envelope.encode()).wait();
        of.outgoing.count(if put.is_ok() { Outcome::Forwarded } else { Outcome::NotSent });
    }

    /// An event from IP. Never waits.
    pub(super) fn on_sample(&self, channel: usize, sample: &Sample) {
        if let Err(outcome) = self.pass(channel, sample) {
            self.unassigned.count(outcome);
        }
    }

    fn pass(&self, channel: usize, sample: &Sample) -> Result<(), Outcome> {
        let now = Reading::now();
        let key = self.network.keys.read_event(sample.key_expr().as_str()).ok_or(Outcome::Malformed)?;
        if sample.kind() != SampleKind::Put || self.by_subject.get(&key.subject) != Some(&channel) {
            return Err(Outcome::Malformed);
        }
        if self.segments.iter().any(|segment| segment.name == key.segment) {
            return Err(Outcome::ComeBack);
        }
        let config = &self.channels[channel];
        let bytes = sample.payload().to_bytes();
        let envelope = Envelope::decode(&bytes).map_err(|_| Outcome::Malformed)?;
        let missing = self.windows.note(&key, &envelope, now)?;
        self.unassigned.count_many(Outcome::Missing, missing);
        let age = self.network.peers.age(&key.segment, &envelope, now)?;
        let left = Left { to_deadline: envelope.to_deadline, to_expiry: envelope.to_expiry };
        // An event whose sender states no expiry gets that of the channel, from when it was sent.
        let left = left.at_most(config).after(age).ok_or(Outcome::Expired)?;
        let incoming = Incoming { content: &envelope.content, layout: envelope.layout, left };
        let wanting = self.segments.iter().filter(|segment| segment.wants(channel));
        let given = wanting.map(|segment| segment.give(channel, config, &incoming)).count();
        // Interest may have ended while the event was on its way, or we do not lead any more.
        if given > 0 { Ok(()) } else { Err(Outcome::Unwanted) }
    }
}
