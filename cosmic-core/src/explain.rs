//! What errors and names say to a person: the texts of `Display` and `Error`.
//!
//! They stand in one place, so that they speak with one voice: each error says in one sentence what is
//! wrong and, behind a colon or semicolon, what to do about it. A program that prints none of them does not
//! carry them.

use core::error::Error;
use core::fmt;

use crate::admission::{Objection, OtherChannel};
use crate::broker::Conflict;
use crate::calendar::CalendarError;
use crate::can::filter_banks::FilterBanksError;
use crate::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use crate::client::BindingFull;
use crate::event_layer::{AnnounceError, NoRoom, PublishError, SubscribeError};
use crate::event_layer::{Exception, ExceptionKind};
use crate::membership::DeclarationsFull;
use crate::network::fragments::StartError;
use crate::network::hard::AttachError;
use crate::network::id_map::NoPlace;
use crate::network::soft;
use crate::protocol::{AdmissionRefusal, RefusalReason};
use crate::services::TooMany;
use crate::sync::{SyncConfig, SyncConfigError};

/// `Display` of an error without a number in its text, and `Error`.
macro_rules! explain {
    ($($error:ty { $($variant:pat => $text:literal,)+ })+) => {$(
        impl fmt::Display for $error {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self {
                    $($variant => $text,)+
                })
            }
        }

        impl Error for $error {}
    )+};
}

explain! {
    AnnounceError {
        Self::TooManyChannels => "the node has no room for another channel: make CHANNELS larger",
        Self::Contradiction =>
            "the node uses this subject with other attributes, another etag or another layout of content: \
             declare the channel once and use that declaration everywhere",
        Self::EtagInUse => "another channel of this node has this etag: give each channel an etag of its own",
        Self::NoTxNode =>
            "the node has no TxNode, and the calendar names the publisher of a hard real-time channel: give \
             the node the TxNode that stands in the calendar",
        Self::NotInCalendar =>
            "the calendar has no slot of this node with this etag, period and omission degree that is long \
             enough: plan the channel, or announce it as it was planned",
        Self::OutsidePlan =>
            "the plan does not have this channel, or not this node as its publisher, and lets nothing else be \
             published: change the plan",
        Self::NoRate =>
            "the plan does not have this channel, and it states no rate by which it could be asked for: state one \
             where it is declared, or change the plan",
        Self::NotAskable =>
            "the plan does not have this channel, and its rate or deadline is out of the range that can be asked \
             for: choose microseconds to days, and events of at most eight bytes",
        Self::ReservedSubject => "the subject FFFFFFFFFFFFFFFF is the broker's own: choose another one",
        Self::NoContexts => "the node's capacity says that it has no channels with context: leave contexts: false out",
        Self::TooManySlots => "the node has no room for another slot of the calendar: make SLOTS larger",
    }
    PublishError {
        Self::NotAnnounced => "the publication has been cancelled: announce the channel again",
        Self::NotBound =>
            "the broker has not told the channel's etag or the node's TxNode yet: publish again later",
        Self::Deadline =>
            "the deadline has passed, or the event expires before it: give it a later deadline or a longer \
             validity",
        Self::HardDeadline =>
            "a hard real-time event has no deadline of its own: leave it out, the calendar has one",
        Self::TooLong =>
            "content and context are longer than a frame or the slot of the calendar, or the channel was \
             declared without context: shorten them, or send a message of several frames",
        Self::QueueFull =>
            "the queue towards the bus is full: publish less often, or make SOFT or NRT larger",
        Self::NotAdmitted =>
            "the channel is not in the plan, and the broker has not admitted it: publish again later, ask for less, \
             or change the plan",
        Self::TooFast =>
            "events come more often than the channel's rate says: publish less often, or state a higher rate \
             where the channel is declared",
    }
    NoRoom {
        Self => "the value is too large for its attribute, or the attributes do not fit in a frame: use fewer",
    }
    FilterBanksError {
        Self::TooManyWanted => "more frames are wanted than the plan has room for: make WANTED larger",
        Self::TooFewBanks => "each FIFO that is used needs a filter bank: give the plan more banks",
    }
    AttachError {
        Self::Full => "all HRT message buffers or places for slots are in use: make SLOTS larger",
    }
    soft::Full {
        Self => "the queue towards the bus is full: submit less often, or make SOFT or NRT larger",
    }
    StartError {
        Self::Busy => "the message before it is still being sent: start this one when the sender is idle",
        Self::TooLong => "the message is longer than the sender has room for: make LEN larger",
    }
    NoPlace {
        Self => "the key found no place in the map: make the map larger",
    }
    TooMany {
        Self => "the services have no room for another channel: make their capacity larger",
    }
    DeclarationsFull {
        Self => "the node has no room for another declaration of interest: make the capacity larger",
    }
    BindingFull {
        Self => "the node has no room for another subject to be bound: make the capacity larger",
    }
}

