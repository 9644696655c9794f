//! What a publisher promises of a channel, and a subscriber may expect.

use crate::can::Priority;
use crate::protocol::Class;
use crate::time::Duration;

/// The quality of a hard real-time channel. It must match the calendar.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HardAttributes {
    /// The span between two slots.
    pub period: Duration,
    /// Whether every slot carries an event. If not, the channel is sporadic, and an empty slot is no error.
    pub periodic: bool,
    /// How many omission faults a slot tolerates (k).
    pub omission_degree: u8,
}

/// The quality of a soft real-time channel; each event may state its own instead.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SoftAttributes {
    /// From publication until an event should have been sent.
    pub deadline: Duration,
    /// From publication until an event is of no use any more; not shorter than the deadline.
    pub validity: Duration,
}

/// How important a non real-time channel is: 0 the most, 4 the least.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Importance(u8);

impl Importance {
    /// The most important. Configuration and binding still go before it.
    pub const MOST: Self = Self(0);
    /// The least important.
    pub const LEAST: Self = Self(Priority::LEAST.get() - Self::FIRST);

    const FIRST: u8 = Priority::CONFIGURATION.get() + 1;

    /// `None` above 4.
    pub const fn new(rank: u8) -> Option<Self> {
        if rank <= Self::LEAST.0 { Some(Self(rank)) } else { None }
    }

    /// The priority of its frames, 251..=255.
    #[expect(clippy::arithmetic_side_effects, reason = "a rank is at most four")]
    pub const fn priority(self) -> Priority {
        Priority::new(Self::FIRST + self.0)
    }
}

/// The quality of a non real-time channel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NonRealTimeAttributes {
    /// Its place among the non real-time channels.
    pub importance: Importance,
    /// From publication until an event is of no use any more; `None` if it keeps for ever.
    pub validity: Option<Duration>,
}

/// The quality of a channel, by class.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
// Left to itself, the compiler tells the classes apart by values of 64 bits.
#[repr(u8)]
pub enum Attributes {
    /// HRTEC.
    Hard(HardAttributes),
    /// SRTEC.
    Soft(SoftAttributes),
    /// NRTEC.
    NonRealTime(NonRealTimeAttributes),
}

impl Attributes {
    /// The class.
    pub const fn class(&self) -> Class {
        match self {
            Self::Hard(_) => Class::Hard,
            Self::Soft(_) => Class::Soft,
            Self::NonRealTime(_) => Class::NonRealTime,
        }
    }
}
