//! The spans of admission, and why they are safe.

use crate::protocol::Lease;
use crate::time::Duration;

/// The spans of admission, for the node that asks and for the one that answers.
///
/// Nothing is admitted twice, because the one that publishes gives up before the one that admitted it does:
///
/// * A lease counts from the question at the node that asks, and [`grace`](Self::grace) longer at the one that answers.
/// * A broker that has just become active holds an empty table. It answers no new question for
///   [`settle`](Self::settle). In that time each node tells what it holds, as soon as it hears of the broker, and again
///   until that confirms it. If it is not confirmed within [`claim`](Self::claim), which is shorter, it gives up.
/// * While no broker is heard, nobody admits anything, and what was admitted goes on; unless its events are late, which
///   says that parts of a bus have come together that were apart, and have admitted more than it takes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AdmissionTiming {
    /// How long an admitted channel may be published without being asked for again. It is asked for at a third of it.
    pub lease: Lease,
    /// By how much longer its place is kept.
    pub grace: Duration,
    /// How long a broker that has become active only hears what is held.
    pub settle: Duration,
    /// How long a node goes on, without being confirmed, when it hears a new broker.
    pub claim: Duration,
    /// After how long a silent broker is taken for dead.
    pub silence: Duration,
    /// How long an answer may take; longer after each failure, up to 32 times.
    pub reply: Duration,
    /// After how long a channel is asked for again that was refused, on average.
    pub refused: Duration,
    /// Between two answers, at least.
    pub between_replies: Duration,
    /// Between two steps of an answer, at least; see [`AdmissionControl`](super::AdmissionControl).
    pub between_steps: Duration,
}

impl AdmissionTiming {
    /// For a segment of 125 kbit/s and faster, with [`BrokerTiming::DEFAULT`](crate::broker::BrokerTiming::DEFAULT).
    pub const DEFAULT: Self = Self {
        lease: Lease::new(Duration::from_secs(10)).expect("ten seconds are a lease"),
        grace: Duration::from_millis(100),
        settle: Duration::from_millis(1_500),
        claim: Duration::from_millis(1_200),
        silence: Duration::from_millis(900),
        reply: Duration::from_millis(100),
        refused: Duration::from_secs(10),
        between_replies: Duration::from_millis(5),
        between_steps: Duration::from_millis(1),
    };
}
