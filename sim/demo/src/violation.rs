//! What can be wrong with a run.

use cosmic_bus::VirtualInstant;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::ExceptionKind;

use crate::cluster::Cluster;
use crate::columns::{agreeing, counted};
use crate::journal::LoggedError;
use crate::order::Inversion;
use crate::span::Span;

/// Something that was not as promised.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Violation {
    /// No hard real-time slot could be judged before the run ended.
    NothingJudged {
        /// Attempts to send a frame that were destroyed, and all attempts.
        destroyed: (usize, usize),
    },
    /// The images carry another calendar than the judge.
    OtherCalendar {
        /// The digest of the images' calendar.
        digest: u32,
    },
    /// A published hard real-time event was not sent in its slot.
    NotSent {
        /// The ready instant of the slot.
        ready: VirtualInstant,
        /// The channel.
        etag: Etag,
        /// What the publisher was told.
        reason: Option<ExceptionKind>,
    },
    /// A hard real-time event within its fault hypothesis did not reach a subscriber.
    NotDelivered {
        /// The ready instant of the slot.
        ready: VirtualInstant,
        /// The channel.
        etag: Etag,
        /// Whom.
        subscriber: TxNode,
        /// Attempts that were destroyed.
        faulted: u32,
    },
    /// A hard real-time event became visible at another instant than that of the calendar.
    OffInstant {
        /// The ready instant of the slot.
        ready: VirtualInstant,
        /// The channel.
        etag: Etag,
        /// Where.
        subscriber: TxNode,
        /// By how much, later is positive.
        off: Span,
    },
    /// A hard real-time event became visible more than once.
    Duplicate {
        /// The ready instant of the slot.
        ready: VirtualInstant,
        /// The channel.
        etag: Etag,
        /// Where.
        subscriber: TxNode,
        /// How often.
        times: usize,
    },
    /// A hard real-time frame was on the bus outside its slot.
    OutsideSlot {
        /// When.
        at: VirtualInstant,
        /// The channel.
        etag: Etag,
    },
    /// A hard real-time event was lost and a node was not told.
    Silence {
        /// The ready instant of the slot.
        ready: VirtualInstant,
        /// The channel.
        etag: Etag,
        /// Who was not told.
        node: TxNode,
        /// Of what.
        kind: ExceptionKind,
    },
    /// Of the events of a channel, more were lost than were reported, or the other way round.
    Unreported {
        /// The channel.
        etag: Etag,
        /// Who had to be told.
        node: TxNode,
        /// What became of the events.
        what: Loss,
        /// How many there were.
        lost: usize,
        /// How many were reported.
        reported: usize,
    },
    /// A soft real-time event was sent before a more urgent one that competed with it.
    OutOfOrder(Inversion),
    /// Records of a node are missing, so nothing is known of these events.
    RecordsLost {
        /// Which.
        node: TxNode,
        /// How many.
        count: u64,
    },
    /// A node was bus-off and was not told.
    BusOffUntold {
        /// Which.
        node: TxNode,
        /// Since when.
        at: VirtualInstant,
    },
    /// A node logged an error.
    Logged(LoggedError),
    /// Frames or records tell of events that nobody published.
    Invented {
        /// How many.
        count: usize,
    },
}

/// What can become of an event that does not arrive, or late.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Loss {
    /// Not sent by its deadline.
    Late,
    /// Not sent before it expired.
    Expired,
    /// Sent, and not delivered to a subscriber.
    Undelivered,
    /// Not taken by the publisher's middleware.
    Refused,
    /// Published before the clocks were synchronised, and not delivered.
    Settling,
    /// Not sent, although a later event of the same channel was.
    Overtaken,
}

