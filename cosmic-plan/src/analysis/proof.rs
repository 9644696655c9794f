//! What an analysis says: a bound, how it comes about, and whether it is within the deadline.

use cosmic_core::time::Duration;

/// Whether a promise holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Verdict {
    /// The bound is within the deadline.
    Meets,
    /// The bound is beyond the deadline.
    Misses,
    /// There is no bound, but a deadline.
    Unbounded,
    /// There is no deadline; the bound is for information.
    NoDeadline,
}

impl Verdict {
    pub(super) fn of(bound: Option<Duration>, deadline: Option<Duration>) -> Self {
        match (bound, deadline) {
            (_, None) => Self::NoDeadline,
            (None, Some(_)) => Self::Unbounded,
            (Some(bound), Some(deadline)) if bound <= deadline => Self::Meets,
            _ => Self::Misses,
        }
    }

    /// Whether the promise is kept.
    pub fn holds(self) -> bool {
        matches!(self, Self::Meets | Self::NoDeadline)
    }

    /// In a word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Meets => "meets",
            Self::Misses => "misses",
            Self::Unbounded => "unbounded",
            Self::NoDeadline => "no deadline",
        }
    }
}

/// From where a bound is counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Origin {
    /// The start of each period of a hard real-time channel.
    Period,
    /// Publication.
    Publication,
    /// The nominal instant of a foreign frame.
    Nominal,
}

impl Origin {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Period => "the start of the period",
            Self::Publication => "publication",
            Self::Nominal => "its nominal instant",
        }
    }
}

/// A part of a bound.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Term {
    /// What takes this time.
    pub name: String,
    /// How much.
    pub span: Duration,
}

/// What is proven of a channel and one of its publishers, or of a foreign frame.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Proof {
    /// The longest latency, from [`Proof::origin`] on.
    pub bound: Option<Duration>,
    /// What it must not exceed, from the same instant on.
    pub deadline: Option<Duration>,
    /// Whether it does.
    pub verdict: Verdict,
    /// From where bound and deadline are counted.
    pub origin: Origin,
    /// Hard real-time: from the slot's ready instant to delivery.
    pub from_ready: Option<Duration>,
    /// How the bound comes about, in one sentence.
    pub how: &'static str,
    /// What the bound consists of.
    pub terms: Vec<Term>,
}

/// A channel, its publisher and what is proven of them.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ChannelProof {
    /// Position in [`Cluster::channels`](crate::cluster::Cluster::channels).
    pub channel: usize,
    /// Position in [`Cluster::nodes`](crate::cluster::Cluster::nodes).
    pub node: usize,
    /// What is proven.
    pub proof: Proof,
}
