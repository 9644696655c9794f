//! One record: 24 bytes, little-endian, for everything that happens to an event at a node.
//!
//! | bytes | field | published | delivered | exception | refused | subscribed | cancelled | lost |
//! |---|---|---|---|---|---|---|---|---|
//! | 0 | kind | 1 | 2 | 3 | 4 | 5 | 6 | 7 |
//! | 1 | detail | length of the content | TxNode of the publisher | number of the `ExceptionKind` | 1: a queue was full | see below | 0 | 0 |
//! | 2..4 | channel | its number in the plan | the same | the same, or 0xFFFF | the same | the same | the same | 0xFFFF |
//! | 4..8 | digest | of the content | of the content | 0 | of the content | depth of the queue | 0 | how many records |
//! | 8..16 | at | handed to the middleware | taken by the application | noticed | handed over | then | then | 0 |
//! | 16..24 | visible | 0 | became visible to the subscriber | 0 | 0 | 0 | 0 | 0 |
//!
//! The detail of a subscription: bit 0, only the latest event is kept; bit 1, not all events pass the filter.
//! Instants are nanoseconds of the node's local time. An event becomes visible when its frame has been received, and
//! a hard real-time event at its delivery instant.

use core::fmt;

use cosmic_core::can::TxNode;
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::{Duration, Instant};

/// Something that happened to an event at a node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Record {
    /// The channel: its number in the plan. `None` if it concerns the node as a whole, or a channel that is not in
    /// the plan.
    pub channel: Option<u16>,
    /// When, in local time.
    pub at: Instant,
    /// What.
    pub kind: RecordKind,
}

/// What happened.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RecordKind {
    /// The application published an event and the middleware took it.
    Published {
        /// Bytes of its content; 255 stands for all above, too.
        len: u8,
        /// Of its content.
        digest: Digest,
    },
    /// The application took an event from its subscription.
    Delivered {
        /// Of its content.
        digest: Digest,
        /// Who published it.
        publisher: TxNode,
        /// When it had become visible to the subscriber, in local time.
        visible_at: Instant,
    },
    /// The application was told of an exception.
    Exception(ExceptionKind),
    /// The application published an event and the middleware refused it.
    Refused {
        /// Of its content.
        digest: Digest,
        /// Whether a queue was full, of which an exception tells, too.
        queue_full: bool,
    },
    /// The application subscribed.
    Subscribed {
        /// How many events the subscription keeps.
        queue: Queue,
        /// Whether its filter holds back some events.
        filtered: bool,
    },
    /// The application gave up a subscription.
    Cancelled,
    /// Records were lost before this one, because nobody read them fast enough.
    Lost {
        /// How many.
        count: u32,
    },
}

/// How many events a subscription keeps for its application.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Queue {
    /// The newest.
    Latest,
    /// So many.
    Fifo(u32),
}

/// A digest of the bytes of a content: FNV-1a of 32 bits. It tells events of one channel apart, most of the time.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Digest(u32);

impl Digest {
    /// Of these bytes.
    pub const fn of(bytes: &[u8]) -> Self {
        let mut hash = 0x811C_9DC5_u32;
        let mut rest = bytes;
        while let [byte, more @ ..] = rest {
            hash = (hash ^ *byte as u32).wrapping_mul(0x0100_0193);
            rest = more;
        }
        Self(hash)
    }
}

/// A record is not one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RecordError {
    /// The kind is none.
    Kind(u8),
    /// The exception is none.
    Exception(u8),
    /// The TxNode has more than 7 bits.
    TxNode(u8),
}

impl fmt::Display for RecordError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, number) = match self {
            Self::Kind(kind) => ("kind", kind),
            Self::Exception(kind) => ("exception", kind),
            Self::TxNode(node) => ("TxNode", node),
        };
        write!(f, "{what} {number} of a record is unknown: build firmware and judge from the same source")
    }
}

impl core::error::Error for RecordError {}

impl Record {
    /// The length of a record.
    pub const LEN: usize = 24;
    const NO_CHANNEL: u16 = u16::MAX;

    /// The bytes.
    pub fn encode(&self) -> [u8; Self::LEN] {
        let nothing = Instant::EPOCH;
        let (kind, detail, word, visible_at) = match self.kind {
            RecordKind::Published { len, digest } => (1, len, digest.0, nothing),
            RecordKind::Delivered { digest, publisher, visible_at } => {
                (2, publisher.get(), digest.0, visible_at)
            }
            RecordKind::Exception(kind) => (3, kind as u8, 0, nothing),
            RecordKind::Refused { digest, queue_full } => (4, u8::from(queue_full), digest.0, nothing),
            RecordKind::Subscribed { queue, filtered } => {
                let (latest, depth) = match queue {
                    Queue::Latest => (LATEST, 1),
                    Queue::Fifo(depth) => (0, depth),
                };
                (5, latest | if filtered { FILTERED } else { 0 }, depth, nothing)
            }
            RecordKind::Cancelled => (6, 0, 0, nothing),
            RecordKind::Lost { count } => (7, 0, count, nothing),
        };
        let [c0, c1] = self.channel.unwrap_or(Self::NO_CHANNEL).to_le_bytes();
        let [w0, w1, w2, w3] = word.to_le_bytes();
        let [a0, a1, a2, a3, a4, a5, a6, a7] = self.at.since_epoch().as_ticks().to_le_bytes();
        let [v0, v1, v2, v3, v4, v5, v6, v7] = visible_at.since_epoch().as_ticks().to_le_bytes();
        [kind, detail, c0, c1, w0, w1, w2, w3, a0, a1, a2, a3, a4, a5, a6, a7, v0, v1, v2, v3, v4, v5, v6, v7]
    }

