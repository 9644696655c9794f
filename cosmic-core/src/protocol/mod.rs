//! The control messages: one type each, with `encode` and `decode`.
//!
//! Control messages are ordinary frames with an etag of the reserved range and the priority
//! [`Priority::CONFIGURATION`]. They need no channel, so a node can send them before it knows any.
//! Multi-byte fields are big-endian. `docs/protocol.md` has a table with a literal frame of each.
//!
//! | messages | serve | served by |
//! |---|---|---|
//! | [`ConfigurationRequest`], [`ConfigurationReply`], [`ConfigurationRefusal`], [`Release`] | long node UID to TxNode | `client`, `broker` |
//! | [`GetEtag`], [`SupplyEtag`] | subject to etag | `client`, `broker` |
//! | [`NodeIdentity`], [`Probe`], [`BrokerStatus`] | detection of duplicates, rebuilding a broker's table, fail-over | `client`, `broker` |
//! | [`Interest`], [`NodeStatus`] | who wants what, who is alive | `membership` |
//! | [`AdmissionRequest`], [`AdmissionReply`] | soft channels that the plan does not know | `admission` |
//!
//! Configuration and binding have the layout of FAMOUSO's CAN configuration and etag binding protocols,
//! so that an old broker serves our nodes and ours serves old nodes. The old broker leaves the top bit of
//! the stage in bit 21 of its replies, therefore that bit is ignored in every frame but the request.
//! What is new here uses etags and codes that old nodes ignore.
//!
//! `decode` takes any frame and returns `None` for one that is not exactly a message of its type; it
//! never panics, and takes constant time. A value that was decoded is valid, and encodes to a frame
//! that decodes to it again.

use crate::can::{Etag, Frame, Id, Payload, Priority, TxNode};

mod admission;
mod binding;
mod configuration;
mod halves;
mod identity;
mod interest;
mod output;
mod status;
mod sync;

pub use admission::{
    AdmissionRefusal, AdmissionReply, AdmissionRequest, AdmissionVerdict, AskNumber, CoarseSpan,
    RefusalReason,
};
pub use binding::{Answer, GetEtag, Half, SupplyEtag};
pub use configuration::{
    ConfigurationRefusal, ConfigurationReply, ConfigurationRequest, Prefix, Release, Stage,
};
pub(crate) use halves::{Halves, Supply};
pub use identity::{BrokerStatus, NodeIdentity, Probe};
pub use interest::{Class, Interest, LayoutHash, Lease, Side};
pub use output::Output;
pub use status::{NodeState, NodeStatus, ResetCause, Uptime};
pub use sync::{FollowUp, Rank, SyncMessage, SyncSequence};

/// Any control message of configuration, binding and membership.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ControlMessage {
    /// A node asks for its TxNode.
    ConfigurationRequest(ConfigurationRequest),
    /// The broker confirms a prefix, assigns an id, or starts over.
    ConfigurationReply(ConfigurationReply),
    /// The broker has no TxNode left.
    ConfigurationRefusal(ConfigurationRefusal),
    /// A node gives its TxNode back.
    Release(Release),
    /// A node claims its TxNode.
    NodeIdentity(NodeIdentity),
    /// Asks the nodes to say who they are and what they use.
    Probe(Probe),
    /// Heartbeat of the active broker.
    BrokerStatus(BrokerStatus),
    /// A node asks for an etag.
    GetEtag(GetEtag),
    /// Half of a binding.
    SupplyEtag(SupplyEtag),
    /// A node wants or offers a channel.
    Interest(Interest),
    /// A node is alive.
    NodeStatus(NodeStatus),
    /// A node asks for a channel that the plan does not know.
    AdmissionRequest(AdmissionRequest),
    /// The broker's node admits it, or says why not.
    AdmissionReply(AdmissionReply),
}

