//! The bits of a frame: fields, CRC-15, bit stuffing, exact length.
//!
//! From start of frame to the end of the CRC sequence, five equal bits in a row are followed by one of the
//! other level, the stuff bit, which counts in the run that it starts. CRC delimiter, acknowledgement and
//! end of frame follow unstuffed (ISO 11898-1, frame coding).

use crate::frame::WireFrame;
use embedded_can::Frame as _;

/// The level of the bus during a bit. One dominant sender makes the bus dominant.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Level {
    /// Logical 0.
    Dominant,
    /// Logical 1; the idle level.
    Recessive,
}

impl Level {
    /// The other one.
    pub const fn inverted(self) -> Self {
        match self {
            Self::Dominant => Self::Recessive,
            Self::Recessive => Self::Dominant,
        }
    }
}

/// A field of a frame.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Field {
    /// The dominant bit that starts a frame.
    StartOfFrame,
    /// Identifier, RTR, SRR, and IDE as far as it takes part in arbitration.
    Arbitration,
    /// Reserved bits and data length code; in standard frames also IDE.
    Control,
    /// The data.
    Data,
    /// The CRC sequence.
    Crc,
    /// The recessive bit behind the CRC sequence.
    CrcDelimiter,
    /// The bit that receivers make dominant.
    AcknowledgeSlot,
    /// The recessive bit behind it.
    AcknowledgeDelimiter,
    /// Seven recessive bits.
    EndOfFrame,
}

/// The frame without stuff bits, up to and including the CRC sequence, left-aligned.
struct Unstuffed {
    bits: u128,
    len: u32,
}

impl Unstuffed {
    fn of(frame: &WireFrame) -> Self {
        let (head, head_len) = head(frame);
        let data_len = 8 * frame.data_len() as u32;
        let data = u128::from(u64::from_be_bytes(frame.padded_data()));
        let bits = u128::from(head) << data_len | data >> (64 - data_len);
        let len = head_len + data_len;
        let bits = bits << CRC_BITS | u128::from(crc(bits, len));
        let len = len + CRC_BITS;
        Self { bits: bits << (u128::BITS - len), len }
    }

    /// Counts the stuff bits without visiting every bit: between stuff bits it leaps from one run of five
    /// equal bits to the next.
    fn stuff_bits(&self) -> u32 {
        let same_as_next = !(self.bits ^ self.bits << 1);
        let two = same_as_next & same_as_next << 1;
        // Bit i: the five bits from i on are equal, and all of them are in the frame.
        let runs = two & two << 2 & u128::MAX << (u128::BITS - (self.len - RUN + 1));
        let (mut count, mut from) = (0, 0);
        while from < self.len && runs << from != 0 {
            let start = from + (runs << from).leading_zeros();
            let mut stuff = !self.bit(start);
            from = start + RUN;
            count += 1;
            // The stuff bit starts a run itself, which four more bits complete.
            while from + RUN - 1 <= self.len && self.four_equal(from, stuff) {
                stuff = !stuff;
                from += RUN - 1;
                count += 1;
            }
        }
        count
    }

    fn bit(&self, at: u32) -> bool {
        self.bits << at >> (u128::BITS - 1) == 1
    }

    fn four_equal(&self, from: u32, level: bool) -> bool {
        (self.bits << from >> (u128::BITS - 4)) == if level { 0b1111 } else { 0 }
    }
}

/// The bits from start of frame to data length code, right-aligned, and their number.
fn head(frame: &WireFrame) -> (u64, u32) {
    let arbitration = u64::from(frame.arbitration().raw());
    let length_code = u64::from(frame.length_code());
    if frame.is_extended() {
        // SOF, 32 bits of arbitration, r1, r0, data length code.
        (arbitration << 6 | length_code, 39)
    } else {
        // SOF, identifier and RTR and IDE, r0, data length code.
        (arbitration >> 19 << 5 | length_code, 19)
    }
}

/// CRC-15 over the right-aligned bits. Zeros in front do not change it, for it starts from zero: so whole
/// bytes will do.
fn crc(bits: u128, len: u32) -> u16 {
    let bytes = bits.to_be_bytes();
    CRC.checksum(&bytes[bytes.len() - len.div_ceil(8) as usize..])
}

