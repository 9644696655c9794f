//! A segment: its monitor, and what has crossed it since browsers were told.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use cosmic_bus::{TrafficClass, WireFrame};
use cosmic_core::can::{BitRate, Frame};
use cosmic_core::time::Instant;
use cosmic_linux::{Tap, Tapped, What};
use cosmic_monitor::{Meaning, Monitor, Notice, hex_text};
use tokio::time::MissedTickBehavior;

use crate::browsers::Message;
use crate::messages::{Frames, Line, Notices, Said, State};

/// A segment of a [`Hub`](crate::Hub): what crosses its link is handed in here.
#[derive(Clone)]
pub struct Segment {
    pub(crate) shared: Arc<Shared>,
}

pub(crate) struct Shared {
    number: usize,
    pub(crate) name: String,
    pub(crate) link: String,
    live: Mutex<Live>,
}

struct Live {
    monitor: Monitor,
    bit_rate: BitRate,
    now: Instant,
    trouble: Option<String>,
    /// Another trouble, or none, than was told.
    is_changed: bool,
    lines: Vec<Line>,
    untold: u64,
    total: u64,
    /// The sequence number of the last notice that was told.
    noticed: u64,
}

impl Segment {
    pub(crate) fn new(number: usize, name: String, link: String, monitor: Monitor) -> Self {
        let live = Live {
            bit_rate: monitor.bit_rate(),
            monitor,
            now: Instant::EPOCH,
            trouble: None,
            is_changed: true,
            lines: Vec::new(),
            untold: 0,
            total: 0,
            noticed: 0,
        };
        Self { shared: Arc::new(Shared { number, name, link, live: Mutex::new(live) }) }
    }

    /// Something has happened on the link. Constant time, but for what the monitor does once a second.
    pub fn on_tapped(&self, tapped: &Tapped) {
        self.shared.lock().on_tapped(tapped);
    }

    /// Time has come so far, by the clock of what is handed in. Without this, time stands still while nothing crosses.
    pub fn advance(&self, now: Instant) {
        let mut live = self.shared.lock();
        live.now = live.now.max(now);
    }

    /// Hands in all that a tap tells, and the time while it tells nothing. Ends never.
    pub async fn follow(self, tap: Tap) {
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                _ = tick.tick() => self.advance(tap.now()),
                tapped = tap.next() => self.on_tapped(&tapped),
            }
        }
    }

    /// What a person should know of the link from now on; `None` if all is well.
    pub fn trouble(&self, trouble: Option<String>) {
        self.shared.lock().set_trouble(trouble);
    }

    /// Looks at the monitor.
    pub fn with_monitor<R>(&self, look: impl FnOnce(&Monitor) -> R) -> R {
        look(&self.shared.lock().monitor)
    }
}

impl Live {
    fn on_tapped(&mut self, tapped: &Tapped) {
        let at = tapped.at;
        self.now = self.now.max(at);
        match &tapped.what {
            What::Frame(frame) => {
                self.monitor.on_frame(frame, at);
                let line = |live: &Self| live.line_of(frame, at);
                self.add(line);
            }
            What::Foreign(frame) => {
                self.monitor.on_foreign(frame.as_ref(), at);
                self.add(|live| live.foreign(frame.as_ref(), at));
            }
            What::Lost(frames) => self.monitor.on_lost(*frames, at),
            What::Errors(errors) => self.monitor.on_errors(*errors, at),
            What::BusOff => self.monitor.on_bus_off(at),
            What::Connected => self.set_trouble(None),
            What::Disconnected { why, ends } => {
                let again = if *ends { "" } else { "; trying again" };
                self.set_trouble(Some(format!("{why}{again}")));
            }
            What::Malformed => {}
        }
    }

    fn set_trouble(&mut self, trouble: Option<String>) {
        self.is_changed |= self.trouble != trouble;
        self.trouble = trouble;
    }

    fn add(&mut self, line: impl FnOnce(&Self) -> Line) {
        self.total += 1;
        if self.lines.len() < MOST_FRAMES {
            let line = line(self);
            self.lines.push(line);
        } else {
            self.untold += 1;
        }
    }

