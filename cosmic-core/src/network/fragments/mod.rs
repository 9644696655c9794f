//! Messages longer than a frame, on non real-time channels: fragmentation and reassembly.
//!
//! A channel either carries plain events of up to eight bytes, or messages; on a channel of messages
//! *every* frame starts with the header byte, also that of a short message. Frames of one message come
//! in order, since they have one identifier; messages of other publishers and channels come in between,
//! and are told apart by etag and TxNode.
//!
//! | bits of byte 0 | meaning |
//! |---|---|
//! | 7 | first frame of a message |
//! | 6 | last frame of a message |
//! | 5..4 | number of the message, modulo 4, counted for each channel by its publisher |
//! | 3..0 | number of the frame in the message, modulo 16 |
//!
//! * A message of up to 7 bytes is one frame, first and last at once: header, content.
//! * A longer one is followed by its CRC-16 (init 0xFFFF, polynomial 0x1021, big-endian), and content and
//!   CRC are cut into pieces of 7 bytes. All frames but the last carry 8 bytes.
//!
//! What a receiver sees of a fault: a frame that is missing breaks the sequence, and the message is
//! dropped; a frame that is repeated (the sender repeats one that some node has rejected) is ignored; a
//! message that stops is dropped after a time-out, or when the next one begins. If so many frames are
//! missing that the numbers fit again, the CRC still rejects the message in all but one of 65 536 cases.
//! A message is delivered whole or not at all, and whatever is dropped is counted.
//!
//! [`Fragmenter`] gives out one frame at a time, so that a long message does not fill the queue:
//!
//! ```
//! use cosmic_core::can::{Etag, Frame, Id, Priority, TxNode};
//! use cosmic_core::network::fragments::{Fragmenter, Reassembler};
//! use cosmic_core::time::{Duration, Instant};
//!
//! let id = Id::new(Priority::LEAST, TxNode::MIN, Etag::BOUND_LAST);
//! let mut sender = Fragmenter::<64>::new();
//! let mut receiver = Reassembler::<4, 64>::new(Duration::from_secs(1));
//! sender.start(b"longer than eight bytes").unwrap();
//! let mut content = None;
//! while let Some(payload) = sender.poll() {
//!     let message = receiver.on_frame(&Frame::new(id, payload), Instant::EPOCH);
//!     content = message.map(|message| message.content.to_vec());
//!     sender.on_sent();
//! }
//! assert_eq!(content.as_deref(), Some(b"longer than eight bytes".as_slice()));
//! ```

mod receive;
mod send;

pub use receive::{Message, Reassembler, ReassemblyCounters};
pub use send::{Fragmenter, StartError};

use crate::can::Payload;

/// The first byte of every frame on a channel of messages.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Header {
    first: bool,
    last: bool,
    message: u8,
    sequence: u8,
}

impl Header {
    const FIRST: u8 = 0x80;
    const LAST: u8 = 0x40;

    const fn encode(self) -> u8 {
        let first = if self.first { Self::FIRST } else { 0 };
        let last = if self.last { Self::LAST } else { 0 };
        first | last | (self.message & MESSAGE_MASK) << 4 | self.sequence & SEQUENCE_MASK
    }

    const fn decode(byte: u8) -> Self {
        Self {
            first: byte & Self::FIRST != 0,
            last: byte & Self::LAST != 0,
            message: byte >> 4 & MESSAGE_MASK,
            sequence: byte & SEQUENCE_MASK,
        }
    }
}

/// Continues the CRC of a message over more of it.
fn continue_crc(crc: u16, bytes: &[u8]) -> u16 {
    let mut digest = CRC.digest_with_initial(crc);
    digest.update(bytes);
    digest.finalize()
}

/// Neither reflected nor inverted at the end: over a message with its CRC behind it, it is zero.
static CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_IBM_3740);
const CRC_START: u16 = crc::CRC_16_IBM_3740.init;
const CRC_LEN: usize = 2;

/// How many bytes a frame carries behind the header.
const PIECE: usize = Payload::MAX_LEN - 1;

/// How many frames a message of so many bytes takes.
pub const fn frames_of(len: usize) -> usize {
    if len <= PIECE { 1 } else { len.saturating_add(CRC_LEN).div_ceil(PIECE) }
}

/// Whether a frame is the first one of a message.
pub fn begins(fragment: &Payload) -> bool {
    fragment.as_slice().first().is_some_and(|header| Header::decode(*header).first)
}

/// Bytes of a message at most: what takes less than half a second at 50 kbit/s.
pub const MAX_MESSAGE_LEN: usize = 1024;
const MESSAGE_MASK: u8 = 0x03;
const SEQUENCE_MASK: u8 = 0x0F;

#[cfg(test)]
mod tests;
