//! Attributes of context and filters over them.
//!
//! An event of a channel [with context](super::Channel::with_context) carries, before its content, one
//! byte whose bits say which attributes of context follow, and then their values in the order of the
//! bits, big-endian:
//!
//! | bit | attribute | bytes |
//! |---|---|---|
//! | 0 | time of occurrence | 4 |
//! | 1 | location | 2 |
//! | 2 | sensor | 1 |
//! | 3 | confidence | 1 |
//! | 4..=7 | the application's own | 1 each |
//!
//! A subscription's filter is a mask over these bits, so a match is one AND and one compare. COSMIC
//! section III-A.1 contradicts itself: its text says that an event with *more* than the required
//! attributes matches; its example says that `{A, B}` matches `<A>`, `<B>`, `<>` but not `<A, B, C>`. Both exist
//! here: [`Filter::at_least`] is the text, [`Filter::at_most`] the example. A filter may also ask for a
//! range of the value of an attribute.

use crate::can::Payload;

/// An attribute of context.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Attribute {
    /// When the event occurred: global time in units of 10 µs, modulo 2^32 (almost twelve hours).
    TimeOfOccurrence = 0,
    /// Where it occurred, in a coding of the application.
    Location = 1,
    /// Which sensor of the node observed it.
    Sensor = 2,
    /// How sure the observer is, 0..=255.
    Confidence = 3,
    /// The application's own.
    User0 = 4,
    /// The application's own.
    User1 = 5,
    /// The application's own.
    User2 = 6,
    /// The application's own.
    User3 = 7,
}

impl Attribute {
    /// All, in the order of their bits.
    pub const ALL: [Self; 8] = [
        Self::TimeOfOccurrence,
        Self::Location,
        Self::Sensor,
        Self::Confidence,
        Self::User0,
        Self::User1,
        Self::User2,
        Self::User3,
    ];

    /// Its bit in the byte of presence.
    #[inline]
    pub const fn bit(self) -> u8 {
        1 << self as u8
    }

    /// The bytes of its value.
    pub const fn width(self) -> usize {
        match self {
            Self::TimeOfOccurrence => 4,
            Self::Location => 2,
            _ => 1,
        }
    }

    /// The largest value.
    pub const fn max(self) -> u32 {
        match self {
            Self::TimeOfOccurrence => u32::MAX,
            Self::Location => u16::MAX as u32,
            _ => u8::MAX as u32,
        }
    }
}

/// The attributes of context that an event carries, with their values: at most seven bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Context {
    presence: u8,
    /// The values, in the order of the bits.
    values: [u8; Self::MAX_LEN],
}

/// The value is too large for the attribute, or the attributes do not fit in a frame together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoRoom;

impl Context {
    const MAX_LEN: usize = Payload::MAX_LEN - 1;

    /// No attributes.
    pub const EMPTY: Self = Self { presence: 0, values: [0; Self::MAX_LEN] };