    fn line_of(&self, frame: &Frame, at: Instant) -> Line {
        let wire = WireFrame::from(*frame);
        let whole = self.monitor.decode_whole(frame);
        let is_part = whole.is_none();
        let decoded = whole.unwrap_or_else(|| self.monitor.decode(frame));
        let said = match decoded.meaning {
            _ if is_part => Said::Words(format!("part of a message: {}", decoded.data)),
            Meaning::Event { malformed: Some(why), .. } => Said::Words(format!("malformed: {why}")),
            Meaning::Event { fields, malformed: None } if fields.is_empty() => Said::Nothing,
            Meaning::Event { fields, malformed: None } => {
                Said::Values(fields.into_iter().map(|field| field.value).collect())
            }
            Meaning::Control { name, fields } => {
                Said::Words(fields.iter().fold(name.to_owned(), |words, field| format!("{words} {field}")))
            }
            Meaning::Malformed => Said::Words("no message of the protocol".to_owned()),
        };
        let class = TrafficClass::of(&wire) as u8;
        let (priority, tx_node, etag) = (Some(decoded.priority), Some(decoded.tx_node), Some(decoded.etag));
        Line(micros(at), self.on_the_bus(&wire), class, priority, tx_node, etag, decoded.data, said)
    }

    fn foreign(&self, frame: Option<&WireFrame>, at: Instant) -> Line {
        let bytes = frame.map_or_else(String::new, |frame| {
            hex_text(frame.padded_data().get(..frame.data_len()).unwrap_or_default())
        });
        let duration = frame.map_or(0.0, |frame| self.on_the_bus(frame));
        Line(micros(at), duration, TrafficClass::Foreign as u8, None, None, None, bytes, Said::Nothing)
    }

    /// In microseconds, without the space behind it.
    fn on_the_bus(&self, frame: &WireFrame) -> f64 {
        f64::from(frame.bit_count()) * 1e6 / f64::from(self.bit_rate.bits_per_second())
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Live> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is new since the last call; the whole state too if it is due, or what is wrong with the link has changed.
    pub(crate) fn news(&self, state_is_due: bool) -> Vec<Message> {
        let mut live = self.lock();
        let live = &mut *live;
        let mut messages = Vec::new();
        if !live.lines.is_empty() || live.untold > 0 {
            let frames =
                Frames { segment: self.number, total: live.total, untold: live.untold, frames: &live.lines };
            messages.push(Message::new("frames", &frames, live.lines.len() as u64));
            live.lines.clear();
            live.untold = 0;
        }
        if state_is_due || live.is_changed {
            live.is_changed = false;
            messages.push(self.state(live));
        }
        let fresh: Vec<Notice> = live.monitor.notices(live.noticed).cloned().collect();
        if let Some(last) = fresh.last() {
            live.noticed = last.sequence;
            messages.push(Message::new("notices", &Notices { segment: self.number, notices: &fresh }, 0));
        }
        messages
    }

    /// What a browser needs that knows nothing.
    pub(crate) fn everything(&self) -> [Message; 2] {
        let mut live = self.lock();
        let all: Vec<Notice> = live.monitor.notices(0).cloned().collect();
        let state = self.state(&mut live);
        [state, Message::new("notices", &Notices { segment: self.number, notices: &all }, 0)]
    }

    fn state(&self, live: &mut Live) -> Message {
        let now = live.now;
        let (findings, snapshot) = (live.monitor.doctor(now), live.monitor.snapshot(now));
        let state = State {
            segment: self.number,
            now_ns: now.since_epoch().as_ticks(),
            trouble: live.trouble.as_deref(),
            snapshot: &snapshot,
            findings: &findings,
        };
        Message::new("state", &state, 0)
    }
}

fn micros(at: Instant) -> f64 {
    at.since_epoch().as_ticks() as f64 / 1e3
}

/// So many frames of a segment are told at once: more than a tenth of a second of a full bus at 1 Mbit/s.
pub const MOST_FRAMES: usize = 2_048;
/// How often a segment is told the time.
const TICK: Duration = Duration::from_millis(100);
