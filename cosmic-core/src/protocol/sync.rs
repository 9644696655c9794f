//! Clock synchronisation: the sync message and its follow-up (Gergeleit and Streich).
//!
//! Both travel at the most urgent soft real-time priority, so that no load delays them for long; the
//! sender stands in the TxNode field. A master sends a sync frame, reads its own clock when the frame
//! has been sent, and tells that instant in the follow-up. The two belong together by their sequence
//! number.

use crate::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use crate::time::{Duration, GlobalInstant};

/// The place of a node in the succession of time masters, 0..=15. A *lower* number comes first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rank(u8);

impl Rank {
    /// The first master.
    pub const FIRST: Self = Self(0);
    /// The last in the succession.
    pub const LAST: Self = Self(15);

    /// `None` above 15.
    pub const fn new(value: u8) -> Option<Self> {
        if value <= Self::LAST.0 { Some(Self(value)) } else { None }
    }

    /// The number, 0..=15.
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// The number of a sync frame, modulo 16.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SyncSequence(u8);

impl SyncSequence {
    /// The first number.
    pub const FIRST: Self = Self(0);

    /// The low four bits of `value`.
    pub const fn new(value: u8) -> Self {
        Self(value & 0x0F)
    }

    /// The number after this one.
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1) & 0x0F)
    }

    /// The number, 0..=15.
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// A frame whose end of transmission all nodes time-stamp.
///
/// | byte 0 | byte 1 | bytes 2..=3 | bytes 4..=7 |
/// |---|---|---|---|
/// | sequence (4 bits), rank (4) | predecessor | accuracy in ns | calendar digest |
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SyncMessage {
    /// The number of this frame.
    pub sequence: SyncSequence,
    /// The sender's place in the succession.
    pub rank: Rank,
    /// The node whose time scale the sender continues, soon after it has taken over; else the sender.
    pub predecessor: TxNode,
    /// How far the sender is from its predecessor's time scale at most; zero if there is none.
    pub accuracy: Duration,
    /// The digest of the sender's calendar, or 0 if it has none.
    pub calendar_digest: u32,
}

impl SyncMessage {
    /// The largest accuracy that the message can state. Longer ones are sent as this one.
    pub const LARGEST_ACCURACY: Duration = Duration::from_ticks(u16::MAX as u64);

    /// The frame that `sender` sends.
    pub fn encode(&self, sender: TxNode) -> Frame {
        let accuracy = self.accuracy.as_ticks().min(Self::LARGEST_ACCURACY.as_ticks()) as u16;
        let [accuracy_high, accuracy_low] = accuracy.to_be_bytes();
        let [d0, d1, d2, d3] = self.calendar_digest.to_be_bytes();
        let first = self.sequence.0 << 4 | self.rank.0;
        let bytes = [first, self.predecessor.get(), accuracy_high, accuracy_low, d0, d1, d2, d3];
        Frame::new(Id::new(Priority::SOFT_MOST_URGENT, sender, Etag::SYNC), Payload::full(bytes))
    }

    /// Reads a frame. `None` if its etag is another, its length is not eight, or the predecessor is no
    /// TxNode.
    pub fn decode(frame: &Frame) -> Option<Self> {
        if frame.id.etag() != Etag::SYNC || frame.payload.len() != 8 {
            return None;
        }
        let [first, predecessor, accuracy_high, accuracy_low, d0, d1, d2, d3] = frame.payload.padded();
        Some(Self {
            sequence: SyncSequence(first >> 4),
            rank: Rank(first & 0x0F),
            predecessor: TxNode::new(predecessor)?,
            accuracy: Duration::from_ticks(u16::from_be_bytes([accuracy_high, accuracy_low]).into()),
            calendar_digest: u32::from_be_bytes([d0, d1, d2, d3]),
        })
    }
}

/// When a sync frame was sent, by its sender's clock.
///
/// | byte 0 | bytes 1..=7 |
/// |---|---|
/// | sequence (4 bits), bits 59..56 of the instant | bits 55..0 of the instant |
///
/// Global time has 60 bits of nanoseconds on the wire. It starts anew at [`FollowUp::END`], far below the instant
/// at which these would wrap: a clock that has been led there never meets the wrap.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FollowUp {
    /// The number of the sync frame.
    pub sequence: SyncSequence,
    /// When its transmission ended, in global time.
    pub sent_at: GlobalInstant,
}

