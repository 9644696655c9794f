//! What the application is told when something did not happen as it was promised.

use crate::ring::Ring;
use crate::time::Instant;
use crate::uid::Subject;

/// Something did not happen as it was promised.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Exception {
    /// The channel; `None` if it concerns the node as a whole.
    pub subject: Option<Subject>,
    /// What it was.
    pub kind: ExceptionKind,
    /// When the node noticed.
    pub at: Instant,
}

macro_rules! exception_kinds {
    ($($(#[$doc:meta])+ $kind:ident = $name:literal,)+) => {
        /// What did not happen as it was promised.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[non_exhaustive]
        pub enum ExceptionKind {
            $($(#[$doc])+ $kind,)+
        }

        impl ExceptionKind {
            /// All of them, by their numbers.
            pub const ALL: &[Self] = &[$(Self::$kind),+];

            /// What it is called.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)+
                }
            }
        }
    };
}

// Each has one meaning. New ones come last: their numbers stand in records.
exception_kinds! {
    /// Publisher: an event has not been sent by its transmission deadline. It is still sent.
    MissedDeadline = "missed transmission deadline",
    /// Publisher: an event expired before it was sent, and has been discarded.
    ValidityExpired = "validity expired",
    /// Publisher: more faults than the omission degree; a hard real-time event was not sent in its slot.
    OmissionDegreeExceeded = "omission degree exceeded",
    /// Publisher: nothing fresh was there for the slot of a periodic channel.
    NothingPublished = "nothing published for the slot",
    /// Both: a hard real-time event was not sent, or not delivered, because its slot could not be used to its
    /// end.
    SlotSkipped = "slot skipped",
    /// Subscriber: no event arrived in the slot of a periodic channel.
    MissedEvent = "missed event",
    /// Both: the hard real-time path keeps silent, for the clock is not as accurate as planned.
    ClockOutOfBound = "clock out of bound",
    /// Both: the hard real-time path keeps silent, for the segment has another calendar.
    CalendarMismatch = "calendar mismatch",
    /// Subscriber: an event did not fit in the subscription's queue and was dropped.
    QueueFull = "queue full",
    /// Subscriber: an event did not carry what the channel's type says, and was dropped.
    Malformed = "malformed content",
    /// Publisher: a queue towards the bus was full; an event was dropped.
    TransmitQueueFull = "transmit queue full",
    /// The broker has no etag left for this subject, or gave one that is in use here.
    BindingRefused = "binding refused",
    /// The broker has no TxNode left for this node.
    ConfigurationRefused = "configuration refused",
    /// Another node uses this subject with another layout of content.
    LayoutMismatch = "layout mismatch",
    /// Another node uses this node's TxNode.
    DuplicateTxNode = "duplicate TxNode",
    /// The controller has left the bus after too many errors.
    BusOff = "bus-off",
    /// Publisher: a hard real-time event was replaced by a later one before its slot came.
    EventReplaced = "event replaced before its slot",
    /// Subscriber: a second event with other content arrived in the same slot, and was dropped. Some other node
    /// sends in it.
    ContradictoryEvent = "contradictory event in one slot",
    /// Frames, outcomes or notices were lost inside this node, because a queue was full.
    InputLost = "input lost inside the node",
    /// Subscriber: a hard real-time event was overwritten by the next one before the node fetched it.
    EventOverwritten = "event overwritten before it was fetched",
    /// Publisher: an event that waited was discarded, because its channel lost its etag or the node its TxNode.
    IdentifierLost = "identifier lost",
    /// Publisher: events came more often than their channel's rate says, and were not taken.
    RateExceeded = "event rate exceeded",
    /// Subscriber: no event of a periodic soft real-time channel has come by the time at which it was due.
    EventOverdue = "periodic event overdue",
    /// Sealed node: another node acts as broker that may not, and is not believed.
    FalseBroker = "false broker",
    /// Sealed node: a subject was said to have another etag than in the plan, which is not believed.
    FalseBinding = "false binding",
    /// Sealed node: another node acts as time master that may not, and is not followed.
    FalseMaster = "false time master",
    /// Sealed node: a node sends that is not in the plan, or has another UID there.
    UnplannedNode = "node outside the plan",
    /// Sealed node: a node announced or published on a channel whose publisher it is not, and was not believed.
    UnplannedPublisher = "publisher outside the plan",
    /// Publisher: a channel that the plan does not know was not admitted, or is not any more.
    NotAdmitted = "channel not admitted",
    /// Frames were lost in this node's controller, because its receive FIFO was full: its interrupt came too late.
    ReceiveOverrun = "receive FIFO overrun",
}

impl ExceptionKind {
    /// How many kinds there are.
    pub const COUNT: usize = Self::ALL.len();
}

/// Exceptions on their way to the application: the first `N` are kept, all are counted.
#[derive(Clone, Debug)]
pub(crate) struct Exceptions<const N: usize> {
    waiting: Ring<Exception, N>,
    counts: [u32; ExceptionKind::COUNT],
    total: u32,
    dropped: u32,
}

impl<const N: usize> Exceptions<N> {
    pub(crate) const fn new() -> Self {
        Self { waiting: Ring::new(), counts: [0; ExceptionKind::COUNT], total: 0, dropped: 0 }
    }

    /// Counts an exception that occurred so many times, and keeps it once. O(1). When nobody fetches them,
    /// the newest are not kept; the counts remain right.
    #[expect(clippy::arithmetic_side_effects, reason = "one at most is kept, of at least one")]
    pub(crate) fn raise_times(&mut self, exception: Exception, times: u32) {
        if times == 0 {
            return;
        }
        if let Some(count) = self.counts.get_mut(exception.kind as usize) {
            *count = count.wrapping_add(times);
        }
        self.total = self.total.wrapping_add(times);
        let kept = u32::from(self.waiting.push(exception));
        self.dropped = self.dropped.wrapping_add(times - kept);
    }

    pub(crate) fn take(&mut self) -> Option<Exception> {
        self.waiting.pop()
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    pub(crate) fn count(&self, kind: ExceptionKind) -> u32 {
        self.counts.get(kind as usize).copied().unwrap_or(0)
    }

    pub(crate) const fn total(&self) -> u32 {
        self.total
    }

    pub(crate) const fn dropped(&self) -> u32 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_places_exceptions_are_counted_only() {
        let mut exceptions = Exceptions::<0>::new();
        let bus_off = Exception { subject: None, kind: ExceptionKind::BusOff, at: Instant::EPOCH };
        exceptions.raise_times(bus_off, 2);
        exceptions.raise_times(bus_off, 1);
        assert_eq!((exceptions.take(), exceptions.is_empty()), (None, true));
        assert_eq!(
            (exceptions.count(ExceptionKind::BusOff), exceptions.total(), exceptions.dropped()),
            (3, 3, 3)
        );
    }

    #[test]
    fn each_kind_has_its_number_its_name_and_one_meaning() {
        for (number, kind) in ExceptionKind::ALL.iter().enumerate() {
            assert_eq!(*kind as usize, number);
            let mut others = ExceptionKind::ALL.iter().filter(|other| *other != kind);
            assert!(others.all(|other| other.name() != kind.name() && other.meaning() != kind.meaning()));
        }
    }
}
