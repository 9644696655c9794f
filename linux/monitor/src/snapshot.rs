//! What a monitor shows: values for people, pages and `--json`. Spans are nanoseconds, UIDs sixteen hexadecimal digits.

use serde::Serialize;

use crate::decode::DecodedField;

/// All that is known of a segment at an instant.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct Snapshot {
    /// The name of the segment, by the plan.
    pub segment: Option<String>,
    /// Since the monitor started.
    pub listening_ns: u64,
    /// The link to the segment.
    pub link: LinkView,
    /// How busy the bus is.
    pub load: LoadView,
    /// The clock of the cluster.
    pub clock: ClockView,
    /// TxNodes of the brokers that are active.
    pub brokers: Vec<u8>,
    /// By TxNode; planned ones also if they were never heard.
    pub nodes: Vec<NodeView>,
    /// By etag, those without one last; planned ones also if nothing was heard of them.
    pub channels: Vec<ChannelView>,
    /// The slots of the calendar, by phase; empty without a plan.
    pub slots: Vec<SlotView>,
    /// After so many nanoseconds the calendar repeats; 0 without a plan.
    pub cycle_ns: u64,
    /// Messages of several frames, on the channels that carry such by the plan.
    pub messages: MessagesView,
    /// Channels, publishers and subscribers that found no place here.
    pub overlooked: u64,
}

/// Messages of several frames, as a subscriber would have put them together.
#[derive(Clone, Copy, PartialEq, Eq, Default, Serialize, Debug)]
pub struct MessagesView {
    /// Those that came whole.
    pub whole: u64,
    /// Those that were given up: a frame was missing, none came any more, the check sum was wrong, or there were too many
    /// at once.
    pub dropped: u64,
    /// Frames of messages whose beginning was not heard, and frames that are part of none.
    pub stray_frames: u64,
}

/// What the link tells of itself.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Debug)]
pub struct LinkView {
    /// Frames of COSMIC's kind.
    pub received: u64,
    /// Frames that COSMIC does not use.
    pub foreign: u64,
    /// Frames that were lost on the way here, as far as the link tells.
    pub lost: u64,
    /// Since the last frame of any kind; `None` if there was none.
    pub silent_ns: Option<u64>,
    /// The transmit error counter of the link's controller, if it tells.
    pub transmit_errors: Option<u8>,
    /// The receive error counter of the link's controller, if it tells.
    pub receive_errors: Option<u8>,
    /// How often the link's controller has left the bus.
    pub bus_off: u32,
}

/// Shares of the time of the bus by class, 0 to 1.
#[derive(Clone, Copy, PartialEq, Default, Serialize, Debug)]
pub struct Share {
    /// Hard real-time.
    pub hard: f64,
    /// Soft real-time.
    pub soft: f64,
    /// Non real-time, configuration and binding included.
    pub non_real_time: f64,
    /// Frames that are not COSMIC's.
    pub foreign: f64,
}

impl Share {
    /// Of all classes.
    pub fn total(&self) -> f64 {
        self.hard + self.soft + self.non_real_time + self.foreign
    }
}

/// How busy the bus is, in bits as they are on the wire: stuff bits and the space behind each frame are counted. Frames
/// that failed are not seen by a listener, and not counted.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct LoadView {
    /// The bit rate that shares refer to.
    pub bits_per_second: u32,
    /// Over the last second.
    pub now: Share,
    /// Second by second, the last minute.
    pub history: Vec<Share>,
    /// Frames a second, over the last second.
    pub frames_per_second: f64,
    /// Frames since the start.
    pub frames: u64,
    /// Their bits.
    pub bits: u64,
}

/// The clock of the cluster as a listener sees it.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct ClockView {
    /// Who sends sync frames.
    pub master: Option<u8>,
    /// Its place in the succession.
    pub rank: Option<u8>,
    /// The digest of its calendar, eight hexadecimal digits; `None` if it has none.
    pub calendar: Option<String>,
    /// The digest that the plan has.
    pub planned_calendar: Option<String>,
    /// Global time, if it is known.
    pub global_ns: Option<u64>,
    /// How far that may be off, as the scatter of the time-stamps here shows. The delay that all of them have in common
    /// does not show.
    pub uncertainty_ns: Option<u64>,
    /// The distance from its predecessor's time scale that the master states.
    pub accuracy_ns: Option<u64>,
    /// How often the time scale has jumped.
    pub steps: u32,
    /// Since the last pair of sync and follow-up.
    pub age_ns: Option<u64>,
}

/// A node.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct NodeView {
    /// Its short id.
    pub tx_node: u8,
    /// Its name in the plan.
    pub name: Option<String>,
    /// Its UID, by its claim or the plan.
    pub uid: Option<String>,
    /// Returns whether the plan knows it.
    pub planned: bool,
    /// Whether it lives: its status or another frame came lately.
    pub alive: bool,
    /// What it says it does: `starting`, `operational`, `hard inhibited`, `leaving`.
    pub state: Option<&'static str>,
    /// Its transmit error counter.
    pub transmit_errors: Option<u8>,
    /// Its receive error counter.
    pub receive_errors: Option<u8>,
    /// Exceptions that it has counted since the monitor heard it first.
    pub exceptions: u64,
    /// How often it has started again meanwhile.
    pub restarts: u32,
    /// For how long it has run, in seconds; stays at 65 535.
    pub uptime_s: Option<u64>,
    /// Since its last frame; `None` if it was never heard.
    pub silent_ns: Option<u64>,
    /// Frames with its TxNode.
    pub frames: u64,
    /// Frames a second, over the last second.
    pub frames_per_second: f64,
    /// Whether it is the active broker.
    pub is_broker: bool,
    /// Whether it is the time master.
    pub is_master: bool,
}

