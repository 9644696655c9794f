//! The gateway's node on a segment, and its channels there.

mod beacons;
mod origin;
mod outbox;
mod passed_over;

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use cosmic_core::can::{Payload, Priority, TxNode};
use cosmic_core::event_layer::{
    Attributes, Channel, Delivered, Depth, Event, NonRealTimeAttributes, Policy, SoftAttributes,
};
use cosmic_core::network::fragments::frames_of;
use cosmic_core::protocol::{Class, LayoutHash, Side};
use cosmic_core::time::{Duration, Instant};
use cosmic_linux::{Node, Publisher, Subscriber};
use cosmic_session::node_config;
use tokio::sync::Notify;

pub(crate) use beacons::keep_leader;
pub(crate) use origin::Left;

use crate::config::{ChannelConfig, SegmentConfig};
use crate::counters::{Counters, Direction, Metrics, Outcome};
use crate::error::StartError;
use crate::keys::Name;
use crate::leader::Leadership;
use crate::rules::{Bucket, Ceiling};
use crate::table::Table;
use outbox::Outbox;
use passed_over::PassedOver;

/// The gateway's node on a segment.
pub(crate) struct Segment {
    pub(crate) name: Name,
    pub(crate) node: Node,
    /// By the place of the channel in the configuration.
    pub(crate) channels: Vec<Port>,
    leadership: Mutex<Leadership>,
    ceiling: Mutex<Ceiling>,
    /// Δt_p of its calendar.
    step: Duration,
    etag_of_gateways: Option<cosmic_core::can::Etag>,
    /// Events that were left to the gateway that leads, since its last beacon.
    passed_over: Mutex<PassedOver>,
    pub(crate) incoming: Counters,
    pub(crate) outgoing: Counters,
    /// Something has changed that decides what is forwarded.
    pub(crate) changed: Notify,
}

/// A channel at a segment.
pub(crate) struct Port {
    /// As the gateway's node has it there.
    channel: Channel<Payload>,
    entrance: Entrance,
    /// Somebody on the segment subscribes to it, who is no gateway.
    wanted: AtomicBool,
    /// Events that found no place among those that wait to leave, as far as they were counted.
    overflowed: AtomicU32,
    /// It enters whether anybody says so or not.
    unasked: bool,
    /// From publication to the deadline, as publishers on the segment have it.
    deadline: Option<Duration>,
}

/// How events of a channel enter.
enum Entrance {
    /// They may not.
    Closed,
    Events(Publisher<Payload>),
    /// Messages of several frames.
    Messages(Outbox, Mutex<Bucket>),
}

/// An event that is to leave its segment.
#[derive(Clone, Debug)]
pub(crate) struct Leaving {
    pub(crate) content: Vec<u8>,
    pub(crate) publisher: TxNode,
    pub(crate) priority: Priority,
    /// When its first frame was received, and its last.
    pub(crate) began_at: Instant,
    pub(crate) received_at: Instant,
}

impl From<&Delivered<Payload>> for Leaving {
    fn from(event: &Delivered<Payload>) -> Self {
        Self {
            content: event.content.as_slice().to_vec(),
            publisher: event.publisher,
            priority: event.id.priority(),
            began_at: event.received_at,
            received_at: event.received_at,
        }
    }
}

/// An event for a segment.
#[derive(Clone, Debug)]
pub(crate) struct Incoming<'a> {
    pub(crate) content: &'a [u8],
    pub(crate) layout: LayoutHash,
    /// What is left to its deadline and expiry, now.
    pub(crate) left: Left,
}

impl Segment {
    /// Starts the node, and announces what may enter.
    pub(crate) fn start(
        config: &SegmentConfig,
        channels: &[ChannelConfig],
        group: u16,
        table: Option<&Table>,
        metrics: &Metrics,
    ) -> Result<Self, StartError> {
        let refused = |what: String| StartError::segment(&config.name, what);
        let mut of_node = node_config(config.uid, config.plan.as_ref(), config.bit_rate);
        of_node.node.tx_node = config.tx_node;
        let step = of_node.calendar.priority_step();
        if let Some(table) = table {
            of_node = of_node.broker(table.contents().clone());
        }
        let link = config.link.link(config.bit_rate).map_err(refused)?;
        let node = Node::start(of_node, link).map_err(|error| refused(error.to_string()))?;
        let incoming = metrics.of(&config.name, Direction::In);
        let ports = channels.iter().map(|channel| {
            let refused =
                |what: String| refused(format!("the channel {:?} is refused: {what}", channel.name));
            let declared = declare(channel, config).map_err(refused)?;
            let enters = channel.to.has(&config.name);
            let announced = enters.then(|| node.announce(&declared)).transpose();
            let entrance = match announced.map_err(|error| refused(error.to_string()))? {
                None => Entrance::Closed,
                Some(publisher) if channel.longest_message.is_some() => Entrance::Messages(
                    Outbox::new(publisher, incoming.clone()),
                    Bucket::new(channel.rate).into(),
                ),
                Some(publisher) => Entrance::Events(publisher),
            };
            let unasked = channel.unasked.contains(&config.name);
            let deadline = planned_deadline(channel, config).or(channel.deadline);
            let (wanted, overflowed) = (AtomicBool::new(false), AtomicU32::new(0));
            Ok(Port { channel: declared, entrance, wanted, overflowed, unasked, deadline })
        });
        Ok(Self {
            name: config.name.clone(),
            channels: ports.collect::<Result<_, _>>()?,
            node,
            leadership: Mutex::new(Leadership::new(group)),
            ceiling: Mutex::new(Ceiling::new(config.bit_rate, config.ceiling)),
            step,
            etag_of_gateways: config.etags.get(&crate::config::GATEWAYS).copied(),
            passed_over: Mutex::new(PassedOver::default()),
            incoming: incoming.clone(),
            outgoing: metrics.of(&config.name, Direction::Out),
            changed: Notify::new(),
        })
    }

