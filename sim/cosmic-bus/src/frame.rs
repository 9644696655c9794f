//! Frames as they go over the wire: standard or extended identifier, data or remote.
//!
//! COSMIC itself sends extended data frames only ([`cosmic_core::can::Frame`]), but it shares the bus
//! with other users, so the bus carries every kind of classical CAN frame.

use core::fmt;
use cosmic_core::can::embedded::ForeignFrame;
use cosmic_core::can::{Frame, Payload};
use embedded_can::{ExtendedId, Id, StandardId};

/// The arbitration field as one number: the smaller one wins the bus.
///
/// The bits stand in the order of transmission, most significant first. A standard frame has identifier
/// (11), RTR, IDE; an extended one has base identifier (11), SRR, IDE, identifier extension (18), RTR.
/// SRR and IDE of an extended frame are recessive, so a standard frame wins against an extended one
/// with the same base identifier, by RTR if it is a data frame, else by IDE.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Arbitration(u32);

impl Arbitration {
    const RTR_STANDARD: u32 = 1 << 20;
    const SRR: u32 = 1 << 20;
    const IDE: u32 = 1 << 19;
    const RTR_EXTENDED: u32 = 1;
    const EXTENSION_BITS: u32 = 18;

    /// The arbitration field of a frame with this identifier.
    pub fn new(id: Id, remote: bool) -> Self {
        match id {
            Id::Standard(id) => {
                let rtr = if remote { Self::RTR_STANDARD } else { 0 };
                Self((id.as_raw() as u32) << 21 | rtr)
            }
            Id::Extended(id) => {
                let (base, extension) =
                    (id.as_raw() >> Self::EXTENSION_BITS, id.as_raw() & ((1 << Self::EXTENSION_BITS) - 1));
                let rtr = if remote { Self::RTR_EXTENDED } else { 0 };
                Self(base << 21 | Self::SRR | Self::IDE | extension << 1 | rtr)
            }
        }
    }

    /// The field as a number.
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// Returns whether the frame has an extended (29-bit) identifier.
    pub const fn is_extended(self) -> bool {
        self.0 & Self::IDE != 0
    }

    /// Returns whether it is a remote frame.
    pub const fn is_remote(self) -> bool {
        let rtr = if self.is_extended() { Self::RTR_EXTENDED } else { Self::RTR_STANDARD };
        self.0 & rtr != 0
    }

    /// The identifier, right-aligned: 11 or 29 bits.
    pub const fn raw_id(self) -> u32 {
        let base = self.0 >> 21;
        if self.is_extended() {
            base << Self::EXTENSION_BITS | self.0 >> 1 & ((1 << Self::EXTENSION_BITS) - 1)
        } else {
            base
        }
    }

    /// The identifier.
    pub fn id(self) -> Id {
        let raw = self.raw_id();
        // Neither `unwrap_or` is taken: the value has 11 or 29 bits by construction.
        if self.is_extended() {
            Id::Extended(ExtendedId::new(raw).unwrap_or(ExtendedId::MAX))
        } else {
            Id::Standard(StandardId::new(raw as u16).unwrap_or(StandardId::MAX))
        }
    }
}

impl fmt::Debug for Arbitration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = if self.is_extended() { 8 } else { 3 };
        let kind = if self.is_remote() { " remote" } else { "" };
        write!(f, "{:0width$X}{kind}", self.raw_id())
    }
}

/// A classical CAN frame of any kind.
///
/// Construct one with [`embedded_can::Frame`], or from a COSMIC [`Frame`].
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct WireFrame {
    arbitration: Arbitration,
    /// 0..=15, and above 8 the data are eight bytes. Of a remote frame: the length asked for.
    length_code: u8,
    /// Zero behind the data, and in remote frames.
    data: [u8; Payload::MAX_LEN],
}

impl WireFrame {
    /// The arbitration field.
    #[inline]
    pub const fn arbitration(&self) -> Arbitration {
        self.arbitration
    }

    /// All eight bytes, zero behind the data, as a controller's data registers want them.
    #[inline]
    pub const fn padded_data(&self) -> [u8; Payload::MAX_LEN] {
        self.data
    }

    /// How many bytes of data are on the wire: 0..=8, none in a remote frame.
    #[inline]
    pub const fn data_len(&self) -> usize {
        if self.arbitration.is_remote() { 0 } else { bytes(self.length_code) }
    }

    /// The data length code as it is on the wire, 0..=15: [`dlc`](embedded_can::Frame::dlc) takes 9 to 15
    /// as 8.
    #[inline]
    pub const fn length_code(&self) -> u8 {
        self.length_code
    }

    /// The same frame with another data length code on the wire. Codes of 9 to 15 are legal and stand for
    /// eight bytes (ISO 11898-1, data length code). `None` if the code is above 15, or means another length
    /// than that of the data; a remote frame has no data, so it may have any.
    pub const fn with_length_code(self, code: u8) -> Option<Self> {
        let fits = code <= LARGEST_CODE && (self.arbitration.is_remote() || bytes(code) == self.data_len());
        if fits { Some(Self { length_code: code, ..self }) } else { None }
    }
}