    /// This context with one more attribute, or another value of it.
    ///
    /// # Errors
    /// [`NoRoom`]
    #[allow(clippy::indexing_slicing, reason = "a width is at most four")]
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "a width is at most four, and the widths of all are a few bytes"
    )]
    pub fn with(self, attribute: Attribute, value: u32) -> Result<Self, NoRoom> {
        if value > attribute.max() {
            return Err(NoRoom);
        }
        let mut all = Self { presence: self.presence | attribute.bit(), values: [0; Self::MAX_LEN] };
        let mut at = 0;
        for present in Attribute::ALL {
            let value = if present == attribute { Some(value) } else { self.get(present) };
            let Some(value) = value else { continue };
            let place = all.values.get_mut(at..at + present.width()).ok_or(NoRoom)?;
            place.copy_from_slice(&value.to_be_bytes()[4 - present.width()..]);
            at += present.width();
        }
        Ok(all)
    }

    /// The value of an attribute, if the event carries it.
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "a bit is not zero, and the widths of all are a few bytes"
    )]
    pub fn get(&self, attribute: Attribute) -> Option<u32> {
        if self.presence & attribute.bit() == 0 {
            return None;
        }
        let start = len_of(self.presence & (attribute.bit() - 1));
        let bytes = self.values.get(start..start + attribute.width())?;
        Some(bytes.iter().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    /// Which attributes there are, by their bits.
    #[inline]
    pub const fn presence(&self) -> u8 {
        self.presence
    }

    /// The bytes that it takes in a frame, with the byte of presence.
    #[expect(clippy::arithmetic_side_effects, reason = "the widths of all are a few bytes")]
    pub fn encoded_len(&self) -> usize {
        1 + len_of(self.presence)
    }

    /// Puts the context before the content.
    ///
    /// # Errors
    /// [`NoRoom`] if both together are over eight bytes.
    #[allow(clippy::indexing_slicing, reason = "what does not fit has been refused before")]
    #[expect(clippy::arithmetic_side_effects, reason = "the widths of all are a few bytes")]
    pub fn prepend(&self, content: &Payload) -> Result<Payload, NoRoom> {
        let mut bytes = [0; Payload::MAX_LEN];
        let len = len_of(self.presence);
        bytes[0] = self.presence;
        copy(bytes.get_mut(1..1 + len).ok_or(NoRoom)?, &self.values);
        let end = 1 + len + content.len();
        copy(bytes.get_mut(1 + len..end).ok_or(NoRoom)?, content.as_slice());
        Ok(Payload::truncated(bytes, end))
    }

    /// Takes context and content apart; `None` if the frame is shorter than its context says.
    pub fn split(payload: &Payload) -> Option<(Self, Payload)> {
        let (&presence, rest) = payload.as_slice().split_first()?;
        let (values, content) = rest.split_at_checked(len_of(presence))?;
        let mut context = Self { presence, ..Self::EMPTY };
        copy(&mut context.values, values);
        Some((context, Payload::new(content)?))
    }
}

/// As many bytes as both have.
fn copy(to: &mut [u8], from: &[u8]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}

fn len_of(presence: u8) -> usize {
    Attribute::ALL
        .iter()
        .filter(|attribute| presence & attribute.bit() != 0)
        .map(|attribute| attribute.width())
        .sum()
}

/// Which events of a channel a subscriber wants.
///
/// ```
/// use cosmic_core::event_layer::{Attribute, Context, Filter};
///
/// let near = Filter::at_least(&[Attribute::Location]).with_range(Attribute::Location, 100, 199);
/// let event = Context::EMPTY.with(Attribute::Location, 150).unwrap();
/// assert!(near.matches(&event));
/// assert!(!near.matches(&Context::EMPTY));
/// assert!(!near.matches(&event.with(Attribute::Location, 200).unwrap()));
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Filter {
    mask: u8,
    expected: u8,
    /// Whose value is in the range, if there is one.
    ranged: Option<Attribute>,
    least: u32,
    most: u32,
}

impl Filter {
    /// All events.
    pub const ALL: Self = Self { mask: 0, expected: 0, ranged: None, least: 0, most: 0 };

    /// Events that carry all of these attributes, and perhaps more.
    pub const fn at_least(attributes: &[Attribute]) -> Self {
        let mask = mask_of(attributes);
        Self { mask, expected: mask, ..Self::ALL }
    }

    /// Events that carry none but these attributes, and perhaps not all of them.
    pub const fn at_most(attributes: &[Attribute]) -> Self {
        Self { mask: !mask_of(attributes), ..Self::ALL }
    }

    /// Of those, the events that carry the attribute with a value from `least` to `most`.
    pub const fn with_range(self, attribute: Attribute, least: u32, most: u32) -> Self {
        Self { ranged: Some(attribute), least, most, ..self }
    }

    /// Of those, the events that carry the attribute with this value.
    pub const fn with_value(self, attribute: Attribute, value: u32) -> Self {
        self.with_range(attribute, value, value)
    }

    /// Returns whether the subscriber wants it. One AND and one compare, and a look at one value if there is a range.
    #[inline]
    pub fn matches(&self, context: &Context) -> bool {
        context.presence & self.mask == self.expected
            && self.ranged.is_none_or(|attribute| {
                context.get(attribute).is_some_and(|value| (self.least..=self.most).contains(&value))
            })
    }
}

#[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
#[expect(clippy::arithmetic_side_effects, reason = "within the length, by the loop")]
const fn mask_of(attributes: &[Attribute]) -> u8 {
    let mut mask = 0;
    let mut at = 0;
    while at < attributes.len() {
        mask |= attributes[at].bit();
        at += 1;
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const A: Attribute = Attribute::Location;
    const B: Attribute = Attribute::Sensor;
    const C: Attribute = Attribute::Confidence;

    fn carrying(attributes: &[Attribute]) -> Context {
        attributes.iter().fold(Context::EMPTY, |context, attribute| context.with(*attribute, 7).unwrap())
    }

    #[test]
    fn both_readings_of_the_paper() {
        let subsets: [&[Attribute]; 4] = [&[], &[A], &[B], &[A, B]];
        for subset in subsets {
            assert!(Filter::at_most(&[A, B]).matches(&carrying(subset)));
            assert_eq!(Filter::at_least(&[A, B]).matches(&carrying(subset)), subset.len() == 2);
        }
        assert!(!Filter::at_most(&[A, B]).matches(&carrying(&[A, B, C])));
        assert!(Filter::at_least(&[A, B]).matches(&carrying(&[A, B, C])));
        assert!(Filter::ALL.matches(&carrying(&[])) && Filter::ALL.matches(&carrying(&[A, B, C])));
    }

    #[test]
    fn literal_bytes() {
        let context = Context::EMPTY.with(C, 0xCC).unwrap().with(A, 0x1234).unwrap().with(B, 0xBB).unwrap();
        let payload = context.prepend(&Payload::new(&[1, 2, 3]).unwrap()).unwrap();
        assert_eq!(payload.as_slice(), [0b1110, 0x12, 0x34, 0xBB, 0xCC, 1, 2, 3]);
        assert_eq!(context.prepend(&Payload::full([0; 8])), Err(NoRoom));
        assert_eq!(Context::split(&Payload::new(&[0b0010, 0x12]).unwrap()), None);
        assert_eq!(Context::split(&Payload::EMPTY), None);
    }

    #[test]
    fn values_and_sizes_are_checked() {
        assert_eq!(Context::EMPTY.with(B, 256), Err(NoRoom));
        let full = Context::EMPTY.with(Attribute::TimeOfOccurrence, u32::MAX).unwrap().with(A, 1).unwrap();
        assert_eq!(full.with(B, 1).unwrap().with(C, 1), Err(NoRoom));
    }

    proptest! {
        #[test]
        fn round_trip(pairs in prop::collection::vec((0_usize..8, any::<u8>()), 0..5),
                      content in prop::collection::vec(any::<u8>(), 0..4)) {
            let mut context = Context::EMPTY;
            let mut oracle: Vec<(Attribute, u32)> = Vec::new();
            for (at, value) in pairs {
                let attribute = Attribute::ALL[at];
                if let Ok(more) = context.with(attribute, value.into()) {
                    context = more;
                    oracle.retain(|(known, _)| *known != attribute);
                    oracle.push((attribute, value.into()));
                }
            }
            for attribute in Attribute::ALL {
                let expected = oracle.iter().find(|(known, _)| *known == attribute).map(|(_, value)| *value);
                prop_assert_eq!(context.get(attribute), expected);
            }
            let content = Payload::new(&content).unwrap();
            match context.prepend(&content) {
                Ok(payload) => prop_assert_eq!(Context::split(&payload), Some((context, content))),
                Err(NoRoom) => prop_assert!(context.encoded_len() + content.len() > 8),
            }
        }

        #[test]
        fn any_payload_can_be_split_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..=8)) {
            let payload = Payload::new(&bytes).unwrap();
            if let Some((context, content)) = Context::split(&payload) {
                prop_assert_eq!(context.prepend(&content), Ok(payload));
            }
        }
    }
}