impl fmt::Display for SubscribeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Channel(error) => error.fmt(f),
            Self::TooManySubscriptions => {
                f.write_str("the node has no room for another subscription: make SUBSCRIPTIONS larger")
            }
        }
    }
}

// The text of `Channel` is that of the error within, so that is not a source beside it.
impl Error for SubscribeError {}

impl fmt::Display for RefusalReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Utilisation => "all channels together take more than the bus has",
            Self::Blocking => {
                "the deadline is too short for what may be before it on the bus, whatever the rate"
            }
            Self::Late => "the channel itself might be late",
            Self::OtherLate => "another channel might be late",
            Self::LessUrgentLate => "a less urgent frame with a deadline might be late",
            Self::Full => "as many channels are admitted as there is room for",
        })
    }
}

impl fmt::Display for AdmissionRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.reason)?;
        if let Some(etag) = self.suffers {
            write!(f, " (etag {})", etag.get())?;
        }
        match self.fits_at {
            Some(interval) => {
                write!(f, ": an interval of {} us would do", interval.duration().as_micros())
            }
            None => f.write_str(": ask for less, or change the plan"),
        }
    }
}

impl Error for AdmissionRefusal {}

impl fmt::Display for Objection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Utilisation => RefusalReason::Utilisation.fmt(f),
            Self::Blocking => RefusalReason::Blocking.fmt(f),
            Self::Late => RefusalReason::Late.fmt(f),
            Self::Suffers(OtherChannel::Planned(subject)) => write!(f, "subject {subject} might be late"),
            Self::Suffers(OtherChannel::Admitted(etag)) => write!(f, "etag {} might be late", etag.get()),
            Self::LessUrgent(_) => RefusalReason::LessUrgentLate.fmt(f),
            Self::Full => RefusalReason::Full.fmt(f),
        }
    }
}

impl fmt::Display for CalendarError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cycle => f.write_str("the cycle is zero or too long: choose at most the longest cycle"),
            Self::Etag(slot) => write!(
                f,
                "the etag of slot {slot} is not a hard real-time one: choose one of {} to {}",
                Etag::HARD_FIRST.get(),
                Etag::HARD_LAST.get()
            ),
            Self::Publisher(slot) => write!(
                f,
                "slot {slot} belongs to the broker's TxNode, which sends no hard real-time events: name an \
                 ordinary node"
            ),
            Self::Length(slot) => {
                write!(f, "the frame of slot {slot} is longer than eight bytes: split the content")
            }
            Self::Period(slot) => write!(
                f,
                "the period of slot {slot} is zero or does not divide the cycle: make the cycle a multiple \
                 of all periods"
            ),
            Self::Phase(slot) => {
                write!(f, "the phase of slot {slot} is not less than its period: subtract periods from it")
            }
            Self::Window(slot) => write!(
                f,
                "the window of slot {slot} is longer than its period: send less often, tolerate fewer \
                 omissions, or use a faster bus"
            ),
            Self::Overlap(one, other) => write!(
                f,
                "windows of slots {one} and {other} overlap: move one by its phase, or let cosmic-plan do so"
            ),
        }
    }
}

impl Error for CalendarError {}

impl fmt::Display for SyncConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Period => write!(
                f,
                "the period of synchronisation is out of range: choose one from {} to {}",
                SyncConfig::SHORTEST_PERIOD,
                SyncConfig::LONGEST_PERIOD
            ),
            Self::StampError => f.write_str(
                "the error of time-stamps is over a hundredth of the period: choose a longer period",
            ),
            Self::Rank => f.write_str(
                "the node has a rank as time master, and services that only follow: plan it with rank \"never\", or \
                 choose services that can be master",
            ),
            Self::Drift => f.write_str(
                "the drift is negative or too large for a clock rate: state that of the oscillator, or choose \
                 a longer period",
            ),
        }
    }
}

