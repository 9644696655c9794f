//! The records that the firmware writes into its RTT channel `records`.
//!
//! One record of [`Record::LEN`] bytes, little-endian, for everything that happened to an event at a node
//! (`firmware/src/records.rs` has the other end). Instants are local time of the node.

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::{Duration, Instant};
use thiserror::Error;

/// Something that happened to an event at a node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Record {
    /// The channel; `None` if it concerns the node as a whole.
    pub etag: Option<Etag>,
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
        /// The number of the event.
        sequence: u32,
    },
    /// The application took an event from its subscription.
    Delivered {
        /// The number of the event.
        sequence: u32,
        /// Who published it.
        publisher: TxNode,
        /// When it had become visible to the subscriber, in local time.
        visible_at: Instant,
    },
    /// The application was told of an exception.
    Exception(ExceptionKind),
    /// The application published an event and the middleware refused it.
    Refused {
        /// The number of the event.
        sequence: u32,
    },
}

/// A record is not one.
#[derive(Clone, Copy, PartialEq, Eq, Error, Debug)]
pub enum RecordError {
    /// The kind is none.
    #[error("kind {0} of a record is unknown: build firmware and demo from the same source")]
    Kind(u8),
    /// The exception is none.
    #[error("exception {0} of a record is unknown: build firmware and demo from the same source")]
    Exception(u8),
    /// The etag has more than 14 bits.
    #[error("etag {0} of a record is none: build firmware and demo from the same source")]
    Etag(u16),
    /// The TxNode has more than 7 bits.
    #[error("TxNode {0} of a record is none: build firmware and demo from the same source")]
    TxNode(u8),
}

impl Record {
    /// The length of a record.
    pub const LEN: usize = 24;
    const NO_ETAG: u16 = u16::MAX;

    /// Reads one.
    ///
    /// # Errors
    /// The first field that has no meaning.
    pub fn decode(bytes: &[u8; Self::LEN]) -> Result<Self, RecordError> {
        let [kind, detail, e0, e1, s0, s1, s2, s3, rest @ ..] = *bytes;
        let [a0, a1, a2, a3, a4, a5, a6, a7, v0, v1, v2, v3, v4, v5, v6, v7] = rest;
        let instant = |bytes| Instant::from_epoch(Duration::from_ticks(u64::from_le_bytes(bytes)));
        let sequence = u32::from_le_bytes([s0, s1, s2, s3]);
        let kind = match kind {
            1 => RecordKind::Published { sequence },
            2 => RecordKind::Delivered {
                sequence,
                publisher: TxNode::new(detail).ok_or(RecordError::TxNode(detail))?,
                visible_at: instant([v0, v1, v2, v3, v4, v5, v6, v7]),
            },
            3 => RecordKind::Exception(exception_kind(detail).ok_or(RecordError::Exception(detail))?),
            4 => RecordKind::Refused { sequence },
            _ => return Err(RecordError::Kind(kind)),
        };
        let etag = match u16::from_le_bytes([e0, e1]) {
            Self::NO_ETAG => None,
            etag => Some(Etag::new(etag).ok_or(RecordError::Etag(etag))?),
        };
        Ok(Self { etag, at: instant([a0, a1, a2, a3, a4, a5, a6, a7]), kind })
    }
}

/// Cuts the bytes of the RTT channel, which come in pieces of any length, into records.
#[derive(Clone, Debug, Default)]
pub struct Records {
    pending: Vec<u8>,
}

impl Records {
    /// Takes some more bytes and appends the records that are complete now.
    ///
    /// # Errors
    /// Those of [`Record::decode`].
    pub fn take(&mut self, bytes: &[u8], into: &mut Vec<Record>) -> Result<(), RecordError> {
        self.pending.extend_from_slice(bytes);
        let (records, rest) = self.pending.as_chunks::<{ Record::LEN }>();
        for record in records {
            into.push(Record::decode(record)?);
        }
        self.pending = rest.to_vec();
        Ok(())
    }
}

fn exception_kind(number: u8) -> Option<ExceptionKind> {
    ExceptionKind::ALL.get(usize::from(number)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    const DELIVERED: [u8; Record::LEN] =
        [2, 1, 100, 0, 7, 0, 0, 0, 0x40, 0x42, 0x0F, 0, 0, 0, 0, 0, 0xE8, 3, 0, 0, 0, 0, 0, 0];

    fn instant(nanoseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_ticks(nanoseconds))
    }

    #[test]
    fn exceptions_have_the_numbers_that_the_firmware_writes() {
        for (number, kind) in ExceptionKind::ALL.iter().enumerate() {
            assert_eq!(*kind as usize, number);
        }
    }

    #[test]
    fn a_literal_record() {
        let record = Record::decode(&DELIVERED).unwrap();
        assert_eq!(record.etag, Etag::new(100));
        assert_eq!(record.at, instant(1_000_000));
        let publisher = TxNode::new(1).unwrap();
        assert_eq!(record.kind, RecordKind::Delivered { sequence: 7, publisher, visible_at: instant(1_000) });
    }

    #[test]
    fn records_are_found_in_pieces_of_any_length() {
        let stream: Vec<u8> = DELIVERED.iter().cycle().take(5 * Record::LEN).copied().collect();
        for length in 1..stream.len() {
            let (mut records, mut found) = (Records::default(), Vec::new());
            for piece in stream.chunks(length) {
                records.take(piece, &mut found).unwrap();
            }
            assert_eq!(found, [Record::decode(&DELIVERED).unwrap(); 5]);
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
        assert_eq!(wrong(1, 200), Err(RecordError::TxNode(200)));
        assert_eq!(wrong(3, 0x40), Err(RecordError::Etag(0x4064)));
        assert_eq!(wrong(3, 0x40).unwrap_err().to_string().lines().count(), 1);
    }
}