impl WireFrame {
    /// The number of bits from start of frame to end of frame, stuff bits included; the three bits of
    /// intermission are not. 44..=157.
    pub fn bit_count(&self) -> u32 {
        let unstuffed = Unstuffed::of(self);
        unstuffed.len + unstuffed.stuff_bits() + TAIL_BITS
    }

    /// The bits as the transmitter sends them.
    pub fn wire_bits(&self) -> WireBits {
        WireBits::of(self)
    }
}

/// The bits of a frame as the transmitter sends them, from start of frame to end of frame.
///
/// The acknowledge slot is recessive here: the receivers make it dominant.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct WireBits {
    bits: Vec<WireBit>,
}

/// One bit on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct WireBit {
    pub(crate) level: Level,
    pub(crate) field: Field,
    pub(crate) is_stuff_bit: bool,
}

impl WireBits {
    fn of(frame: &WireFrame) -> Self {
        let unstuffed = Unstuffed::of(frame);
        let mut bits = Vec::with_capacity(160);
        let (mut run, mut last) = (0, Level::Recessive);
        for at in 0..unstuffed.len {
            let field = stuffed_field(frame, at, unstuffed.len);
            let level = if unstuffed.bit(at) { Level::Recessive } else { Level::Dominant };
            run = if level == last { run + 1 } else { 1 };
            last = level;
            bits.push(WireBit { level, field, is_stuff_bit: false });
            if run == RUN {
                last = level.inverted();
                run = 1;
                bits.push(WireBit { level: last, field, is_stuff_bit: true });
            }
        }
        let tail = [Field::CrcDelimiter, Field::AcknowledgeSlot, Field::AcknowledgeDelimiter];
        bits.extend(tail.into_iter().chain([Field::EndOfFrame; 7]).map(|field| WireBit {
            level: Level::Recessive,
            field,
            is_stuff_bit: false,
        }));
        Self { bits }
    }

    /// How many there are.
    #[expect(clippy::len_without_is_empty, reason = "a frame is never empty")]
    pub fn len(&self) -> u32 {
        self.bits.len() as u32
    }

    /// The levels in the order of transmission.
    pub fn levels(&self) -> impl Iterator<Item = Level> + '_ {
        self.bits.iter().map(|bit| bit.level)
    }

    /// The field that a bit belongs to; a stuff bit belongs to that of the bit before it. `None` behind the
    /// end of frame.
    pub fn field(&self, bit: u32) -> Option<Field> {
        self.bits.get(bit as usize).map(|bit| bit.field)
    }

    pub(crate) fn as_slice(&self) -> &[WireBit] {
        &self.bits
    }
}

impl core::fmt::Display for WireBits {
    /// Zeros (dominant) and ones (recessive).
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        use core::fmt::Write as _;
        self.levels().try_for_each(|level| f.write_char(if level == Level::Dominant { '0' } else { '1' }))
    }
}

/// The field of a bit before stuffing; `len` counts them up to the end of the CRC sequence.
fn stuffed_field(frame: &WireFrame, at: u32, len: u32) -> Field {
    let arbitration_len = if frame.is_extended() { 32 } else { 12 };
    let data_len = 8 * frame.data_len() as u32;
    if at == 0 {
        Field::StartOfFrame
    } else if at <= arbitration_len {
        Field::Arbitration
    } else if at < len - CRC_BITS - data_len {
        Field::Control
    } else if at < len - CRC_BITS {
        Field::Data
    } else {
        Field::Crc
    }
}

/// Bits of the error delimiter, recessive.
pub(crate) const ERROR_DELIMITER_BITS: u32 = 8;
/// Bits of one error or overload flag.
pub(crate) const FLAG_BITS: u32 = 6;
/// Bits between frames.
pub(crate) const INTERMISSION_BITS: u32 = 3;
/// Bits that an error passive transmitter waits in addition.
pub(crate) const SUSPEND_BITS: u32 = 8;
/// The shortest frame: a standard remote frame without stuff bits.
pub(crate) const SHORTEST_FRAME_BITS: u32 = 44;
/// CRC delimiter, acknowledge slot, acknowledge delimiter, end of frame.
pub(crate) const TAIL_BITS: u32 = 10;
/// Equal bits that call for a stuff bit.
pub(crate) const RUN: u32 = 5;

const CRC_BITS: u32 = 15;
const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_15_CAN);