impl Error for SyncConfigError {}

impl<Name: fmt::Display> fmt::Display for Conflict<Name> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfRange => f.write_str(
                "the id is outside of the broker's table: make the table larger, or drop the entry",
            ),
            Self::Taken(name) => write!(f, "the id belongs to {name} already: drop one of the entries"),
        }
    }
}

impl<Name: fmt::Debug + fmt::Display> Error for Conflict<Name> {}

impl ExceptionKind {
    /// What it means, in a sentence that also says where to look.
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::MissedDeadline => {
                "an event was not sent by its deadline and is sent late; the bus or this node has too much to do"
            }
            Self::ValidityExpired => {
                "an event expired before it was sent and was discarded; the bus is too full"
            }
            Self::OmissionDegreeExceeded => {
                "a hard real-time event was not sent in its slot; the bus had more faults than planned for"
            }
            Self::NothingPublished => {
                "nothing fresh was there for the slot of a periodic channel; its publisher is late"
            }
            Self::SlotSkipped => {
                "a hard real-time event was not sent, because the calendar task came late or its mailbox was \
                 not free"
            }
            Self::MissedEvent => {
                "no event arrived in the slot of a periodic channel; look at its publisher and the wiring"
            }
            Self::ClockOutOfBound => {
                "the node keeps silent in its slots, because its clock is less accurate than planned; look for \
                 the time master"
            }
            Self::CalendarMismatch => {
                "the node keeps silent in its slots, because the time master has another calendar; flash both \
                 from one plan"
            }
            Self::QueueFull => {
                "an event did not fit in a subscription's queue and was dropped; fetch more often, or make the \
                 queue deeper"
            }
            Self::Malformed => {
                "an event did not carry what the channel's type says and was dropped; publisher and subscriber \
                 differ"
            }
            Self::TransmitQueueFull => {
                "an event was dropped, because the queue towards the bus was full; publish less, or make it longer"
            }
            Self::BindingRefused => {
                "the broker has no etag for this subject, or gave one that is in use here"
            }
            Self::ConfigurationRefused => "the broker has no TxNode left for this node",
            Self::LayoutMismatch => {
                "another node uses this subject with another layout of content; build both from one declaration"
            }
            Self::DuplicateTxNode => "another node uses this node's TxNode; give each node its own",
            Self::BusOff => "the controller left the bus after too many errors; look at wiring and bit rate",
            Self::EventReplaced => {
                "a hard real-time event was replaced by a later one before its slot came; publish once a period"
            }
            Self::InputLost => {
                "frames, outcomes or notices were lost inside the node, because a queue was full; its tasks run \
                 too seldom"
            }
            Self::ReceiveOverrun => {
                "frames were lost in the node's CAN controller, because its receive FIFO was full; its receive \
                 interrupt is held up for longer than three frames"
            }
            Self::ContradictoryEvent => {
                "a second event with other content arrived in the same slot and was dropped; some other node \
                 sends in it"
            }
            Self::EventOverwritten => {
                "a hard real-time event was overwritten by the next one before the node fetched it; the event \
                 half runs too seldom"
            }
            Self::IdentifierLost => {
                "an event that waited was discarded, because its channel lost its etag or the node its TxNode"
            }
            Self::RateExceeded => {
                "an event was not taken, because its channel has a rate that it would exceed; the application \
                 publishes too often"
            }
            Self::FalseBroker => {
                "another node acts as broker, or probes, and the plan does not let it; it is not believed"
            }
            Self::FalseBinding => {
                "a subject was said to have another etag than the plan says, and that was not believed; look for \
                 a foreign broker, or nodes of another plan"
            }
            Self::FalseMaster => {
                "another node acts as time master, and the plan does not let it; it is not followed"
            }
            Self::UnplannedNode => {
                "a node sends that is not in the plan, or has another UID there; it is not believed"
            }
            Self::UnplannedPublisher => {
                "a node announced or published on a channel on which the plan does not let it; its events were \
                 dropped"
            }
            Self::NotAdmitted => {
                "a channel that is not in the plan was not admitted, or is not any more, and is not published; the \
                 admission state of the channel says why"
            }
            Self::EventOverdue => {
                "no event of a periodic channel has come for longer than its period and deadline; look at its \
                 publisher and the load of the bus"
            }
        }
    }
}

