//! What was on the wire: the trace of the bus, boiled down to attempts.

use cosmic_bus::trace::{BusError, TraceEvent, TraceKind};
use cosmic_bus::{ErrorLevel, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::{Frame, Id, Priority};

/// One attempt to send a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Attempt {
    /// Counts all attempts on the bus, from 0.
    pub number: u64,
    /// Who sent.
    pub station: StationId,
    /// What.
    pub wire_frame: WireFrame,
    /// 1 for the first transmission, more for retransmissions.
    pub attempt: u32,
    /// The start of frame.
    pub start: VirtualInstant,
    /// The end of the end of frame, or the detection of the error.
    pub end: VirtualInstant,
    /// How it ended.
    pub ending: Ending,
    /// When its frame was put into the mailbox: an index into [`BusLog::loads`].
    pub load: Option<usize>,
}

/// How an attempt ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Ending {
    /// It is still on the wire.
    Open,
    /// It was sent and acknowledged.
    Sent,
    /// It was destroyed.
    Failed(BusError),
}

impl Attempt {
    /// The frame; `None` if it is none of COSMIC.
    pub fn frame(&self) -> Option<Frame> {
        Frame::try_from(self.wire_frame).ok()
    }

    /// Returns whether it was destroyed.
    pub const fn has_failed(&self) -> bool {
        matches!(self.ending, Ending::Failed(_))
    }
}

/// A frame that stood in a mailbox when another won the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Contest {
    /// Who won: an index into [`BusLog::attempts`].
    pub winner: usize,
    /// Whose frame did not: an index into [`BusLog::loads`].
    pub loser: usize,
}

/// A frame was put into a mailbox.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Load {
    /// When.
    pub at: VirtualInstant,
    /// Whose.
    pub station: StationId,
    /// The frame.
    pub frame: Frame,
}

/// What was on the wire, and what waited for it.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct BusLog {
    attempts: Vec<Attempt>,
    contests: Vec<Contest>,
    loads: Vec<Load>,
    levels: Vec<LevelChange>,
    pending: Vec<Pending>,
}

/// The error level of a station changed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct LevelChange {
    at: VirtualInstant,
    station: StationId,
    level: ErrorLevel,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Pending {
    station: StationId,
    mailbox: usize,
    frame: WireFrame,
    /// It leaves the mailbox if it fails.
    withdrawn: bool,
    /// An index into the loads.
    load: Option<usize>,
}

impl BusLog {
    /// All attempts, in the order of time.
    pub fn attempts(&self) -> &[Attempt] {
        &self.attempts
    }

    /// Soft real-time frames that lost against soft real-time frames, in the order of time.
    pub fn contests(&self) -> &[Contest] {
        &self.contests
    }

    /// COSMIC's frames that were put into mailboxes, in the order of time.
    pub fn loads(&self) -> &[Load] {
        &self.loads
    }

    /// When a station went bus-off.
    pub fn bus_offs(&self, station: StationId) -> impl Iterator<Item = VirtualInstant> {
        let changes = self.levels.iter().filter(move |it| it.station == station);
        changes.filter(|it| it.level == ErrorLevel::BusOff).map(|it| it.at)
    }

    /// Returns whether a station was bus-off at some time from `from` to `until`.
    pub fn was_off(&self, station: StationId, from: VirtualInstant, until: VirtualInstant) -> bool {
        let changes = || self.levels.iter().filter(|it| it.station == station);
        let before = changes().take_while(|it| it.at <= from).last();
        let off = |it: &LevelChange| it.level == ErrorLevel::BusOff;
        before.is_some_and(off) || changes().any(|it| off(it) && it.at > from && it.at <= until)
    }