impl ControlMessage {
    /// The message in `frame`, if it is one. Constant time.
    pub fn decode(frame: &Frame) -> Option<Self> {
        match frame.id.etag() {
            Etag::CONFIGURATION_REQUEST => {
                ConfigurationRequest::decode(frame).map(Self::ConfigurationRequest)
            }
            Etag::CONFIGURATION_REPLY => ConfigurationReply::decode(frame).map(Self::ConfigurationReply),
            Etag::CONFIGURATION_REFUSAL => {
                ConfigurationRefusal::decode(frame).map(Self::ConfigurationRefusal)
            }
            Etag::RELEASE => Release::decode(frame).map(Self::Release),
            Etag::NODE_IDENTITY => NodeIdentity::decode(frame).map(Self::NodeIdentity),
            Etag::PROBE => Probe::decode(frame).map(Self::Probe),
            Etag::BROKER_STATUS => BrokerStatus::decode(frame).map(Self::BrokerStatus),
            Etag::GET_ETAG => GetEtag::decode(frame).map(Self::GetEtag),
            Etag::SUPPLY_ETAG => SupplyEtag::decode(frame).map(Self::SupplyEtag),
            Etag::INTEREST => Interest::decode(frame).map(Self::Interest),
            Etag::NODE_STATUS => NodeStatus::decode(frame).map(Self::NodeStatus),
            Etag::ADMISSION_REQUEST => AdmissionRequest::decode(frame).map(Self::AdmissionRequest),
            Etag::ADMISSION_REPLY => AdmissionReply::decode(frame).map(Self::AdmissionReply),
            _ => None,
        }
    }

    /// The frame of the message.
    pub fn encode(&self) -> Frame {
        match self {
            Self::ConfigurationRequest(message) => message.encode(),
            Self::ConfigurationReply(message) => message.encode(),
            Self::ConfigurationRefusal(message) => message.encode(),
            Self::Release(message) => message.encode(),
            Self::NodeIdentity(message) => message.encode(),
            Self::Probe(message) => message.encode(),
            Self::BrokerStatus(message) => message.encode(),
            Self::GetEtag(message) => message.encode(),
            Self::SupplyEtag(message) => message.encode(),
            Self::Interest(message) => message.encode(),
            Self::NodeStatus(message) => message.encode(),
            Self::AdmissionRequest(message) => message.encode(),
            Self::AdmissionReply(message) => message.encode(),
        }
    }
}

/// Returns whether the TxNode field of this frame names its sender.
///
/// It does in all frames but those of configuration (there it holds a part of a UID, or the id that is
/// assigned) and those that the broker sends as [`TxNode::BROKER`].
pub const fn names_its_sender(id: Id) -> bool {
    !matches!(id.etag(), Etag::CONFIGURATION_REQUEST | Etag::CONFIGURATION_REPLY)
        && id.tx_node().get() != TxNode::BROKER.get()
}

/// A control frame of eight bytes.
fn control_frame(tx_node: TxNode, etag: Etag, data: [u8; 8]) -> Frame {
    Frame::new(Id::new(Priority::CONFIGURATION, tx_node, etag), Payload::full(data))
}

/// The bytes of `frame`, if it is a control frame of eight bytes with this etag; bit 21 is ignored.
fn control_data(frame: &Frame, etag: Etag) -> Option<[u8; 8]> {
    let full = frame.payload.len() == Payload::MAX_LEN;
    (full && is_control(frame.id, etag)).then(|| frame.payload.padded())
}

fn is_control(id: Id, etag: Etag) -> bool {
    id.etag() == etag && id.priority().get() | 1 == Priority::CONFIGURATION.get() | 1
}

/// The low seven bits as a TxNode: every value of the field is one.
fn tx_node_of(bits: u8) -> TxNode {
    TxNode::new(bits & TxNode::BROKER.get()).unwrap_or(TxNode::BROKER)
}

/// The low fourteen bits as an etag: every value of the field is one.
fn etag_of(bits: u16) -> Etag {
    Etag::new(bits & Etag::BOUND_LAST.get()).unwrap_or(Etag::BOUND_LAST)
}