impl fmt::Display for ExceptionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl fmt::Display for Exception {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(subject) = self.subject {
            write!(f, "{subject}: ")?;
        }
        write!(f, "{}: {}", self.kind, self.kind.meaning())
    }
}

/// A field of the identifier, in as many hexadecimal digits as it can need.
macro_rules! hexadecimal {
    ($($name:ty, $digits:literal;)+) => {$(
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!("{:0", $digits, "X}"), self.get())
            }
        }
    )+};
}

hexadecimal! {
    Priority, 2;
    TxNode, 2;
    Etag, 4;
}

impl fmt::Display for Id {
    /// The 29 bits, as a candump log has them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08X}", self.raw())
    }
}

impl fmt::Display for Payload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_slice().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl fmt::Display for Frame {
    /// As in a candump log: `1F5FC004#0102`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}#{}", self.id, self.payload)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::{Duration, Instant};
    use crate::uid::{NodeUid, Subject};
    use std::string::{String, ToString};

    fn text(error: impl Error) -> String {
        error.to_string()
    }

    #[test]
    fn errors_say_what_is_wrong_and_what_to_do() {
        let full = text(SubscribeError::Channel(AnnounceError::TooManyChannels));
        assert_eq!(full, "the node has no room for another channel: make CHANNELS larger");
        let etag = text(CalendarError::Etag(3));
        assert_eq!(etag, "the etag of slot 3 is not a hard real-time one: choose one of 100 to 1023");
        let taken = text(Conflict::Taken(NodeUid::MIN));
        assert_eq!(taken, "the id belongs to 0000000000000001 already: drop one of the entries");
        let period = text(SyncConfigError::Period);
        assert_eq!(
            period,
            "the period of synchronisation is out of range: choose one from 5000000 ns to 10000000000 ns"
        );
        for text in [text(PublishError::QueueFull), text(soft::Full), text(TooMany), text(NoRoom)] {
            assert!(text.contains(": "), "no remedy: {text}");
        }
    }

    #[test]
    fn refusals_say_what_would_fit() {
        let suffers = Etag::new(1024);
        let fits_at = Some(crate::protocol::CoarseSpan::floor(Duration::from_millis(10)));
        let refusal = AdmissionRefusal { reason: RefusalReason::OtherLate, fits_at, suffers };
        let expected = "another channel might be late (etag 1024): an interval of 10000 us would do";
        assert_eq!(text(refusal), expected);
        let refusal = AdmissionRefusal { reason: RefusalReason::Full, fits_at: None, suffers: None };
        assert!(text(refusal).ends_with(": ask for less, or change the plan"));
    }

    #[test]
    fn exceptions_are_sentences_with_their_subject() {
        let exception = Exception {
            subject: Subject::new(0x2A),
            kind: ExceptionKind::BusOff,
            at: Instant::from_epoch(Duration::from_ticks(0)),
        };
        let expected = "000000000000002A: bus-off: the controller left the bus after too many errors; look at \
                        wiring and bit rate";
        assert_eq!(exception.to_string(), expected);
        let node = Exception { subject: None, ..exception };
        assert!(node.to_string().starts_with("bus-off: "));
        assert_eq!(std::format!("{:>10}", ExceptionKind::BusOff), "   bus-off");
    }

    #[test]
    fn names_are_hexadecimal() {
        let id = Id::new(Priority::CONFIGURATION, TxNode::BROKER, Etag::SUPPLY_ETAG);
        let frame = Frame::new(id, Payload::truncated([1, 0xAB, 0, 0, 0, 0, 0, 0], 2));
        assert_eq!(frame.to_string(), "1F5FC004#01AB");
        let fields = std::format!("{} {} {}", id.priority(), id.tx_node(), id.etag());
        assert_eq!(fields, "FA 7F 0004");
        assert_eq!(std::format!("{:?}", NodeUid::MAX), "NodeUid(FFFFFFFFFFFFFFFF)");
        assert_eq!(std::format!("{:?}", Subject::MIN), "Subject(0000000000000001)");
    }
}