impl embedded_can::Frame for WireFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let payload = Payload::new(data)?;
        Some(Self {
            arbitration: Arbitration::new(id.into(), false),
            length_code: payload.len() as u8,
            data: payload.padded(),
        })
    }

    fn new_remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        if dlc > Payload::MAX_LEN {
            return None;
        }
        Some(Self {
            arbitration: Arbitration::new(id.into(), true),
            length_code: dlc as u8,
            data: [0; Payload::MAX_LEN],
        })
    }

    fn is_extended(&self) -> bool {
        self.arbitration.is_extended()
    }

    fn is_remote_frame(&self) -> bool {
        self.arbitration.is_remote()
    }

    fn id(&self) -> Id {
        self.arbitration.id()
    }

    fn dlc(&self) -> usize {
        bytes(self.length_code)
    }

    fn data(&self) -> &[u8] {
        &self.data[..self.data_len()]
    }
}

impl fmt::Debug for WireFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use embedded_can::Frame as _;
        if self.is_remote_frame() {
            return write!(f, "{:?} [{}]", self.arbitration, self.length_code);
        }
        write!(f, "{:?} {:02X?}", self.arbitration, self.data())?;
        if usize::from(self.length_code) > Payload::MAX_LEN {
            write!(f, " [{}]", self.length_code)?;
        }
        Ok(())
    }
}

impl From<Frame> for WireFrame {
    fn from(frame: Frame) -> Self {
        // `unwrap_or` is not taken: a COSMIC identifier has 29 bits by construction.
        let id = ExtendedId::new(frame.id.raw()).unwrap_or(ExtendedId::MAX);
        Self {
            arbitration: Arbitration::new(Id::Extended(id), false),
            length_code: frame.payload.len() as u8,
            data: frame.payload.padded(),
        }
    }
}

impl TryFrom<WireFrame> for Frame {
    type Error = ForeignFrame;

    fn try_from(frame: WireFrame) -> Result<Self, ForeignFrame> {
        let arbitration = frame.arbitration;
        if !arbitration.is_extended() || arbitration.is_remote() {
            return Err(ForeignFrame);
        }
        let id = cosmic_core::can::Id::from_raw(arbitration.raw_id()).ok_or(ForeignFrame)?;
        Ok(Self::new(id, Payload::truncated(frame.data, frame.data_len())))
    }
}

/// The bytes that a data length code stands for.
const fn bytes(code: u8) -> usize {
    if code as usize > Payload::MAX_LEN { Payload::MAX_LEN } else { code as usize }
}

/// The code has four bits.
const LARGEST_CODE: u8 = 15;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::{Etag, Priority, TxNode};
    use embedded_can::Frame as _;

    #[test]
    fn identifiers_keep_their_value_and_kind() {
        for remote in [false, true] {
            for id in [
                Id::Standard(StandardId::ZERO),
                Id::Standard(StandardId::MAX),
                Id::Extended(ExtendedId::ZERO),
                Id::Extended(ExtendedId::MAX),
                Id::Extended(ExtendedId::new(0x0AC5_3C96).unwrap()),
            ] {
                let arbitration = Arbitration::new(id, remote);
                assert_eq!(arbitration.id(), id);
                assert_eq!(arbitration.is_remote(), remote);
            }
        }
    }

    #[test]
    fn standard_wins_against_extended_with_the_same_base() {
        let standard = Id::Standard(StandardId::new(0x155).unwrap());
        let extended = Id::Extended(ExtendedId::new(0x155 << 18).unwrap());
        let order = [
            Arbitration::new(standard, false),
            Arbitration::new(standard, true),
            Arbitration::new(extended, false),
            Arbitration::new(extended, true),
        ];
        assert!(order.is_sorted());
    }

    #[test]
    fn cosmic_frames_round_trip_and_others_are_foreign() {
        let id = cosmic_core::can::Id::new(Priority::CONFIGURATION, TxNode::BROKER, Etag::SUPPLY_ETAG);
        let frame = Frame::new(id, Payload::new(&[1, 2, 3]).unwrap());
        assert_eq!(Frame::try_from(WireFrame::from(frame)), Ok(frame));
        let standard = WireFrame::new(StandardId::ZERO, &[]).unwrap();
        assert_eq!(Frame::try_from(standard), Err(ForeignFrame));
        let remote = WireFrame::new_remote(ExtendedId::ZERO, 8).unwrap();
        assert_eq!(Frame::try_from(remote), Err(ForeignFrame));
        assert_eq!(remote.data(), []);
        assert_eq!(WireFrame::new_remote(ExtendedId::ZERO, 9), None);
        assert_eq!(WireFrame::new(ExtendedId::ZERO, &[0; 9]), None);
    }

    #[test]
    fn length_codes_above_eight_are_eight_bytes() {
        let id = cosmic_core::can::Id::new(Priority::CONFIGURATION, TxNode::BROKER, Etag::SUPPLY_ETAG);
        let data = [1, 2, 3, 4, 5, 6, 7, 8];
        let frame = Frame::new(id, Payload::full(data));
        let eight = WireFrame::from(frame);
        for code in 9..=15 {
            let odd = eight.with_length_code(code).unwrap();
            assert_ne!(odd, eight);
            assert_eq!((odd.length_code(), odd.dlc(), odd.data()), (code, 8, &data[..]));
            assert_eq!(Frame::try_from(odd), Ok(frame));
            let remote = WireFrame::new_remote(ExtendedId::ZERO, 0).unwrap().with_length_code(code).unwrap();
            assert_eq!((remote.length_code(), remote.data_len()), (code, 0));
            assert_eq!(Frame::try_from(remote), Err(ForeignFrame));
        }
        assert_eq!(eight.with_length_code(16), None);
        assert_eq!(eight.with_length_code(7), None);
        assert_eq!(WireFrame::new(ExtendedId::ZERO, &[0; 7]).unwrap().with_length_code(8), None);
        assert_eq!(eight.with_length_code(8), Some(eight));
    }
}
