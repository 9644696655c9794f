//! A node on IP alone: it publishes and subscribes on the channels of the segments, and is on none of them.
//!
//! The calls are those of a [node on a segment](cosmic_linux::Node): announce, publish, subscribe, with the same channels
//! and types. To the gateways it is a segment of its own, with one node, under the name that it is given.
//!
//! ```no_run
//! use cosmic_core::Subject;
//! use cosmic_core::event_layer::{Channel, Policy, SoftAttributes};
//! use cosmic_core::time::Duration;
//! use cosmic_gateway::config::{Ip, Mode};
//! use cosmic_gateway::ip::Node;
//! use cosmic_gateway::keys::Name;
//!
//! const HEAT: Channel<i16> = Channel::soft(
//!     Subject::new(0x2A).unwrap(),
//!     SoftAttributes { deadline: Duration::from_millis(50), validity: Duration::from_millis(200) },
//! );
//!
//! # async fn run() -> Result<(), Box<dyn std::error::Error>> {
//! let ip = Ip { mode: Mode::Peer, connect: vec!["tcp/gateway:7447".to_owned()], ..Ip::default() };
//! let (network, name) = (Name::new("plant").ok_or("no name")?, Name::new("desk").ok_or("no name")?);
//! let node = Node::start(&ip, &network, &name).await?;
//! let subscriber = node.subscribe(&HEAT, Policy::Latest).await?;
//! let event = subscriber.next().await;
//! println!("{} degrees, from {}", event.content, event.origin.segment);
//! # Ok(())
//! # }
//! ```

mod inlet;
mod listener;
mod queue;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use cosmic_core::can::{Payload, TxNode};
use cosmic_core::event_layer::{Attributes, Channel, Content, Context, Event, Policy, PublishError};
use cosmic_core::protocol::Class;
use cosmic_core::time::{Duration, Instant};
use cosmic_linux::AnnounceError;
use tokio::sync::Notify;
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;

use inlet::Inlet;
pub use listener::{Heard, Listener, Participant};
use queue::Queue;

use crate::clock::Reading;
use crate::config::Ip;
use crate::counters::{Counters, Direction, Metrics, Outcome};
use crate::encoding::Envelope;
use crate::keys::Name;
use crate::network::{Network, NetworkError, Voice, failed};

/// A node on IP. Clones are handles of the same node.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
}

struct Inner {
    network: Network,
    name: Name,
    _voice: Voice,
    incoming: Counters,
    outgoing: Counters,
}

/// Where an event was published.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Origin {
    /// The segment, or the name of a node on IP.
    pub segment: Name,
    /// The node of the segment.
    pub node: Option<TxNode>,
}

/// An event as a subscriber on IP gets it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Received<C> {
    /// What was published.
    pub content: C,
    /// The attributes of context.
    pub context: Context,
    /// Its class where it was published.
    pub class: Class,
    /// Where it was published.
    pub origin: Origin,
    /// When it arrived.
    pub received_at: Instant,
    /// Its deadline.
    pub deadline: Option<Instant>,
    /// When it is of no use any more.
    pub expires_at: Option<Instant>,
}

impl Node {
    /// Takes part in a network under a name, which no segment and no other node there has, inside a runtime of tokio with
    /// several threads.
    ///
    /// # Errors
    /// [`NetworkError`]
    pub async fn start(ip: &Ip, network: &Name, name: &Name) -> Result<Self, NetworkError> {
        let network = Network::join(ip, network).await?;
        let voice = network.speak_for(name).await?;
        let metrics = Metrics::new();
        let (incoming, outgoing) = (metrics.of(name, Direction::In), metrics.of(name, Direction::Out));
        Ok(Self { inner: Arc::new(Inner { network, name: name.clone(), _voice: voice, incoming, outgoing }) })
    }

    /// The present time: what deadlines and expirations are stated in.
    pub fn now(&self) -> Instant {
        now()
    }