    fn leadership(&self) -> MutexGuard<'_, Leadership> {
        self.leadership.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn passed_over(&self) -> MutexGuard<'_, PassedOver> {
        self.passed_over.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// We speak for the segment.
    pub(crate) fn leads(&self) -> bool {
        self.leadership().leads()
    }

    /// Somebody here wants events of the channel, and they may enter.
    pub(crate) fn is_interested(&self, channel: usize) -> bool {
        let port = &self.channels[channel];
        port.enters() && (port.unasked || port.wanted.load(Ordering::Relaxed))
    }

    /// As that, and it is we who forward them.
    pub(crate) fn wants(&self, channel: usize) -> bool {
        self.is_interested(channel) && self.leads()
    }

    /// Subscribes to a channel.
    pub(crate) fn listen(&self, channel: usize) -> Result<Subscriber<Payload>, String> {
        let subscriber = self.node.subscribe(&self.channels[channel].channel, Policy::Fifo(WAITING));
        subscriber.map_err(|error| error.to_string())
    }

    /// Counts events of a channel that came faster than they left, since it was called last.
    pub(crate) fn count_overflows(&self, channel: usize) {
        let port = &self.channels[channel];
        let counters = self.node.channel_counters(port.channel.subject());
        let overflowed = counters.map_or(0, |counters| counters.overflowed);
        let before = port.overflowed.swap(overflowed, Ordering::Relaxed);
        // The node begins anew with a channel that it had given up.
        let more = overflowed.checked_sub(before).unwrap_or(overflowed);
        self.outgoing.count_many(Outcome::QueueFull, more.into());
    }

    /// Looks at who subscribes here, and returns whether that has changed anything.
    fn look_for_interest(&self) -> bool {
        let mut changed = false;
        for port in &self.channels {
            let etag = port.enters().then(|| self.node.etag_of(port.channel.subject())).flatten();
            let wanted = etag.is_some_and(|etag| {
                let nodes = self.node.interested(etag, Side::Subscriber);
                let leadership = self.leadership();
                nodes.iter().any(|node| !leadership.is_gateway(*node))
            });
            changed |= port.wanted.swap(wanted, Ordering::Relaxed) != wanted;
        }
        changed
    }

    /// An event of the segment that is to leave it: what is left of its time, or why it does not leave.
    pub(crate) fn take(&self, at: usize, channel: &ChannelConfig, event: &Leaving) -> Result<Left, Outcome> {
        let at_origin = self.channels[at].deadline;
        let now = self.node.now();
        let leadership = self.leadership();
        if Some(event.publisher) == self.node.tx_node() || leadership.is_gateway(event.publisher) {
            return Err(Outcome::OfGateway);
        }
        if !leadership.may_forward(now) {
            self.passed_over().note(event.received_at);
            return Err(Outcome::StandingBy);
        }
        let waited = now.saturating_since(event.began_at);
        let left = Left::of_frame(channel, at_origin, event.priority, self.step);
        left.after(waited).ok_or(Outcome::Expired)
    }

    /// An event for the segment. Never waits. What becomes of it is counted, and returned; a message that is taken is
    /// returned as forwarded, and its outbox counts what becomes of it.
    pub(crate) fn give(&self, at: usize, channel: &ChannelConfig, event: &Incoming<'_>) -> Outcome {
        let now = self.node.now();
        let outcome = if self.conflicts(at, event.layout) {
            Some(Outcome::LayoutMismatch)
        } else if !self.leadership().may_forward(now) {
            Some(Outcome::StandingBy)
        } else {
            let left = event.left.at_most(channel);
            match &self.channels[at].entrance {
                Entrance::Closed => Some(Outcome::Unwanted),
                Entrance::Events(publisher) => {
                    Some(self.publish(publisher, channel, event.content, left, now))
                }
                Entrance::Messages(outbox, bucket) => {
                    let mut bucket = bucket.lock().unwrap_or_else(PoisonError::into_inner);
                    // If it is taken, the outbox counts it.
                    self.enqueue(outbox, &mut bucket, channel, event.content, left, now).err()
                }
            }
        };
        if let Some(outcome) = outcome {
            self.incoming.count(outcome);
        }
        outcome.unwrap_or(Outcome::Forwarded)
    }