    /// Takes in what the bus has recorded.
    pub fn take(&mut self, event: &TraceEvent) {
        let at = event.at;
        match &event.kind {
            TraceKind::Load { station, mailbox, frame } => {
                let cosmic = Frame::try_from(*frame).ok();
                let load = cosmic.is_some().then_some(self.loads.len());
                self.loads.extend(cosmic.map(|frame| Load { at, station: *station, frame }));
                let (station, mailbox, frame) = (*station, *mailbox, *frame);
                self.pending.push(Pending { station, mailbox, frame, withdrawn: false, load });
            }
            TraceKind::Withdraw { station, mailbox, on_the_wire } => {
                self.withdraw(*station, *mailbox, *on_the_wire);
            }
            TraceKind::FrameStart { number, station, mailbox, frame, attempt, .. } => {
                self.contend(*station, *mailbox, frame);
                self.attempts.push(Attempt {
                    number: *number,
                    station: *station,
                    wire_frame: *frame,
                    attempt: *attempt,
                    start: at,
                    end: at,
                    ending: Ending::Open,
                    load: self.load_of(*station, *mailbox),
                });
            }
            TraceKind::FrameEnd { number, station, frame, .. } => {
                self.end(*number, at, Ending::Sent);
                self.pending.retain(|pending| (pending.station, pending.frame) != (*station, *frame));
            }
            TraceKind::Error(error) => {
                self.end(error.number, at, Ending::Failed(*error));
                self.pending.retain(|pending| pending.station != error.station || !pending.withdrawn);
            }
            TraceKind::Reset { station } => {
                self.pending.retain(|pending| pending.station != *station);
                self.levels.push(LevelChange { at, station: *station, level: ErrorLevel::Active });
            }
            TraceKind::ErrorState { station, state } => {
                self.levels.push(LevelChange { at, station: *station, level: state.level() });
            }
            TraceKind::Omission { .. } | TraceKind::Connection { .. } => {}
        }
    }

    fn load_of(&self, station: StationId, mailbox: usize) -> Option<usize> {
        self.pending.iter().rev().find(|it| (it.station, it.mailbox) == (station, mailbox))?.load
    }

    fn withdraw(&mut self, station: StationId, mailbox: usize, on_the_wire: bool) {
        // Behind an error the frame counts as on the wire until the error frame is over, and is dropped then.
        let has_failed = self.attempts.last().is_some_and(|it| it.station == station && it.has_failed());
        if on_the_wire && !has_failed {
            let place = self.pending.iter_mut().find(|it| (it.station, it.mailbox) == (station, mailbox));
            if let Some(pending) = place {
                pending.withdrawn = true;
            }
        } else {
            self.pending.retain(|it| (it.station, it.mailbox) != (station, mailbox));
        }
    }

    fn contend(&mut self, station: StationId, mailbox: usize, winner: &WireFrame) {
        if !real_time(winner).is_some_and(|frame| is_soft(frame.id)) {
            return;
        }
        let winner = self.attempts.len();
        let others = self.pending.iter().filter(|it| (it.station, it.mailbox) != (station, mailbox));
        let others = others.filter(|it| self.competes(it.station));
        let losers = others.filter(|it| real_time(&it.frame).is_some_and(|frame| is_soft(frame.id)));
        let contests: Vec<_> =
            losers.filter_map(|it| it.load).map(|loser| Contest { winner, loser }).collect();
        self.contests.extend(contests);
    }

    /// A station that is error passive pauses behind its own attempts (ISO 11898-1, suspend transmission).
    fn competes(&self, station: StationId) -> bool {
        let change = self.levels.iter().rev().find(|it| it.station == station);
        match change.map_or(ErrorLevel::Active, |change| change.level) {
            ErrorLevel::Active | ErrorLevel::Warning => true,
            ErrorLevel::Passive => self.attempts.last().is_none_or(|attempt| attempt.station != station),
            ErrorLevel::BusOff => false,
        }
    }

    fn end(&mut self, number: u64, at: VirtualInstant, ending: Ending) {
        if let Some(attempt) = self.attempts.last_mut().filter(|attempt| attempt.number == number) {
            attempt.end = at;
            attempt.ending = ending;
        }
    }
}

fn real_time(frame: &WireFrame) -> Option<Frame> {
    let frame = Frame::try_from(*frame).ok()?;
    (frame.id.priority() <= Priority::SOFT_LEAST_URGENT).then_some(frame)
}

/// Returns whether the frame carries a soft real-time event.
pub fn is_soft(id: Id) -> bool {
    let soft = Priority::SOFT_MOST_URGENT..=Priority::SOFT_LEAST_URGENT;
    soft.contains(&id.priority()) && !id.etag().is_reserved()
}