    /// Announces a channel.
    ///
    /// # Errors
    /// [`AnnounceError::HardRealTime`]; and the network.
    pub async fn announce<C: Content>(&self, channel: &Channel<C>) -> Result<Publisher<C>, IpError> {
        if matches!(channel.attributes(), Attributes::Hard(_)) {
            return Err(IpError::Announce(AnnounceError::HardRealTime));
        }
        let network = &self.inner.network;
        let key = network.keys.event(channel.subject(), &self.inner.name);
        let soft = matches!(channel.attributes(), Attributes::Soft(_));
        let publisher = network.session.declare_publisher(key).allowed_destination(Locality::Remote);
        let publisher = publisher
            .congestion_control(CongestionControl::Drop)
            .priority(if soft { Priority::RealTime } else { Priority::Data })
            .express(soft);
        let publisher = publisher.await.map_err(|error| failed(&error))?;
        let wanted = Arc::new((AtomicBool::new(false), Notify::new()));
        let told = Arc::clone(&wanted);
        let listener = publisher.matching_listener().callback(move |status| {
            told.0.store(status.matching(), Ordering::Relaxed);
            told.1.notify_waiters();
        });
        listener.background().await.map_err(|error| failed(&error))?;
        if publisher.matching_status().await.map_err(|error| failed(&error))?.matching() {
            wanted.0.store(true, Ordering::Relaxed);
        }
        let sequence = AtomicU64::new(0);
        Ok(Publisher { node: self.clone(), channel: *channel, publisher, wanted, sequence })
    }

    /// Subscribes to a channel, wherever it is published.
    ///
    /// # Errors
    /// The network.
    pub async fn subscribe<C: Content>(
        &self,
        channel: &Channel<C>,
        policy: Policy,
    ) -> Result<Subscriber<C>, IpError> {
        let network = &self.inner.network;
        let queue = Arc::new(Queue::new(policy));
        let inlet = Inlet {
            door: network.door(),
            subject: channel.subject(),
            queue: Arc::clone(&queue),
            counters: self.inner.incoming.clone(),
            attributes: channel.attributes(),
            layout: channel.layout(),
        };
        let key = network.keys.events(channel.subject());
        let subscriber = network.session.declare_subscriber(key).allowed_origin(Locality::Remote);
        let subscriber = subscriber.callback(move |sample| inlet.pass(&sample)).await;
        let subscriber = subscriber.map_err(|error| failed(&error))?;
        Ok(Subscriber { node: self.clone(), channel: *channel, queue, _subscriber: subscriber })
    }

    /// Waits until it is connected to somebody.
    pub async fn connected(&self) {
        self.inner.network.connected().await;
    }

    /// Waits until there are others, and as many have asked what this node's clock says: before that, they discard what it
    /// sends. Who only listens is none of them.
    pub async fn known(&self) {
        let is_known = |others: usize| others > 0 && self.inner.network.answered() >= others as u64;
        while !is_known(self.others().0) {
            tokio::time::sleep(std::time::Duration::from_millis(5)).await;
        }
    }

    /// How many others are on IP, and of how many the clock is known: what they send before is discarded.
    pub fn others(&self) -> (usize, usize) {
        self.inner.network.peers.count()
    }

    /// How often that happened to events in this direction.
    pub fn count(&self, direction: Direction, outcome: Outcome) -> u64 {
        match direction {
            Direction::In => self.inner.incoming.get(outcome),
            Direction::Out => self.inner.outgoing.get(outcome),
        }
    }

    /// Ends in order: others see at once that it is gone.
    pub async fn stop(self) {
        self.inner.network.leave().await;
    }
}

/// Why a channel cannot be used.
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum IpError {
    /// It cannot be announced.
    Announce(AnnounceError),
    /// The network refuses it.
    Network(NetworkError),
}

impl From<NetworkError> for IpError {
    fn from(error: NetworkError) -> Self {
        Self::Network(error)
    }
}