    fn enqueue(
        &self,
        outbox: &Outbox,
        bucket: &mut Bucket,
        channel: &ChannelConfig,
        content: &[u8],
        left: Left,
        now: Instant,
    ) -> Result<(), Outcome> {
        if channel.longest_message.is_none_or(|longest| content.len() > longest) {
            return Err(Outcome::TooLong);
        }
        let mut ceiling = self.ceiling.lock().unwrap_or_else(PoisonError::into_inner);
        if !ceiling.has_room(now) {
            return Err(Outcome::CeilingExceeded);
        }
        // What finds no place takes nothing of the channel's rate.
        let place = outbox.place()?;
        if !bucket.charge(now) {
            return Err(Outcome::RateExceeded);
        }
        place.take(content, left.to_expiry.map(|left| now + left.max(Duration::from_ticks(1))));
        (0..frames_of(content.len())).for_each(|_| ceiling.charge(Payload::MAX_LEN, now));
        Ok(())
    }

    fn publish(
        &self,
        publisher: &Publisher<Payload>,
        channel: &ChannelConfig,
        content: &[u8],
        left: Left,
        now: Instant,
    ) -> Outcome {
        let Some(content) = Payload::new(content) else { return Outcome::TooLong };
        let mut published = Event::new(content);
        let is_late = left.to_deadline.is_some_and(|left| left.is_zero());
        if let Some(to_deadline) = left.to_deadline.filter(|_| channel.class != Class::NonRealTime) {
            // One that is late goes as urgently as can be; a deadline that has passed would be refused.
            let soon = left.to_expiry.map_or(AT_ONCE, |left| AT_ONCE.min(left));
            published = published.deadline(now + to_deadline.max(soon));
        }
        if let Some(left) = left.to_expiry {
            published = published.expires_at(now + left.max(Duration::from_ticks(1)));
        }
        let mut ceiling = self.ceiling.lock().unwrap_or_else(PoisonError::into_inner);
        if !ceiling.has_room(now) {
            return Outcome::CeilingExceeded;
        }
        match publisher.publish_event(&published) {
            Ok(()) => {
                ceiling.charge(content.len(), now);
                if is_late { Outcome::ForwardedLate } else { Outcome::Forwarded }
            }
            Err(why) => outbox::refusal(why),
        }
    }

    /// Somebody here lays the content out otherwise than the publisher says.
    fn conflicts(&self, at: usize, layout: LayoutHash) -> bool {
        if layout == LayoutHash::UNSTATED {
            return false;
        }
        let etag = self.node.etag_of(self.channels[at].channel.subject());
        let layouts = etag.map(|etag| self.node.layouts(etag, Side::Subscriber)).unwrap_or_default();
        layouts.iter().any(|other| other.conflicts_with(layout))
    }
}

impl Port {
    /// Events may enter here.
    const fn enters(&self) -> bool {
        !matches!(self.entrance, Entrance::Closed)
    }
}

/// The channel as the gateway's node has it on a segment: plain bytes, so that it fits any layout.
fn declare(channel: &ChannelConfig, segment: &SegmentConfig) -> Result<Channel<Payload>, String> {
    if channel.class == Class::Hard && channel.from.has(&segment.name) {
        let planned =
            segment.plan.as_ref().and_then(|plan| plan.declare(plan.channel_of_subject(channel.subject)?));
        return planned.ok_or_else(|| "it does not stand in the plan of the segment".to_owned());
    }
    let declared = match channel.class {
        Class::NonRealTime => {
            let quality =
                NonRealTimeAttributes { importance: channel.importance, validity: channel.validity };
            Channel::non_real_time(channel.subject, quality)
        }
        Class::Soft | Class::Hard => {
            let deadline = channel.deadline.ok_or("it has no deadline")?;
            let validity = channel.validity.unwrap_or(deadline);
            Channel::soft(channel.subject, SoftAttributes { deadline, validity })
        }
    };
    // A message counts as one event, however many frames it has: it is charged before it is cut.
    let declared =
        if channel.longest_message.is_some() { declared } else { declared.with_rate(channel.rate) };
    Ok(match segment.etags.get(&channel.subject) {
        Some(etag) => declared.with_etag(*etag),
        None => declared,
    })
}

/// The deadline that the plan of the segment gives a soft real-time channel.
fn planned_deadline(channel: &ChannelConfig, segment: &SegmentConfig) -> Option<Duration> {
    let plan = segment.plan.as_ref()?;
    match plan.declare(plan.channel_of_subject(channel.subject)?)?.attributes() {
        Attributes::Soft(soft) => Some(soft.deadline),
        Attributes::Hard(_) | Attributes::NonRealTime(_) => None,
    }
}

/// So soon a late event is to be sent.
const AT_ONCE: Duration = Duration::from_millis(2);
/// Events that wait to leave, of each channel.
const WAITING: Depth = Depth::new(128).unwrap();