impl FollowUp {
    /// No time scale goes on until here, 18 years after its origin: a master starts it anew before, and nobody
    /// follows one that stands here or later.
    pub const END: GlobalInstant = GlobalInstant::from_epoch(Duration::from_ticks(1 << 59));

    const INSTANT_MASK: u64 = (1 << 60) - 1;

    /// The frame that `sender` sends. Bits of the instant above the 60th are lost.
    pub fn encode(&self, sender: TxNode) -> Frame {
        let instant = self.sent_at.since_epoch().as_ticks() & Self::INSTANT_MASK;
        let bytes = (u64::from(self.sequence.0) << 60 | instant).to_be_bytes();
        Frame::new(Id::new(Priority::SOFT_MOST_URGENT, sender, Etag::FOLLOW_UP), Payload::full(bytes))
    }

    /// Reads a frame. `None` if its etag is another or its length is not eight.
    pub fn decode(frame: &Frame) -> Option<Self> {
        if frame.id.etag() != Etag::FOLLOW_UP || frame.payload.len() != 8 {
            return None;
        }
        let bits = u64::from_be_bytes(frame.payload.padded());
        Some(Self {
            sequence: SyncSequence((bits >> 60) as u8),
            sent_at: GlobalInstant::from_epoch(Duration::from_ticks(bits & Self::INSTANT_MASK)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NODE: TxNode = TxNode::new(0x23).unwrap();

    #[test]
    fn literal_sync_frame() {
        let message = SyncMessage {
            sequence: SyncSequence::new(9),
            rank: Rank::new(2).unwrap(),
            predecessor: TxNode::new(5).unwrap(),
            accuracy: Duration::from_ticks(0x0A0B),
            calendar_digest: 0xDEAD_BEEF,
        };
        let frame = message.encode(NODE);
        assert_eq!(frame.id.raw(), 0x0028_C010);
        assert_eq!(frame.payload.as_slice(), [0x92, 0x05, 0x0A, 0x0B, 0xDE, 0xAD, 0xBE, 0xEF]);
        assert_eq!(SyncMessage::decode(&frame), Some(message));
        assert_eq!(FollowUp::decode(&frame), None);
    }

    #[test]
    fn literal_follow_up_frame() {
        let instant = Duration::from_ticks(0x0123_4567_89AB_CDEF);
        let message =
            FollowUp { sequence: SyncSequence::new(15), sent_at: GlobalInstant::from_epoch(instant) };
        let frame = message.encode(NODE);
        assert_eq!(frame.id.raw(), 0x0028_C011);
        assert_eq!(frame.payload.as_slice(), [0xF1, 0x23, 0x45, 0x67, 0x89, 0xAB, 0xCD, 0xEF]);
        assert_eq!(FollowUp::decode(&frame), Some(message));
        assert_eq!(SyncMessage::decode(&frame), None);
    }

    #[test]
    fn an_accuracy_beyond_the_field_is_sent_as_the_largest() {
        let message = SyncMessage {
            sequence: SyncSequence::FIRST,
            rank: Rank::FIRST,
            predecessor: NODE,
            accuracy: Duration::from_secs(1),
            calendar_digest: 0,
        };
        let read = SyncMessage::decode(&message.encode(NODE)).unwrap();
        assert_eq!(read.accuracy, SyncMessage::LARGEST_ACCURACY);
    }

    #[test]
    fn a_predecessor_that_is_no_node_is_refused() {
        let id = Id::new(Priority::SOFT_MOST_URGENT, NODE, Etag::SYNC);
        assert_eq!(SyncMessage::decode(&Frame::new(id, Payload::full([0, 0x80, 0, 0, 0, 0, 0, 0]))), None);
    }

    proptest! {
        #[test]
        fn what_is_read_is_written_again(bytes in any::<[u8; 8]>(), len in 0usize..=8, raw in 0u32..1 << 29) {
            let payload = Payload::truncated(bytes, len);
            for etag in [Etag::SYNC, Etag::FOLLOW_UP, Id::from_raw(raw).unwrap().etag()] {
                let frame = Frame::new(Id::new(Priority::SOFT_MOST_URGENT, NODE, etag), payload);
                if let Some(message) = SyncMessage::decode(&frame) {
                    prop_assert_eq!(message.encode(NODE), frame);
                }
                if let Some(message) = FollowUp::decode(&frame) {
                    prop_assert_eq!(message.encode(NODE), frame);
                }
            }
        }
    }
}
