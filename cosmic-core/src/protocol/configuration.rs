//! Configuration: from the long UID of a node to its TxNode.
//!
//! A node that has no TxNode yet cannot put one into its identifiers, so its request carries no sender
//! but four bits of the UID, and CAN arbitration searches the smallest UID among all that ask: sixteen
//! stages, from 15 (the first nibble) down to 0 (the last). Nodes with the same nibbles so far send the
//! same frame, which CAN merges; the others lose. After each stage the broker replies with the prefix
//! that it has heard; a node whose UID begins with it asks for the next stage, any other withdraws its
//! request and waits for the end. After stage 0 the broker knows one whole UID and assigns its TxNode.

use core::fmt;

use super::{control_data, control_frame, is_control, tx_node_of};
use crate::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use crate::uid::NodeUid;

/// A stage of configuration: 15 for the first nibble of the UID, down to 0 for the last.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stage(u8);

impl Stage {
    /// The first: the high nibble of byte 0 of the UID.
    pub const FIRST: Self = Self(15);
    /// The last: the low nibble of byte 7.
    pub const LAST: Self = Self(0);

    /// `None` above 15.
    pub const fn new(stage: u8) -> Option<Self> {
        if stage <= Self::FIRST.0 { Some(Self(stage)) } else { None }
    }

    /// 0..=15.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The stage that follows; `None` behind the last.
    pub const fn next(self) -> Option<Self> {
        match self.0.checked_sub(1) {
            Some(next) => Some(Self(next)),
            None => None,
        }
    }

    /// The nibble of `uid` that this stage asks about, 0..=15.
    pub const fn nibble_of(self, uid: NodeUid) -> u8 {
        (uid.get() >> self.shift()) as u8 & 0xF
    }

    /// Where the stage's nibble stands in the 64 bits of a UID.
    pub const fn shift(self) -> u32 {
        (self.0 as u32) << 2
    }
}

/// A node asks: "is there a UID whose nibble of this stage is this?"
///
/// Identifier bits 28..22 are 0x7D, 21..18 the stage, 17..14 the nibble; no data.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigurationRequest {
    stage: Stage,
    nibble: u8,
}

impl ConfigurationRequest {
    /// What a node with this UID asks at this stage.
    pub const fn new(uid: NodeUid, stage: Stage) -> Self {
        Self { stage, nibble: stage.nibble_of(uid) }
    }

    /// The stage.
    pub const fn stage(&self) -> Stage {
        self.stage
    }

    /// The nibble, 0..=15.
    pub const fn nibble(&self) -> u8 {
        self.nibble
    }

    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        let priority = Priority::new(Priority::CONFIGURATION.get() | self.stage.0 >> 3);
        let tx_node = tx_node_of(self.stage.0 << 4 | self.nibble);
        Frame::new(Id::new(priority, tx_node, Etag::CONFIGURATION_REQUEST), Payload::EMPTY)
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        if !is_control(frame.id, Etag::CONFIGURATION_REQUEST) || !frame.payload.is_empty() {
            return None;
        }
        let field = frame.id.tx_node().get();
        let stage = (frame.id.priority().get() & 1) << 3 | field >> 4;
        Some(Self { stage: Stage(stage), nibble: field & 0xF })
    }
}

/// The nibbles of a UID from the first down to those of `stage`, which is never the last stage: with
/// all sixteen nibbles it would be a UID.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Prefix {
    bits: u64,
    stage: Stage,
}

impl Prefix {
    /// The nibbles of `bits` down to those of `stage`; the rest of the bits is ignored. `None` at the last
    /// stage.
    pub const fn new(bits: u64, stage: Stage) -> Option<Self> {
        if stage.0 == Stage::LAST.0 {
            return None;
        }
        Some(Self { bits: bits >> stage.shift() << stage.shift(), stage })
    }

    /// The stage whose nibble is the last one known.
    pub const fn stage(&self) -> Stage {
        self.stage
    }

    /// Returns whether `uid` begins with these nibbles.
    pub const fn begins(&self, uid: NodeUid) -> bool {
        (uid.get() ^ self.bits) >> self.stage.shift() == 0
    }
}

