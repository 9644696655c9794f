//! Typed content: a payload type is declared once, and nobody can publish or decode the wrong one.

use crate::can::Payload;
use crate::protocol::LayoutHash;

/// What a channel's events carry: at most eight bytes, or 1024 on a [channel of messages](super::MessageChannel).
/// Implemented by [`content!`](crate::content) for a struct, and for unsigned and signed integers, `f32`, `f64`, `bool`,
/// and byte arrays. `cosmic-plan` generates it for contents that the description of the cluster states.
pub trait Content: Sized {
    /// How many bytes it takes, at most.
    const LEN: usize;
    /// A hash of the layout: the types of the fields in their order.
    const LAYOUT: LayoutHash;

    /// Writes the bytes; `bytes` has [`Content::LEN`] of them.
    fn encode(&self, bytes: &mut [u8]);

    /// How many bytes this value takes; [`Content::LEN`], but for [`Payload`] and [`Bytes`](super::Bytes).
    #[inline]
    fn encoded_len(&self) -> usize {
        Self::LEN
    }

    /// Reads them; `None` if they are no value of the type, because there are too few or too many.
    fn decode(bytes: &[u8]) -> Option<Self>;
}

macro_rules! number_content {
    ($($type:ty),*) => {$(
        impl Content for $type {
            const LEN: usize = size_of::<$type>();
            const LAYOUT: LayoutHash = layout_of(&[stringify!($type)]);

            #[inline]
            fn encode(&self, bytes: &mut [u8]) {
                if let Some(bytes) = bytes.first_chunk_mut() {
                    *bytes = self.to_be_bytes();
                }
            }

            #[inline]
            fn decode(bytes: &[u8]) -> Option<Self> {
                Some(Self::from_be_bytes(bytes.try_into().ok()?))
            }
        }
    )*};
}

number_content!(u8, u16, u32, u64, i8, i16, i32, i64, f32, f64);

impl Content for bool {
    const LEN: usize = 1;
    const LAYOUT: LayoutHash = layout_of(&["bool"]);

    #[inline]
    fn encode(&self, bytes: &mut [u8]) {
        u8::from(*self).encode(bytes);
    }

    #[inline]
    fn decode(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [0] => Some(false),
            [1] => Some(true),
            _ => None,
        }
    }
}

impl<const N: usize> Content for [u8; N] {
    const LEN: usize = N;
    /// Plain bytes: any layout of this length fits.
    const LAYOUT: LayoutHash = LayoutHash::UNSTATED;

    #[inline]
    fn encode(&self, bytes: &mut [u8]) {
        if let Some(bytes) = bytes.first_chunk_mut() {
            *bytes = *self;
        }
    }

    #[inline]
    fn decode(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok()
    }
}

/// Any bytes, as many as fit: for channels of messages, and for what is decoded by hand.
impl Content for Payload {
    const LEN: usize = Payload::MAX_LEN;
    const LAYOUT: LayoutHash = LayoutHash::UNSTATED;

    #[inline]
    fn encode(&self, bytes: &mut [u8]) {
        if let Some(bytes) = bytes.first_chunk_mut() {
            *bytes = self.padded();
        }
    }

    #[inline]
    fn encoded_len(&self) -> usize {
        self.len()
    }

    #[inline]
    fn decode(bytes: &[u8]) -> Option<Self> {
        Payload::new(bytes)
    }
}

/// The hash of a layout: CRC-32 over the names of the types in their order. Used by
/// [`content!`](crate::content).
#[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
#[expect(clippy::arithmetic_side_effects, reason = "within the length, by the loop")]
pub const fn layout_of(types: &[&str]) -> LayoutHash {
    const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = CRC.digest();
    let mut at = 0;
    while at < types.len() {
        digest.update(types[at].as_bytes());
        digest.update(b",");
        at += 1;
    }
    LayoutHash::new(digest.finalize())
}

/// Declares the content of a channel: a struct whose fields are content themselves, and stand on the wire
/// one after the other, big-endian. A channel does not compile whose content is longer than it may be.
///
/// ```
/// use cosmic_core::event_layer::Content;
///
/// cosmic_core::content! {
///     /// The speed of one wheel.
///     #[derive(Clone, Copy, PartialEq, Debug)]
///     pub struct WheelSpeed {
///         /// In millimetres per second.
///         pub speed: u32,
///         /// Counts the measurements.
///         pub sequence: u16,
///         /// Has the sensor found itself in order?
///         pub valid: bool,
///     }
/// }
///
/// let event = WheelSpeed { speed: 13_900, sequence: 7, valid: true };
/// let mut bytes = [0; WheelSpeed::LEN];
/// event.encode(&mut bytes);
/// assert_eq!(bytes, [0, 0, 0x36, 0x4C, 0, 7, 1]);
/// assert_eq!(WheelSpeed::decode(&bytes), Some(event));
/// assert_eq!(WheelSpeed::decode(&[0, 0, 0x36, 0x4C, 0, 7, 2]), None);
/// ```
#[macro_export]
macro_rules! content {
    ($(#[$outer:meta])* $visibility:vis struct $name:ident {
        $($(#[$inner:meta])* $field_visibility:vis $field:ident : $type:ty),+ $(,)?
    }) => {
        $(#[$outer])*
        $visibility struct $name {
            $($(#[$inner])* $field_visibility $field: $type),+
        }

        impl $crate::event_layer::Content for $name {
            const LEN: usize = 0 $(+ <$type as $crate::event_layer::Content>::LEN)+;
            const LAYOUT: $crate::protocol::LayoutHash =
                $crate::event_layer::layout_of(&[$(stringify!($type)),+]);

            #[inline]
            fn encode(&self, bytes: &mut [u8]) {
                $(
                    let Some((field, bytes)) =
                        bytes.split_at_mut_checked(<$type as $crate::event_layer::Content>::LEN)
                    else {
                        return;
                    };
                    $crate::event_layer::Content::encode(&self.$field, field);
                )+
                let _ = bytes;
            }

            #[inline]
            fn decode(bytes: &[u8]) -> ::core::option::Option<Self> {
                $(
                    let (field, bytes) =
                        bytes.split_at_checked(<$type as $crate::event_layer::Content>::LEN)?;
                    let $field = <$type as $crate::event_layer::Content>::decode(field)?;
                )+
                bytes.is_empty().then_some(Self { $($field),+ })
            }
        }
    };
}
