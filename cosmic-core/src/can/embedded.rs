//! The types of `embedded-can`, which drivers and tools of other projects speak.
//!
//! Identifiers convert both ways, and [`Frame`] implements [`embedded_can::Frame`]. A COSMIC frame is always an
//! extended data frame, so a standard identifier or a remote frame has no counterpart here: constructors
//! return `None` for it, [`from_frame`] tells it by [`ForeignFrame`].

use super::{Frame, Id, Payload};
use core::fmt;

/// The frame is of a kind that COSMIC does not use: a standard identifier, or a remote frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForeignFrame;

impl fmt::Display for ForeignFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the frame is no extended data frame, so not of COSMIC: filter such frames out")
    }
}

impl core::error::Error for ForeignFrame {}

/// The COSMIC frame in a frame of another type.
///
/// ```
/// use cosmic_core::can::embedded::{ForeignFrame, from_frame};
/// use cosmic_core::can::{Frame, Id, Payload};
///
/// // Any type that implements `embedded_can::Frame`, such as that of a HAL.
/// let received = Frame::new(Id::from_raw(0x1F5F_C004).unwrap(), Payload::EMPTY);
/// let frame: Frame = from_frame(&received)?;
/// assert_eq!(frame, received);
/// # Ok::<(), ForeignFrame>(())
/// ```
///
/// # Errors
/// [`ForeignFrame`]; also if it carries more than eight bytes.
pub fn from_frame(frame: &impl embedded_can::Frame) -> Result<Frame, ForeignFrame> {
    match frame.id() {
        embedded_can::Id::Extended(id) if frame.is_data_frame() => {
            let payload = Payload::new(frame.data()).ok_or(ForeignFrame)?;
            Ok(Frame::new(id.into(), payload))
        }
        _ => Err(ForeignFrame),
    }
}

impl From<Id> for embedded_can::ExtendedId {
    fn from(id: Id) -> Self {
        // Never `MAX` in place of another: an identifier has 29 bits by construction.
        Self::new(id.raw()).unwrap_or(Self::MAX)
    }
}

impl From<Id> for embedded_can::Id {
    fn from(id: Id) -> Self {
        Self::Extended(id.into())
    }
}

impl From<embedded_can::ExtendedId> for Id {
    fn from(id: embedded_can::ExtendedId) -> Self {
        Self::masked(id.as_raw())
    }
}

impl embedded_can::Frame for Frame {
    /// `None` for a standard identifier, and for more than eight bytes.
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
        match id.into() {
            embedded_can::Id::Extended(id) => Some(Self::new(id.into(), Payload::new(data)?)),
            embedded_can::Id::Standard(_) => None,
        }
    }

    /// Always `None`: COSMIC knows no remote frames.
    fn new_remote(_: impl Into<embedded_can::Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        true
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        self.id.into()
    }

    fn dlc(&self) -> usize {
        self.payload.len()
    }

    fn data(&self) -> &[u8] {
        self.payload.as_slice()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, Frame as _, StandardId};

    /// A frame of another project.
    struct Other {
        id: embedded_can::Id,
        remote: bool,
        data: std::vec::Vec<u8>,
    }

    impl embedded_can::Frame for Other {
        fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
            Some(Self { id: id.into(), remote: false, data: data.into() })
        }

        fn new_remote(id: impl Into<embedded_can::Id>, _: usize) -> Option<Self> {
            Some(Self { id: id.into(), remote: true, data: std::vec::Vec::new() })
        }

        fn is_extended(&self) -> bool {
            matches!(self.id, embedded_can::Id::Extended(_))
        }

        fn is_remote_frame(&self) -> bool {
            self.remote
        }

        fn id(&self) -> embedded_can::Id {
            self.id
        }

        fn dlc(&self) -> usize {
            self.data.len()
        }

        fn data(&self) -> &[u8] {
            &self.data
        }
    }

    #[test]
    fn identifiers_round_trip() {
        for raw in [0, 0x1F5F_C004, 0x1FFF_FFFF] {
            let id = Id::from_raw(raw).unwrap();
            assert_eq!(ExtendedId::from(id).as_raw(), raw);
            assert_eq!(Id::from(ExtendedId::from(id)), id);
        }
    }

    #[test]
    fn extended_data_frames_round_trip() {
        let id = ExtendedId::new(0x1F5F_C004).unwrap();
        let other = Other::new(id, &[1, 2, 3]).unwrap();
        let frame = from_frame(&other).unwrap();
        assert_eq!(frame, Frame::new(Id::from(id), Payload::new(&[1, 2, 3]).unwrap()));
        assert_eq!(<Frame as embedded_can::Frame>::new(id, &[1, 2, 3]), Some(frame));
        assert_eq!((frame.id(), frame.dlc(), frame.data()), (id.into(), 3, &[1, 2, 3][..]));
        assert!(frame.is_extended() && frame.is_data_frame());
    }

    #[test]
    fn other_kinds_are_foreign() {
        let standard = StandardId::new(0x123).unwrap();
        assert_eq!(from_frame(&Other::new(standard, &[1]).unwrap()), Err(ForeignFrame));
        assert_eq!(from_frame(&Other::new_remote(ExtendedId::ZERO, 8).unwrap()), Err(ForeignFrame));
        assert_eq!(from_frame(&Other::new(ExtendedId::ZERO, &[0; 9]).unwrap()), Err(ForeignFrame));
        assert_eq!(<Frame as embedded_can::Frame>::new(standard, &[1]), None);
        assert_eq!(Frame::new_remote(ExtendedId::ZERO, 0), None);
        assert_eq!(<Frame as embedded_can::Frame>::new(ExtendedId::ZERO, &[0; 9]), None);
    }
}
