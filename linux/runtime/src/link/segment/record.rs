//! What crosses the socket of a segment.

use cosmic_bus::{VirtualInstant, WireFrame};
use cosmic_core::can::Mailbox;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};

/// Of the records; both sides must have the same.
pub const VERSION: u8 = 1;

/// One record, 24 bytes: `[kind, argument, length, flags, identifier (4), data (8), instant (8)]`, big-endian; bytes
/// that a kind does not use are zero.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Record {
    /// 1, to the server: put the frame into the mailbox.
    Load {
        /// The argument.
        mailbox: Mailbox,
        /// Length, flags (1 extended, 2 remote), identifier and data.
        frame: WireFrame,
    },
    /// 2, to the server: withdraw the frame of the mailbox.
    Withdraw {
        /// The argument.
        mailbox: Mailbox,
    },
    /// 128, first from the server.
    Hello {
        /// The argument.
        version: u8,
        /// In the place of the identifier.
        bits_per_second: u32,
    },
    /// 129: a frame was received.
    Received {
        /// As for `Load`.
        frame: WireFrame,
        /// When, in nanoseconds of the segment's time.
        at: VirtualInstant,
    },
    /// 130: the frame of the mailbox was sent.
    Sent {
        /// The argument.
        mailbox: Mailbox,
    },
    /// 131: it was withdrawn.
    Withdrawn {
        /// The argument.
        mailbox: Mailbox,
    },
    /// 132: so many records were lost, because the client does not read.
    Lost {
        /// In the place of the identifier.
        count: u32,
    },
    /// 133: the error counters have changed.
    Errors {
        /// The argument.
        transmit: u8,
        /// In the place of the length.
        receive: u8,
    },
    /// 134: the station has left the bus.
    BusOff,
}

impl Record {
    /// Bytes of a record.
    pub const LEN: usize = 24;

    /// Its bytes.
    pub fn encode(&self) -> [u8; Self::LEN] {
        match *self {
            Self::Load { mailbox, frame } => with_frame(1, mailbox as u8, &frame, 0),
            Self::Withdraw { mailbox } => plain(2, mailbox as u8, 0, 0),
            Self::Hello { version, bits_per_second } => plain(128, version, 0, bits_per_second),
            Self::Received { frame, at } => with_frame(129, 0, &frame, at.as_ticks()),
            Self::Sent { mailbox } => plain(130, mailbox as u8, 0, 0),
            Self::Withdrawn { mailbox } => plain(131, mailbox as u8, 0, 0),
            Self::Lost { count } => plain(132, 0, 0, count),
            Self::Errors { transmit, receive } => plain(133, transmit, receive, 0),
            Self::BusOff => plain(134, 0, 0, 0),
        }
    }

    /// The record that these bytes are, if they are one.
    pub fn decode(bytes: &[u8; Self::LEN]) -> Option<Self> {
        let [kind, argument, length, flags, rest @ ..] = *bytes;
        let (identifier, rest) = rest.split_first_chunk::<4>()?;
        let (data, instant) = rest.split_first_chunk::<8>()?;
        let number = u32::from_be_bytes(*identifier);
        let mailbox = Mailbox::ALL.get(usize::from(argument)).copied();
        let frame = || {
            let id = match flags & 1 {
                0 => Id::Standard(StandardId::new(u16::try_from(number).ok()?)?),
                _ => Id::Extended(ExtendedId::new(number)?),
            };
            let data = data.get(..usize::from(length))?;
            match flags {
                0 | 1 => WireFrame::new(id, data),
                2 | 3 => WireFrame::new_remote(id, data.len()),
                _ => None,
            }
        };
        Some(match kind {
            1 => Self::Load { mailbox: mailbox?, frame: frame()? },
            2 => Self::Withdraw { mailbox: mailbox? },
            128 => Self::Hello { version: argument, bits_per_second: number },
            129 => Self::Received {
                frame: frame()?,
                at: VirtualInstant::from_ticks(u64::from_be_bytes(instant.try_into().ok()?)),
            },
            130 => Self::Sent { mailbox: mailbox? },
            131 => Self::Withdrawn { mailbox: mailbox? },
            132 => Self::Lost { count: number },
            133 => Self::Errors { transmit: argument, receive: length },
            134 => Self::BusOff,
            _ => return None,
        })
    }
}

fn plain(kind: u8, argument: u8, length: u8, number: u32) -> [u8; Record::LEN] {
    let mut bytes = [0; Record::LEN];
    bytes[..4].copy_from_slice(&[kind, argument, length, 0]);
    bytes[4..8].copy_from_slice(&number.to_be_bytes());
    bytes
}

fn with_frame(kind: u8, argument: u8, frame: &WireFrame, at: u64) -> [u8; Record::LEN] {
    let number = frame.arbitration().raw_id();
    // A length code above eight says no more than eight.
    let length = u8::try_from(frame.dlc().min(8)).unwrap_or(8);
    let mut bytes = plain(kind, argument, length, number);
    bytes[3] = u8::from(frame.is_extended()) | u8::from(frame.is_remote_frame()) << 1;
    bytes[8..16].copy_from_slice(&frame.padded_data());
    bytes[16..].copy_from_slice(&at.to_be_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn records_have_their_bytes() {
        let frame = WireFrame::new(ExtendedId::new(0x1F5F_C004).unwrap(), &[0xAA, 1]).unwrap();
        let received = Record::Received { frame, at: VirtualInstant::from_ticks(0x1234) };
        assert_eq!(
            received.encode(),
            [129, 0, 2, 1, 0x1F, 0x5F, 0xC0, 4, 0xAA, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x12, 0x34]
        );
        assert_eq!(Record::decode(&received.encode()), Some(received));
        let remote = WireFrame::new_remote(StandardId::new(0x123).unwrap(), 2).unwrap();
        for record in [
            Record::Load { mailbox: Mailbox::Soft, frame },
            Record::Load { mailbox: Mailbox::NonRealTime, frame: remote },
            Record::Withdraw { mailbox: Mailbox::NonRealTime },
            Record::Hello { version: 1, bits_per_second: 500_000 },
            Record::Sent { mailbox: Mailbox::Soft },
            Record::Withdrawn { mailbox: Mailbox::Soft },
            Record::Lost { count: 7 },
            Record::Errors { transmit: 128, receive: 3 },
            Record::BusOff,
        ] {
            assert_eq!(Record::decode(&record.encode()), Some(record));
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_record_or_none(bytes in any::<[u8; Record::LEN]>()) {
            if let Some(record) = Record::decode(&bytes) {
                prop_assert_eq!(Record::decode(&record.encode()), Some(record));
            }
        }
    }
}