    /// Reads one.
    ///
    /// # Errors
    /// The first field that has no meaning.
    pub fn decode(bytes: &[u8; Self::LEN]) -> Result<Self, RecordError> {
        let [kind, detail, c0, c1, w0, w1, w2, w3, rest @ ..] = *bytes;
        let [a0, a1, a2, a3, a4, a5, a6, a7, v0, v1, v2, v3, v4, v5, v6, v7] = rest;
        let instant = |bytes| Instant::from_epoch(Duration::from_ticks(u64::from_le_bytes(bytes)));
        let word = u32::from_le_bytes([w0, w1, w2, w3]);
        let digest = Digest(word);
        let kind = match kind {
            1 => RecordKind::Published { len: detail, digest },
            2 => RecordKind::Delivered {
                digest,
                publisher: TxNode::new(detail).ok_or(RecordError::TxNode(detail))?,
                visible_at: instant([v0, v1, v2, v3, v4, v5, v6, v7]),
            },
            3 => RecordKind::Exception(exception_kind(detail).ok_or(RecordError::Exception(detail))?),
            4 => RecordKind::Refused { digest, queue_full: detail != 0 },
            5 => RecordKind::Subscribed {
                queue: if detail & LATEST != 0 { Queue::Latest } else { Queue::Fifo(word) },
                filtered: detail & FILTERED != 0,
            },
            6 => RecordKind::Cancelled,
            7 => RecordKind::Lost { count: word },
            _ => return Err(RecordError::Kind(kind)),
        };
        let channel = u16::from_le_bytes([c0, c1]);
        let channel = (channel != Self::NO_CHANNEL).then_some(channel);
        Ok(Self { channel, at: instant([a0, a1, a2, a3, a4, a5, a6, a7]), kind })
    }
}

fn exception_kind(number: u8) -> Option<ExceptionKind> {
    ExceptionKind::ALL.get(usize::from(number)).copied()
}

const LATEST: u8 = 1;
const FILTERED: u8 = 2;

#[cfg(test)]
mod tests {
    use super::*;

    const DELIVERED: [u8; Record::LEN] =
        [2, 1, 3, 0, 0xC5, 0x9D, 0x1C, 0x81, 0x40, 0x42, 0x0F, 0, 0, 0, 0, 0, 0xE8, 3, 0, 0, 0, 0, 0, 0];

    fn instant(nanoseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_ticks(nanoseconds))
    }

    #[test]
    fn exceptions_have_the_numbers_of_their_order() {
        for (number, kind) in ExceptionKind::ALL.iter().enumerate() {
            assert_eq!(*kind as usize, number);
        }
    }

    #[test]
    fn a_literal_record() {
        let record = Record::decode(&DELIVERED).unwrap();
        let (publisher, digest) = (TxNode::new(1).unwrap(), Digest::of(&[]));
        let kind = RecordKind::Delivered { digest, publisher, visible_at: instant(1_000) };
        assert_eq!(record, Record { channel: Some(3), at: instant(1_000_000), kind });
        assert_eq!(record.encode(), DELIVERED);
    }

    #[test]
    fn every_kind_comes_back_from_its_bytes() {
        let digest = Digest::of(b"foobar");
        assert_eq!(digest, Digest(0xBF9C_F968));
        for kind in [
            RecordKind::Published { len: 7, digest },
            RecordKind::Exception(ExceptionKind::BusOff),
            RecordKind::Refused { digest, queue_full: true },
            RecordKind::Refused { digest, queue_full: false },
            RecordKind::Subscribed { queue: Queue::Latest, filtered: false },
            RecordKind::Subscribed { queue: Queue::Fifo(65_536), filtered: true },
            RecordKind::Cancelled,
            RecordKind::Lost { count: u32::MAX },
        ] {
            for channel in [None, Some(0), Some(999)] {
                let record = Record { channel, at: instant(u64::MAX), kind };
                assert_eq!(Record::decode(&record.encode()), Ok(record));
            }
        }
    }

    #[test]
    fn what_is_no_record_is_named() {
        let wrong = |at: usize, value: u8| {
            let mut bytes = DELIVERED;
            bytes[at] = value;
            Record::decode(&bytes)
        };
        assert_eq!(wrong(0, 9), Err(RecordError::Kind(9)));
        assert_eq!(wrong(0, 0), Err(RecordError::Kind(0)));
        assert_eq!(wrong(1, 200), Err(RecordError::TxNode(200)));
    }
}