/// The class of a channel.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Debug)]
pub enum ChannelClass {
    /// Hard real-time.
    #[serde(rename = "HRT")]
    Hard,
    /// Soft real-time.
    #[serde(rename = "SRT")]
    Soft,
    /// Non real-time.
    #[serde(rename = "NRT")]
    NonRealTime,
}

impl ChannelClass {
    /// The abbreviation that the papers use, without "EC".
    pub const fn abbreviation(self) -> &'static str {
        match self {
            Self::Hard => "HRT",
            Self::Soft => "SRT",
            Self::NonRealTime => "NRT",
        }
    }
}

/// A channel.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct ChannelView {
    /// Its short name; `None` if no broker has told one yet.
    pub etag: Option<u16>,
    /// Its subject, if a binding was seen or the plan knows it.
    pub subject: Option<String>,
    /// Its name in the plan.
    pub name: Option<String>,
    /// Its class.
    pub class: Option<ChannelClass>,
    /// Events a second, over the last second.
    pub rate: f64,
    /// Events, or frames of messages, so far.
    pub frames: u64,
    /// The longest time that the plan gives an event.
    pub deadline_ns: Option<u64>,
    /// The period or least distance of events in the plan.
    pub period_ns: Option<u64>,
    /// Who announces or publishes.
    pub publishers: Vec<PublisherView>,
    /// Who subscribes.
    pub subscribers: Vec<SubscriberView>,
    /// The last event, or the last whole message.
    pub last: Option<ContentView>,
    /// Of soft real-time channels.
    pub latency: Option<LatencyView>,
}

impl ChannelView {
    /// Its name, or its subject, or its etag.
    pub fn label(&self) -> String {
        let etag = || self.etag.map_or_else(|| "?".to_owned(), |etag| format!("etag {etag}"));
        self.name.clone().or_else(|| self.subject.clone()).unwrap_or_else(etag)
    }
}

/// A publisher of a channel.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct PublisherView {
    /// Its short id.
    pub tx_node: u8,
    /// Its name in the plan.
    pub name: Option<String>,
    /// What is left of the lease of its announcement; `None` if it has not announced.
    pub lease_ns: Option<u64>,
    /// Returns whether the plan names it as a publisher; `None` without a plan of the channel.
    pub planned: Option<bool>,
    /// Its frames.
    pub frames: u64,
    /// The mean distance of its frames, of late.
    pub interval_ns: Option<u64>,
    /// The shortest distance of two frames.
    pub shortest_ns: Option<u64>,
    /// The longest distance of two frames.
    pub longest_ns: Option<u64>,
    /// Since its last frame.
    pub silent_ns: Option<u64>,
}

/// A subscriber of a channel.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct SubscriberView {
    /// Its short id.
    pub tx_node: u8,
    /// Its name in the plan.
    pub name: Option<String>,
    /// What is left of its lease; `None` if only the plan knows of it.
    pub lease_ns: Option<u64>,
}

/// The last event of a channel, or its last whole message.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct ContentView {
    /// Who sent it.
    pub tx_node: u8,
    /// How long ago.
    pub age_ns: u64,
    /// Its bytes, hexadecimal.
    pub data: String,
    /// Its fields, where the plan describes the content.
    pub fields: Vec<DecodedField>,
}

/// How near soft real-time events came to their deadlines, from the priorities of their frames.
///
/// A frame is loaded with the priority `1 + remaining / Δt_p`, and again whenever a step of Δt_p has passed. So the
/// priority of a frame on the bus says what was left of its deadline, to one step: at least `(p - 1) Δt_p`, less than
/// `p Δt_p`; at 249, the least urgent, only that it was at least `248 Δt_p`. Priority 1 means less than one step, or
/// that the deadline had passed. A node that promotes late makes its events look younger than they are.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Debug)]
pub struct LatencyView {
    /// Δt_p: how much time one priority stands for.
    pub step_ns: u64,
    /// Frames that were looked at.
    pub frames: u64,
    /// What was left at least, of the last frame, when it had arrived. Negative if it may have been too late.
    pub left_ns: i64,
    /// The least of all frames.
    pub least_left_ns: i64,
    /// How old the last event was at most when it had arrived, if the plan states the deadline.
    pub age_ns: Option<u64>,
    /// The oldest of all.
    pub oldest_ns: Option<u64>,
    /// Frames at priority 1: late, or within one step of it.
    pub at_the_limit: u64,
    /// Frames at priority 249, about which little is known.
    pub least_urgent: u64,
}

/// A slot of the calendar, planned and seen.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct SlotView {
    /// The channel.
    pub etag: u16,
    /// Its name.
    pub name: String,
    /// Who sends in it.
    pub publisher: u8,
    /// The span between two occurrences.
    pub period_ns: u64,
    /// When it is ready, from the start of the cycle.
    pub phase_ns: u64,
    /// From ready: the last instant at which its frame is on the bus.
    pub deadline_ns: u64,
    /// From ready: the end of its window.
    pub delivery_ns: u64,
    /// Frames seen in it.
    pub frames: u64,
    /// Occurrences of a periodic slot without a frame.
    pub missed: u64,
    /// Frames of this channel and publisher outside of the window.
    pub outside: u64,
    /// From ready to the end of the last frame; negative if it came before.
    pub last_ns: Option<i64>,
    /// The earliest of all.
    pub earliest_ns: Option<i64>,
    /// The latest of all.
    pub latest_ns: Option<i64>,
}
