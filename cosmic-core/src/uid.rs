//! The two 64-bit names of COSMIC: of a node and of a subject.
//!
//! Both are unique in the world, not on a segment; the broker maps them on the short [`TxNode`] and
//! [`Etag`] of the identifier. Zero is neither a node nor a subject, so `Option` of them costs nothing.
//!
//! [`TxNode`]: crate::can::TxNode
//! [`Etag`]: crate::can::Etag

use core::num::NonZeroU64;

macro_rules! uid {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(NonZeroU64);

        impl $name {
            /// The smallest.
            pub const MIN: Self = Self(NonZeroU64::MIN);
            /// The largest.
            pub const MAX: Self = Self(NonZeroU64::MAX);

            /// `None` for zero, which names nothing.
            #[inline]
            pub const fn new(uid: u64) -> Option<Self> {
                match NonZeroU64::new(uid) {
                    Some(uid) => Some(Self(uid)),
                    None => None,
                }
            }

            /// The 64 bits.
            #[inline]
            pub const fn get(self) -> u64 {
                self.0.get()
            }

            /// The eight bytes in the order of the wire: most significant first.
            #[inline]
            pub const fn to_bytes(self) -> [u8; 8] {
                self.0.get().to_be_bytes()
            }

            /// From eight bytes in the order of the wire; `None` if all are zero.
            #[inline]
            pub const fn from_bytes(bytes: [u8; 8]) -> Option<Self> {
                Self::new(u64::from_be_bytes(bytes))
            }
        }

        #[cfg(feature = "defmt")]
        impl defmt::Format for $name {
            fn format(&self, f: defmt::Formatter<'_>) {
                defmt::write!(f, "{=u64:016X}", self.get());
            }
        }

        impl core::fmt::Debug for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                write!(f, concat!(stringify!($name), "({:016X})"), self.get())
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                write!(f, "{:016X}", self.get())
            }
        }
    };
}

uid! {
    /// The long name of a node, given at manufacture: 64 bits, not zero.
    NodeUid
}

uid! {
    /// The subject of an event channel: 64 bits, not zero.
    Subject
}

impl Subject {
    /// Reserved: no channel has this subject. A broker asks for its etag when it starts; a broker that sends
    /// nothing unasked shows by its answer that it is there, and how many etags it has handed out.
    pub const RESERVED: Self = Self::MAX;
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;

    #[test]
    fn zero_names_nothing() {
        assert_eq!(Subject::new(0), None);
        assert_eq!(NodeUid::from_bytes([0; 8]), None);
        assert_eq!(size_of::<Option<Subject>>(), 8);
    }

    #[test]
    fn names_are_shown_in_hexadecimal_digits() {
        let (uid, subject) = (NodeUid::new(0xC05A_0001).unwrap(), Subject::new(0xAB).unwrap());
        assert_eq!(format!("{uid:?} {uid}"), "NodeUid(00000000C05A0001) 00000000C05A0001");
        assert_eq!(format!("{subject:?} {subject}"), "Subject(00000000000000AB) 00000000000000AB");
    }

    #[test]
    fn bytes_are_big_endian() {
        let uid = NodeUid::new(0x0102_0304_0506_0708).unwrap();
        assert_eq!(uid.to_bytes(), [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(NodeUid::from_bytes(uid.to_bytes()), Some(uid));
        assert_eq!(std::format!("{uid}"), "0102030405060708");
    }
}
