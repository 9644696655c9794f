//! Who a node is: claims of a TxNode, the probe that asks for them, and the heartbeat of the broker.

use super::is_control;
use crate::can::{Etag, Frame, Id, Payload, Priority, TxNode};

/// A message `[64-bit node UID]` with the sender's TxNode in the identifier.
macro_rules! uid_message {
    ($(#[$doc:meta])* $name:ident, $etag:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name {
            /// The sender's TxNode.
            pub tx_node: $crate::can::TxNode,
            /// The sender's UID.
            pub uid: $crate::uid::NodeUid,
        }

        impl $name {
            /// The frame of this message.
            pub fn encode(&self) -> $crate::can::Frame {
                $crate::protocol::control_frame(self.tx_node, $etag, self.uid.to_bytes())
            }

            /// The message in `frame`, if it is one.
            pub fn decode(frame: &$crate::can::Frame) -> Option<Self> {
                let data = $crate::protocol::control_data(frame, $etag)?;
                let uid = $crate::uid::NodeUid::from_bytes(data)?;
                Some(Self { tx_node: frame.id.tx_node(), uid })
            }
        }
    };
}
pub(super) use uid_message;

uid_message! {
    /// "This TxNode is mine, and this is my UID": sent when a node gets its id, when it hears another
    /// node with it, and when it is probed.
    NodeIdentity, Etag::NODE_IDENTITY
}

uid_message! {
    /// Heartbeat of the active broker, sent with the TxNode of the node that hosts it; the UID is that
    /// node's, and its rank: of two brokers the one with the lower UID stays.
    BrokerStatus, Etag::BROKER_STATUS
}

/// Asks every node for its [`NodeIdentity`], its bindings and its interest. A broker sends it when it
/// has to rebuild its tables; no data.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Probe {
    /// The sender's TxNode.
    pub tx_node: TxNode,
}

impl Probe {
    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        Frame::new(Id::new(Priority::CONFIGURATION, self.tx_node, Etag::PROBE), Payload::EMPTY)
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let probe = is_control(frame.id, Etag::PROBE) && frame.payload.is_empty();
        probe.then_some(Self { tx_node: frame.id.tx_node() })
    }
}
