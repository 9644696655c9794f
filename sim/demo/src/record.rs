//! The records that the nodes write into their RTT channel `records` ([`cosmic_records`]).

pub use cosmic_records::{Digest, Queue, Record, RecordError, RecordKind};

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

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::time::Instant;

    #[test]
    fn records_are_found_in_pieces_of_any_length() {
        let kind = RecordKind::Refused { digest: Digest::of(b"abc"), queue_full: true };
        let record = Record { channel: Some(7), at: Instant::EPOCH, kind };
        let stream: Vec<u8> = record.encode().into_iter().cycle().take(5 * Record::LEN).collect();
        for length in 1..stream.len() {
            let (mut records, mut found) = (Records::default(), Vec::new());
            for piece in stream.chunks(length) {
                records.take(piece, &mut found).unwrap();
            }
            assert_eq!(found, [record; 5]);
        }
    }
}
