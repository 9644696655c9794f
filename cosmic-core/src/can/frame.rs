//! Extended data frames of 0..=8 bytes.

use super::Id;

/// What a frame carries: 0..=8 bytes. Bytes behind the length are zero.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
// Copied in words, as a controller's data registers want them, not in bytes.
#[repr(C, align(4))]
pub struct Payload {
    bytes: [u8; Self::MAX_LEN],
    len: Len,
}

/// As an enum, so that the compiler knows that no length is beyond the bytes, and that an `Option` of a
/// payload is no larger than a payload.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
enum Len {
    L0,
    L1,
    L2,
    L3,
    L4,
    L5,
    L6,
    L7,
    L8,
}

impl Len {
    /// At most eight.
    #[inline]
    const fn clamped(len: usize) -> Self {
        match len {
            0 => Self::L0,
            1 => Self::L1,
            2 => Self::L2,
            3 => Self::L3,
            4 => Self::L4,
            5 => Self::L5,
            6 => Self::L6,
            7 => Self::L7,
            _ => Self::L8,
        }
    }
}

impl Payload {
    /// The most bytes that a frame carries.
    pub const MAX_LEN: usize = 8;
    /// No bytes.
    pub const EMPTY: Self = Self { bytes: [0; Self::MAX_LEN], len: Len::L0 };

    /// A copy of `bytes`; `None` if there are more than eight.
    #[allow(clippy::indexing_slicing, reason = "at most eight, which was asked")]
    #[expect(clippy::arithmetic_side_effects, reason = "at most eight, which was asked")]
    pub const fn new(bytes: &[u8]) -> Option<Self> {
        if bytes.len() > Self::MAX_LEN {
            return None;
        }
        let mut payload = Self::EMPTY;
        let mut at = 0;
        while at < bytes.len() {
            payload.bytes[at] = bytes[at];
            at += 1;
        }
        payload.len = Len::clamped(bytes.len());
        Some(payload)
    }

    /// All eight bytes.
    #[inline]
    pub const fn full(bytes: [u8; Self::MAX_LEN]) -> Self {
        Self { bytes, len: Len::L8 }
    }

    /// The first `len` (at most eight) of the bytes, as a controller's data registers give them.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "below eight bytes, so below 64 bits")]
    pub const fn truncated(bytes: [u8; Self::MAX_LEN], len: usize) -> Self {
        let len = if len > Self::MAX_LEN { Self::MAX_LEN } else { len };
        let kept = u64::from_le_bytes(bytes);
        let kept = if len == Self::MAX_LEN { kept } else { kept & ((1 << (len * 8)) - 1) };
        Self { bytes: kept.to_le_bytes(), len: Len::clamped(len) }
    }

    /// The bytes.
    #[inline]
    #[allow(clippy::indexing_slicing, reason = "`min` keeps it within the bytes")]
    pub fn as_slice(&self) -> &[u8] {
        // The length is at most eight by construction; `min` says so where the compiler is not told.
        &self.bytes[..self.len().min(Self::MAX_LEN)]
    }

    /// All eight bytes, zero behind the length, as a controller's data registers want them.
    #[inline]
    pub const fn padded(&self) -> [u8; Self::MAX_LEN] {
        self.bytes
    }

    /// How many bytes there are.
    #[inline]
    pub const fn len(&self) -> usize {
        self.len as usize
    }

    /// Returns whether there are none.
    #[inline]
    pub const fn is_empty(&self) -> bool {
        matches!(self.len, Len::L0)
    }
}

impl core::fmt::Debug for Payload {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:02X?}", self.as_slice())
    }
}

/// An extended data frame.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame {
    /// The identifier, by which frames win arbitration.
    pub id: Id,
    /// The data.
    pub payload: Payload,
}

impl Frame {
    /// A frame of these two.
    #[inline]
    pub const fn new(id: Id, payload: Payload) -> Self {
        Self { id, payload }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_behind_the_length_are_zero() {
        let payload = Payload::truncated([1, 2, 3, 4, 5, 6, 7, 8], 3);
        assert_eq!(payload.as_slice(), [1, 2, 3]);
        assert_eq!(payload.padded(), [1, 2, 3, 0, 0, 0, 0, 0]);
        assert_eq!(Some(payload), Payload::new(&[1, 2, 3]));
        assert_eq!(Payload::new(&[0; 9]), None);
        assert_eq!(Payload::truncated([7; 8], 12), Payload::full([7; 8]));
        assert!(Payload::truncated([7; 8], 0).is_empty());
    }
}