impl Violation {
    /// In words, for one line.
    pub fn describe(&self, cluster: &Cluster) -> String {
        let channel = |etag: &Etag| cluster.channel(*etag).map_or("another channel", |it| it.name);
        let name = |node: &TxNode| cluster.name_of(*node);
        let slot =
            |etag: &Etag, ready: &VirtualInstant| format!("{} at {}", channel(etag), milliseconds(*ready));
        match self {
            Self::NothingJudged { destroyed: (destroyed, attempts) } => {
                let most = destroyed * 2 > *attempts;
                let remedy = if most { "with fewer errors (--errors)" } else { "longer (--seconds)" };
                format!(
                    "nothing could be judged: there was no HRT slot in which clocks were synchronised and something \
                     was published, and {destroyed} of {} to send a frame were destroyed; let it run {remedy}",
                    counted(*attempts as u64, "attempt")
                )
            }
            Self::OtherCalendar { digest } => {
                format!("the images carry another calendar ({digest:08X}) than the demo: build both again")
            }
            Self::NotSent { ready, etag, reason } => {
                let reason = reason.map_or("and nobody was told".into(), |it| format!("{it:?}"));
                format!("{}: published, but not sent in its slot ({reason})", slot(etag, ready))
            }
            Self::NotDelivered { ready, etag, subscriber, faulted } => format!(
                "{}: not delivered to {}, with {}",
                slot(etag, ready),
                name(subscriber),
                counted(*faulted, "destroyed attempt")
            ),
            Self::OffInstant { ready, etag, subscriber, off } => {
                format!("{}: visible to {} {off} off its instant", slot(etag, ready), name(subscriber))
            }
            Self::Duplicate { ready, etag, subscriber, times } => {
                let times = counted(*times as u64, "time");
                format!("{}: visible to {} {times}", slot(etag, ready), name(subscriber))
            }
            Self::OutsideSlot { at, etag } => {
                format!("{}: a frame outside its slot, at {}", channel(etag), milliseconds(*at))
            }
            Self::Silence { ready, etag, node, kind } => {
                format!("{}: lost, and {} was not told ({kind:?})", slot(etag, ready), name(node))
            }
            Self::Unreported { etag, node, what, lost, reported } => format!(
                "{}: {} {}, {} was told {}",
                channel(etag),
                counted(*lost as u64, "event"),
                what.describe(*lost),
                name(node),
                counted(*reported as u64, "time")
            ),
            Self::OutOfOrder(inversion) => format!(
                "at {}: {} sent an event {} less urgent than one of {}",
                milliseconds(inversion.at),
                name(&inversion.winner),
                inversion.by,
                name(&inversion.loser)
            ),
            Self::RecordsLost { node, count } => {
                let verb = if *count == 1 { "is" } else { "are" };
                format!("{}: {} {verb} missing", name(node), counted(*count, "record"))
            }
            Self::BusOffUntold { node, at } => {
                format!("{} was bus-off from {} on and was not told", name(node), milliseconds(*at))
            }
            Self::Logged(error) => {
                format!("at {}: {} logged: {}", milliseconds(error.at), name(&error.node), error.text)
            }
            Self::Invented { count: 1 } => "1 frame or record of an event that nobody published".into(),
            Self::Invented { count } => format!("{count} frames or records of events that nobody published"),
        }
    }
}

impl Loss {
    /// What became of so many events.
    const fn describe(self, events: usize) -> &'static str {
        match self {
            Self::Late => agreeing(events, "was late", "were late"),
            Self::Expired => "expired",
            Self::Undelivered => {
                agreeing(events, "was sent but not delivered", "were sent but not delivered")
            }
            Self::Refused => agreeing(events, "was refused", "were refused"),
            Self::Settling if events == 1 => "was lost before the clocks were synchronised",
            Self::Settling => "were lost before the clocks were synchronised",
            Self::Overtaken if events == 1 => "was not sent, but a later one was",
            Self::Overtaken => "were not sent, but later ones were",
        }
    }
}

fn milliseconds(at: VirtualInstant) -> String {
    format!("{:.3} ms", at.as_ticks() as f64 / 1e6)
}
