//! A node on IP alone: it publishes and subscribes on the channels of the segments, and is on none of them.
//!
//! The calls are those of a [node on a segment](cosmic_linux::Node): announce, publish, subscribe, with the same channels
//! and types, of events and of messages. To the gateways it is a segment of its own, with one node, under the name that it is given.
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
mod outlet;
mod publisher;
mod queue;
mod subscriber;

use std::sync::Arc;

use cosmic_core::can::TxNode;
use cosmic_core::event_layer::{Attributes, Channel, Content, Context, MessageChannel, Policy};
use cosmic_core::protocol::Class;
use cosmic_core::time::{Duration, Instant};
use cosmic_linux::AnnounceError;

pub use listener::{Heard, Listener, Participant};
use outlet::Outlet;
pub use publisher::{MessagePublisher, Publisher};
use subscriber::Intake;
pub use subscriber::{MessageSubscriber, Subscriber};

use crate::clock::Reading;
use crate::config::Ip;
use crate::counters::{Counters, Direction, Metrics, Outcome};
use crate::keys::Name;
use crate::network::{Network, NetworkError, Voice};

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
        Ok(Publisher { outlet: Outlet::open(self, channel).await?, channel: *channel })
    }

    /// Announces a channel of messages, of up to 1024 bytes each.
    ///
    /// # Errors
    /// The network.
    pub async fn announce_messages<C: Content, const LEN: usize, const PUBLISHERS: usize>(
        &self,
        channel: &MessageChannel<C, LEN, PUBLISHERS>,
    ) -> Result<MessagePublisher<C>, IpError> {
        Ok(MessagePublisher::new(Outlet::open(self, channel.fragments()).await?, channel.fragments()))
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
        Ok(Subscriber { intake: Intake::open(self, channel, policy).await?, channel: *channel })
    }

    /// Subscribes to a channel of messages, wherever they are published. They come whole.
    ///
    /// # Errors
    /// The network.
    pub async fn subscribe_messages<C: Content, const LEN: usize, const PUBLISHERS: usize>(
        &self,
        channel: &MessageChannel<C, LEN, PUBLISHERS>,
        policy: Policy,
    ) -> Result<MessageSubscriber<C>, IpError> {
        Ok(MessageSubscriber::new(Intake::open(self, channel.fragments(), policy).await?))
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

impl<C> Received<C> {
    /// The same with what this makes of its content.
    pub fn map<D>(self, make: impl FnOnce(C) -> D) -> Received<D> {
        let Self { content, context, class, origin, received_at, deadline, expires_at } = self;
        Received { content: make(content), context, class, origin, received_at, deadline, expires_at }
    }
}

fn now() -> Instant {
    Instant::from_epoch(Duration::from_ticks(Reading::now().0))
}