impl fmt::Debug for Prefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Prefix({:016X} down to stage {})", self.bits, self.stage.0)
    }
}

/// What the broker answers to a configuration request.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigurationReply {
    /// The prefix so far; nodes whose UID begins with it ask for the next stage. Sent as
    /// [`TxNode::BROKER`], the stage in the low nibble of byte 7.
    Prefix(Prefix),
    /// The end: this UID has this TxNode, which stands in the TxNode field of the identifier.
    Assigned {
        /// The node.
        uid: NodeUid,
        /// Its id, never [`TxNode::BROKER`].
        tx_node: TxNode,
    },
    /// The broker gave up in the middle; all begin again at the first stage. Eight zero bytes.
    Restart,
}

impl ConfigurationReply {
    /// The frame of this message.
    ///
    /// An assignment of [`TxNode::BROKER`] cannot be expressed and is encoded as a restart.
    pub fn encode(&self) -> Frame {
        let (tx_node, data) = match *self {
            Self::Prefix(prefix) => (TxNode::BROKER, (prefix.bits | u64::from(prefix.stage.0)).to_be_bytes()),
            Self::Assigned { uid, tx_node } if tx_node != TxNode::BROKER => (tx_node, uid.to_bytes()),
            Self::Assigned { .. } | Self::Restart => (TxNode::BROKER, [0; 8]),
        };
        control_frame(tx_node, Etag::CONFIGURATION_REPLY, data)
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let bits = u64::from_be_bytes(control_data(frame, Etag::CONFIGURATION_REPLY)?);
        let tx_node = frame.id.tx_node();
        if tx_node != TxNode::BROKER {
            return Some(Self::Assigned { uid: NodeUid::new(bits)?, tx_node });
        }
        if bits == 0 {
            return Some(Self::Restart);
        }
        let prefix = Prefix::new(bits, Stage(bits as u8 & 0xF))?;
        (prefix.bits | u64::from(prefix.stage.0) == bits).then_some(Self::Prefix(prefix))
    }
}

/// The broker has no TxNode left for this UID. On an etag of its own, which old nodes ignore: to them
/// every reply on etag 0 is either a prefix or an assignment.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigurationRefusal {
    /// The node that gets no id.
    pub uid: NodeUid,
}

impl ConfigurationRefusal {
    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        control_frame(TxNode::BROKER, Etag::CONFIGURATION_REFUSAL, self.uid.to_bytes())
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let data = control_data(frame, Etag::CONFIGURATION_REFUSAL)?;
        (frame.id.tx_node() == TxNode::BROKER).then_some(())?;
        Some(Self { uid: NodeUid::from_bytes(data)? })
    }
}

super::identity::uid_message! {
    /// A node gives its TxNode back, because it leaves for good. The broker may then give the id to
    /// another node.
    Release, Etag::RELEASE
}

#[cfg(test)]
mod tests {
    use super::*;

    const UID: NodeUid = NodeUid::new(0x0123_4567_89AB_CDEF).unwrap();

    #[test]
    fn stages_walk_the_nibbles_from_the_first() {
        let mut stage = Some(Stage::FIRST);
        for nibble in 0..16 {
            assert_eq!(stage.unwrap().nibble_of(UID), nibble);
            stage = stage.unwrap().next();
        }
        assert_eq!(stage, None);
        assert_eq!(Stage::new(16), None);
    }

    #[test]
    fn a_prefix_begins_a_uid_or_not() {
        let prefix = Prefix::new(0x0123_0000_0000_0000, Stage::new(12).unwrap()).unwrap();
        assert!(prefix.begins(UID));
        assert!(!prefix.begins(NodeUid::new(0x0124_4567_89AB_CDEF).unwrap()));
        assert_eq!(Prefix::new(UID.get(), Stage::LAST), None);
        // What stands behind the stage does not matter.
        assert_eq!(Prefix::new(UID.get(), Stage::new(12).unwrap()), Some(prefix));
    }
}
