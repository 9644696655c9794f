//! What became of events: one counter for each segment, direction and outcome.

use prometheus_client::encoding::{EncodeLabelSet, EncodeLabelValue};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::registry::Registry;

use crate::keys::Name;

macro_rules! outcomes {
    ($($(#[$doc:meta])+ $outcome:ident,)+) => {
        /// What became of an event.
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, EncodeLabelValue)]
        #[non_exhaustive]
        pub enum Outcome {
            $($(#[$doc])+ $outcome,)+
        }

        impl Outcome {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$outcome),+];
        }
    };
}

outcomes! {
    /// It was forwarded.
    Forwarded,
    /// It was forwarded, with its deadline past already.
    ForwardedLate,
    /// Discarded: it may have expired.
    Expired,
    /// Discarded: events of the channel come more often than its rate says.
    RateExceeded,
    /// Discarded: what enters takes more of the bus than the segment's ceiling says.
    CeilingExceeded,
    /// Discarded: the queue is full: towards the bus, or of what waits to leave it.
    QueueFull,
    /// Discarded: the channel has no etag yet, or the node no TxNode.
    NotBound,
    /// Discarded: the content does not fit into a frame, or a message is longer than the channel says.
    TooLong,
    /// Discarded: the content is laid out otherwise than the channel's here.
    LayoutMismatch,
    /// Discarded: it has come already.
    Duplicate,
    /// Discarded: it is so far behind others that nobody knows whether it has come.
    OutOfWindow,
    /// It did not come: the numbers of the others say so.
    Missing,
    /// Discarded: the sender's clock is not known yet.
    AgeUnknown,
    /// Discarded: its stamp is in the future of its sender.
    FromTheFuture,
    /// Discarded: bytes that are no event of this version.
    Malformed,
    /// Discarded: a message of which a frame is missing.
    Incomplete,
    /// A frame of a message that had been given up, or of which the begin was missed.
    StrayFrame,
    /// Not forwarded: a gateway has published it.
    OfGateway,
    /// Not forwarded: it has come back to where it was published.
    ComeBack,
    /// Not forwarded: this gateway does not lead its segment.
    StandingBy,
    /// At a take-over: it was on the bus after the last sign of the gateway that led before, or before any led, and was
    /// perhaps not forwarded.
    PerhapsLost,
    /// Not forwarded: nobody on the other side wants it, or does so any longer.
    Unwanted,
    /// Discarded: zenoh did not take it.
    NotSent,
    /// Discarded: too many senders at once.
    TooManySenders,
}

/// A way of an event.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, EncodeLabelValue)]
pub enum Direction {
    /// From IP, or another segment, into the segment.
    In,
    /// Out of the segment.
    Out,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct Labels {
    segment: String,
    direction: Direction,
    outcome: Outcome,
}

/// The counters of a segment in one direction.
#[derive(Clone, Debug)]
pub struct Counters {
    of: Vec<Counter>,
}

impl Counters {
    /// How often that happened.
    pub fn get(&self, outcome: Outcome) -> u64 {
        self.of[outcome as usize].get()
    }

    pub(crate) fn count(&self, outcome: Outcome) {
        self.count_many(outcome, 1);
    }

    pub(crate) fn count_many(&self, outcome: Outcome, times: u64) {
        self.of[outcome as usize].inc_by(times);
    }
}

/// All counters of a program.
#[derive(Debug, Default)]
pub struct Metrics {
    registry: Registry,
    events: Family<Labels, Counter>,
}

impl Metrics {
    pub(crate) fn new() -> Self {
        let mut metrics = Self::default();
        let help = "Events by what became of them";
        metrics.registry.register("cosmic_gateway_events", help, metrics.events.clone());
        metrics
    }

    /// The counters of a segment in one direction, made if there are none.
    pub fn of(&self, segment: &Name, direction: Direction) -> Counters {
        self.counters(segment.as_str(), direction)
    }

    /// Those of what came from IP and entered no segment.
    pub(crate) fn of_no_segment(&self) -> Counters {
        self.counters("", Direction::In)
    }

    fn counters(&self, segment: &str, direction: Direction) -> Counters {
        let counter = |outcome: &Outcome| {
            let labels = Labels { segment: segment.to_owned(), direction, outcome: *outcome };
            self.events.get_or_create(&labels).clone()
        };
        Counters { of: Outcome::ALL.iter().map(counter).collect() }
    }

    /// The text that Prometheus reads.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = prometheus_client::encoding::text::encode(&mut text, &self.registry);
        text
    }
}
