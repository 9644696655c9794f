//! Interest: who subscribes to or announces which channel, for how long.
//!
//! Interest is soft state. It holds for its lease and is refreshed before that ends, so that the interest
//! of a node that died ends by itself and nobody has to clean up. A gateway forwards what somebody wants,
//! and nodes learn from it whether the other side of a channel lays out its payload as they do.

use super::{control_data, control_frame, etag_of};
use crate::can::{Etag, Frame, TxNode};
use crate::time::Duration;

/// The class of an event channel.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Class {
    /// HRTEC: in its slot of the calendar.
    Hard = 0,
    /// SRTEC: earliest deadline first.
    Soft = 1,
    /// NRTEC: when the bus is free.
    NonRealTime = 2,
}

/// The side of a channel on which a node stands.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Side {
    /// It subscribes.
    Subscriber = 0,
    /// It announces, and will publish.
    Publisher = 1,
}

/// A hash of how a channel's payload is laid out.
///
/// Two nodes whose hashes differ would misread each other.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LayoutHash(u32);

impl LayoutHash {
    /// The node does not say; it takes the payload as plain bytes, which fits any layout.
    pub const UNSTATED: Self = Self(0);

    /// The hash with this value; 0 is [`LayoutHash::UNSTATED`].
    pub const fn new(hash: u32) -> Self {
        Self(hash)
    }

    /// The value.
    pub const fn get(self) -> u32 {
        self.0
    }

    /// Would two nodes with these layouts misread each other?
    pub const fn conflicts_with(self, other: Self) -> bool {
        self.0 != other.0 && self.0 != 0 && other.0 != 0
    }
}

/// How long an interest holds: up to 1638.3 s in steps of 0.1 s, or nothing, which withdraws it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Lease(u16);

impl Lease {
    /// The interest ends now.
    pub const WITHDRAWN: Self = Self(0);
    /// The shortest lease, 0.1 s.
    pub const MIN: Self = Self(1);
    /// The longest lease, 1638.3 s.
    pub const MAX: Self = Self(0x3FFF);

    /// A lease of at least `span`, rounded up to a step; `None` if `span` is zero or longer than
    /// [`Lease::MAX`].
    pub const fn new(span: Duration) -> Option<Self> {
        let steps = span.as_ticks().div_ceil(LEASE_STEP.as_ticks());
        if steps == 0 || steps > Self::MAX.0 as u64 { None } else { Some(Self(steps as u16)) }
    }

    /// How long it holds; zero if it withdraws.
    #[expect(clippy::arithmetic_side_effects, reason = "14 bits by 27")]
    pub const fn duration(self) -> Duration {
        Duration::from_ticks(LEASE_STEP.as_ticks() * self.0 as u64)
    }

    pub(super) const fn steps(self) -> u16 {
        self.0
    }

    /// The low fourteen bits.
    pub(super) const fn from_steps(steps: u16) -> Self {
        Self(steps & Self::MAX.0)
    }

    /// Returns whether it ends the interest.
    pub const fn is_withdrawn(self) -> bool {
        self.0 == 0
    }
}

/// "I am publisher or subscriber of this channel."
///
/// `[side (1 bit), 0 (1 bit), etag (14 bits), class (2 bits), lease (14 bits), layout hash (32 bits)]`, the
/// sender in the identifier.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Interest {
    /// The node.
    pub tx_node: TxNode,
    /// The channel.
    pub etag: Etag,
    /// Whether it publishes or subscribes.
    pub side: Side,
    /// The class under which it uses the channel.
    pub class: Class,
    /// How it lays out the payload.
    pub layout: LayoutHash,
    /// How long this holds.
    pub lease: Lease,
}

impl Interest {
    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        let channel = (self.side as u16) << 15 | self.etag.get();
        let terms = (self.class as u16) << 14 | self.lease.0;
        let ([a, b], [c, d], [e, f, g, h]) =
            (channel.to_be_bytes(), terms.to_be_bytes(), self.layout.0.to_be_bytes());
        control_frame(self.tx_node, Etag::INTEREST, [a, b, c, d, e, f, g, h])
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let [a, b, c, d, e, f, g, h] = control_data(frame, Etag::INTEREST)?;
        let (channel, terms) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let side = match channel >> 14 {
            0b00 => Side::Subscriber,
            0b10 => Side::Publisher,
            _ => return None,
        };
        let class = match terms >> 14 {
            0 => Class::Hard,
            1 => Class::Soft,
            2 => Class::NonRealTime,
            _ => return None,
        };
        Some(Self {
            tx_node: frame.id.tx_node(),
            etag: etag_of(channel),
            side,
            class,
            layout: LayoutHash(u32::from_be_bytes([e, f, g, h])),
            lease: Lease(terms & Lease::MAX.0),
        })
    }
}

const LEASE_STEP: Duration = Duration::from_millis(100);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leases_are_rounded_up() {
        assert_eq!(Lease::new(Duration::from_millis(1)), Some(Lease::MIN));
        assert_eq!(
            Lease::new(Duration::from_millis(3000)).map(Lease::duration),
            Some(Duration::from_secs(3))
        );
        assert_eq!(Lease::new(Duration::from_ticks(0)), None);
        assert_eq!(Lease::new(Lease::MAX.duration()), Some(Lease::MAX));
        assert_eq!(Lease::new(Lease::MAX.duration() + Duration::from_ticks(1)), None);
    }

    #[test]
    fn plain_bytes_fit_any_layout() {
        assert!(LayoutHash::new(1).conflicts_with(LayoutHash::new(2)));
        assert!(!LayoutHash::new(1).conflicts_with(LayoutHash::new(1)));
        assert!(!LayoutHash::new(1).conflicts_with(LayoutHash::UNSTATED));
    }
}
