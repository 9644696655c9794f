//! A sealed cluster: what the plan fixes, nobody changes at run time.
//!
//! A CAN frame does not say who sent it. In an open cluster a node believes what it hears of brokers, masters, ids
//! and bindings, and the protocol mends what accidents break. In a *sealed* one it believes only what agrees with
//! its plan: who may be broker and time master, which UID has which TxNode, which subject has which etag, and who
//! publishes on it. Whatever else comes is refused, counted, and told to the application once a second for each
//! kind; and it is answered by no frame at all, so that nobody makes a sealed node send.
//!
//! `docs/security.md` says against what this helps, and against what only hardware does.
//!
//! ```
//! use cosmic_core::can::{Etag, TxNode, TxNodes};
//! use cosmic_core::protocol::{Class, Rank};
//! use cosmic_core::seal::{Seal, SealedChannel, SealedNode};
//! use cosmic_core::{NodeUid, Subject};
//!
//! const SENSOR: TxNode = TxNode::new(1).unwrap();
//! static SEAL: Seal = Seal {
//!     nodes: &[SealedNode { uid: NodeUid::new(0xC05A).unwrap(), tx_node: SENSOR, rank: Rank::new(0) }],
//!     channels: &[SealedChannel {
//!         subject: Subject::new(0x2A).unwrap(),
//!         etag: Etag::BOUND_LAST,
//!         class: Class::Soft,
//!         publishers: TxNodes::of(&[SENSOR]),
//!     }],
//!     brokers: &[],
//! };
//! ```

mod judge;
mod warden;

pub use warden::{Refusal, Refusals};

pub(crate) use warden::Warden;

use crate::can::{Etag, TxNode, TxNodes};
use crate::event_layer::{AnnounceError, ExceptionKind};
use crate::protocol::{Class, Rank};
use crate::services::Declaration;
use crate::uid::{NodeUid, Subject};

/// What the plan of a sealed cluster fixes. Constants, mostly made by `cosmic-plan`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Seal {
    /// All nodes.
    pub nodes: &'static [SealedNode],
    /// All channels.
    pub channels: &'static [SealedChannel],
    /// The nodes that may host a broker; none if there is none.
    pub brokers: &'static [NodeUid],
}

/// A node of a sealed cluster.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SealedNode {
    /// Its long name.
    pub uid: NodeUid,
    /// Its short name.
    pub tx_node: TxNode,
    /// Its place in the succession of time masters; `None`: it is never master.
    pub rank: Option<Rank>,
}

/// A channel of a sealed cluster.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SealedChannel {
    /// Its long name.
    pub subject: Subject,
    /// Its short name.
    pub etag: Etag,
    /// Its class.
    pub class: Class,
    /// Who may publish on it.
    pub publishers: TxNodes,
}

impl Seal {
    /// The node with this TxNode. O(nodes).
    pub fn node(&self, tx_node: TxNode) -> Option<&SealedNode> {
        self.nodes.iter().find(|node| node.tx_node == tx_node)
    }

    /// The node with this UID. O(nodes).
    pub fn node_of(&self, uid: NodeUid) -> Option<&SealedNode> {
        self.nodes.iter().find(|node| node.uid == uid)
    }

    /// Returns whether the node with this UID may host a broker. O(brokers).
    pub fn may_be_broker(&self, uid: NodeUid) -> bool {
        self.brokers.contains(&uid)
    }

    /// The channel with this etag. O(channels).
    pub fn channel(&self, etag: Etag) -> Option<&SealedChannel> {
        self.channels.iter().find(|channel| channel.etag == etag)
    }

    /// Who may publish on the channel of this subject; nobody on one that is not in the plan. O(channels).
    pub(crate) fn publishers(&self, subject: Subject) -> &'static TxNodes {
        let channel = self.channels.iter().find(|channel| channel.subject == subject);
        channel.map_or(&TxNodes::NONE, |channel| &channel.publishers)
    }

    /// Whether a node with this TxNode may do that on a channel. O(channels).
    ///
    /// # Errors
    /// [`AnnounceError::OutsidePlan`]
    pub(crate) fn permits(
        &self,
        own: Option<TxNode>,
        declaration: &Declaration,
    ) -> Result<(), AnnounceError> {
        let &Declaration { subject, etag, class, publishes, .. } = declaration;
        let channel = self.channels.iter().find(|channel| channel.subject == subject);
        let channel = channel.ok_or(AnnounceError::OutsidePlan)?;
        // Who gives a channel up may do so.
        let publishes = !publishes || own.is_some_and(|own| channel.publishers.contains(own));
        let permitted = etag == Some(channel.etag) && class == channel.class && publishes;
        if permitted { Ok(()) } else { Err(AnnounceError::OutsidePlan) }
    }
}

/// What contradicts the plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Contradiction {
    /// A node acts as broker, or as one that probes, that may not.
    Broker,
    /// A subject is said to have another etag than it has.
    Binding,
    /// A node acts as time master, or with a rank, that it has not.
    Master,
    /// A node that is not in the plan, or has another UID there.
    Node,
    /// A node announces a channel on which it may not publish.
    Publisher,
    /// Another node sends with this node's own TxNode.
    OwnTxNode,
}

impl Contradiction {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Broker, Self::Binding, Self::Master, Self::Node, Self::Publisher, Self::OwnTxNode];

    /// What the application is told.
    pub const fn exception(self) -> ExceptionKind {
        match self {
            Self::Broker => ExceptionKind::FalseBroker,
            Self::Binding => ExceptionKind::FalseBinding,
            Self::Master => ExceptionKind::FalseMaster,
            Self::Node => ExceptionKind::UnplannedNode,
            Self::Publisher => ExceptionKind::UnplannedPublisher,
            Self::OwnTxNode => ExceptionKind::DuplicateTxNode,
        }
    }
}