impl std::fmt::Display for IpError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Announce(error) => error.fmt(f),
            Self::Network(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for IpError {}

/// The right to publish on a channel. Given up when it is dropped.
pub struct Publisher<C> {
    node: Node,
    channel: Channel<C>,
    publisher: zenoh::pubsub::Publisher<'static>,
    wanted: Arc<(AtomicBool, Notify)>,
    sequence: AtomicU64,
}

impl<C: Content> Publisher<C> {
    /// Publishes an event of now. Never waits. If nobody subscribes, it goes nowhere.
    ///
    /// # Errors
    /// [`PublishError`]: the event is not sent.
    pub fn publish(&self, content: C) -> Result<(), PublishError> {
        self.publish_event(&Event::new(content))
    }

    /// Publishes an event with times or context of its own.
    ///
    /// # Errors
    /// [`PublishError`]: the event is not sent.
    pub fn publish_event(&self, event: &Event<C>) -> Result<(), PublishError> {
        let now = now();
        let (deadline, validity, class) = match self.channel.attributes() {
            Attributes::Soft(soft) => (Some(soft.deadline), Some(soft.validity), Class::Soft),
            Attributes::NonRealTime(quality) => (None, quality.validity, Class::NonRealTime),
            Attributes::Hard(_) => return Err(PublishError::HardDeadline),
        };
        let left = |at: Option<Instant>, of_channel: Option<Duration>| match at {
            Some(at) if at <= now => Err(PublishError::Deadline),
            Some(at) => Ok(Some(at.saturating_since(now))),
            None => Ok(of_channel),
        };
        let (to_deadline, to_expiry) = (left(event.deadline, deadline)?, left(event.expires_at, validity)?);
        let to_expiry = match (to_deadline, to_expiry, event.expires_at) {
            (Some(deadline), Some(expiry), Some(_)) if expiry < deadline => {
                return Err(PublishError::Deadline);
            }
            (Some(deadline), Some(expiry), None) => Some(expiry.max(deadline)),
            (_, expiry, _) => expiry,
        };
        // A number is drawn for what is sent, or the others would miss it.
        let content = self.encode(event)?.as_slice().to_vec();
        let envelope = Envelope {
            class,
            node: None,
            layout: self.channel.layout(),
            sender: self.node.inner.network.sender,
            sequence: self.sequence.fetch_add(1, Ordering::Relaxed),
            sent_at: Reading::now(),
            to_deadline,
            to_expiry,
            content,
        };
        let put = self.publisher.put(envelope.encode()).wait();
        let outcome = if put.is_ok() { Outcome::Forwarded } else { Outcome::NotSent };
        self.node.inner.outgoing.count(outcome);
        put.map_err(|_| PublishError::QueueFull)
    }

    fn encode(&self, event: &Event<C>) -> Result<Payload, PublishError> {
        let mut bytes = [0; Payload::MAX_LEN];
        event.content.encode(&mut bytes[..C::LEN]);
        let content = Payload::new(&bytes[..event.content.encoded_len()]).ok_or(PublishError::TooLong)?;
        if self.channel.has_context() {
            event.context.prepend(&content).map_err(|_| PublishError::TooLong)
        } else if event.context.presence() != 0 {
            Err(PublishError::TooLong)
        } else {
            Ok(content)
        }
    }

    /// Returns whether somebody subscribes.
    pub fn is_wanted(&self) -> bool {
        self.wanted.0.load(Ordering::Relaxed)
    }

    /// Waits until somebody subscribes.
    pub async fn wanted(&self) {
        loop {
            let told = self.wanted.1.notified();
            if self.is_wanted() {
                return;
            }
            told.await;
        }
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }
}

/// A subscription to a channel. Given up when it is dropped, with the events that wait for it.
pub struct Subscriber<C> {
    node: Node,
    channel: Channel<C>,
    queue: Arc<Queue>,
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

impl<C: Content> Subscriber<C> {
    /// Waits for the next event. Cancelling the wait loses none.
    pub async fn next(&self) -> Received<C> {
        loop {
            let told = self.queue.told();
            if let Some(event) = self.try_next() {
                return event;
            }
            told.await;
        }
    }

    /// The next event, if there is one. What has expired while it waited is passed over, and counted.
    pub fn try_next(&self) -> Option<Received<C>> {
        loop {
            let event = self.queue.pop()?;
            if event.expires_at.is_some_and(|at| at <= now()) {
                self.node.inner.incoming.count(Outcome::Expired);
                continue;
            }
            match self.decode(&event.content) {
                Some((context, content)) => return Some(event.map(|_| (context, content))),
                None => self.node.inner.incoming.count(Outcome::Malformed),
            }
        }
    }

    fn decode(&self, bytes: &[u8]) -> Option<(Context, C)> {
        if self.channel.has_context() {
            let (context, content) = Context::split(&Payload::new(bytes)?)?;
            Some((context, C::decode(content.as_slice())?))
        } else {
            Some((Context::EMPTY, C::decode(bytes)?))
        }
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }
}

impl Received<Vec<u8>> {
    fn map<C>(self, read: impl FnOnce(&[u8]) -> (Context, C)) -> Received<C> {
        let Self { class, origin, received_at, deadline, expires_at, .. } = self;
        let (context, content) = read(&self.content);
        Received { content, context, class, origin, received_at, deadline, expires_at }
    }
}

fn now() -> Instant {
    Instant::from_epoch(Duration::from_ticks(Reading::now().0))
}
