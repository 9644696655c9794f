//! The bus: commands, and the advance of virtual time.
//!
//! At any instant the bus is free, or a frame is on the wire whose whole course is known
//! ([`crate::course`]). Commands do not change the course of a frame that has started; what they load
//! takes part in the next arbitration. Therefore the bus can say how long nothing will be heard of it
//! ([`Bus::quiet_until`]), which a simulation of many processors uses to run each of them that far on its
//! own.

mod join;
mod recovery;
mod settle;
mod wire;

use crate::accounting::Accounting;
use crate::bits::{ERROR_DELIMITER_BITS, FLAG_BITS};
use crate::confinement::{BusOffRecovery, ErrorState, INTEGRATION_BITS};
use crate::event::{Event, EventKind, StationId};
use crate::fault::FaultModel;
use crate::filter::Filters;
use crate::frame::WireFrame;
use crate::station::{LoadError, Loaded, MAILBOXES, Station};
use crate::time::{EPOCH, VirtualInstant};
use crate::trace::{TraceEvent, TraceKind};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;
use recovery::Recovering;
use wire::{Contender, Sender, Transmission};

/// A CAN bus and the controllers on it.
///
/// Three kinds of method:
///
/// * *Commands* ([`load`](Self::load), [`withdraw`](Self::withdraw), [`disconnect`](Self::disconnect), …)
///   take the instant at which they are given. Instants must not decrease from one call to the next; one
///   that lies before [`now`](Self::now) counts as now. A frame loaded at the very instant at which another
///   starts takes part in the arbitration with it; one loaded during a frame or the intermission behind it
///   takes part in the arbitration at the end of the intermission.
/// * *Queries* ([`next_event`](Self::next_event), [`quiet_until`](Self::quiet_until),
///   [`error_state`](Self::error_state), …) change nothing.
/// * [`advance`](Self::advance) lets time pass and reports events.
///
/// Errors take effect on counters, and are reported to the stations, when their error frame is over.
///
/// A [`StationId`] belongs to the bus that gave it out.
///
/// # Panics
/// Methods that take a [`StationId`] panic if it is of another bus with more stations.
#[derive(Debug)]
pub struct Bus {
    bit_rate: BitRate,
    now: VirtualInstant,
    faults: FaultModel,
    names: Vec<String>,
    stations: Vec<Station>,
    /// What each station would send next, apart from the rest of it because each arbitration looks at all.
    contenders: Vec<Contender>,
    on_the_wire: Option<Transmission>,
    /// The end of the last intermission.
    free_from: VirtualInstant,
    /// If the bus is free and somebody wants to send: when the next frame starts.
    next_start: Option<VirtualInstant>,
    recovering: Vec<Recovering>,
    /// Attempts so far.
    attempts: u64,
    /// Events of the past that `advance` has not yet handed out.
    outbox: Vec<Event>,
    accounting: Accounting,
    trace: Option<Vec<TraceEvent>>,
    /// The list of senders of the last frame, kept for its memory.
    spare_senders: Vec<Sender>,
}

impl Bus {
    /// A bus without stations.
    pub fn new(bit_rate: BitRate, faults: FaultModel) -> Self {
        Self {
            bit_rate,
            now: EPOCH,
            faults,
            names: Vec::new(),
            stations: Vec::new(),
            contenders: Vec::new(),
            on_the_wire: None,
            free_from: EPOCH,
            next_start: None,
            recovering: Vec::new(),
            attempts: 0,
            outbox: Vec::new(),
            accounting: Accounting::default(),
            trace: None,
            spare_senders: Vec::new(),
        }
    }

    /// Attaches a station: connected, error active, mailboxes empty, accepting all frames.
    pub fn attach(&mut self, name: impl Into<String>) -> StationId {
        let id = StationId(self.stations.len() as u32);
        self.names.push(name.into());
        self.stations.push(Station::new(self.now));
        self.contenders.push(Contender::NONE);
        id
    }

    /// The stations, in the order of attachment.
    pub fn stations(&self) -> impl Iterator<Item = StationId> + use<> {
        (0..self.stations.len() as u32).map(StationId)
    }

    /// The name of a station.
    pub fn name(&self, station: StationId) -> &str {
        &self.names[station.index()]
    }

    /// The bit rate.
    pub const fn bit_rate(&self) -> BitRate {
        self.bit_rate
    }

    /// The instant up to which the bus has advanced: that of the last command or advance.
    pub const fn now(&self) -> VirtualInstant {
        self.now
    }

    /// What the bus was busy with so far; a frame counts when it is over.
    pub const fn accounting(&self) -> &Accounting {
        &self.accounting
    }

    /// The error counters of a station.
    pub fn error_state(&self, station: StationId) -> ErrorState {
        self.stations[station.index()].errors
    }

    /// The faults to come, for example to add a rule. A frame on the wire has met its fate already; a rule
    /// may shorten [`quiet_until`](Self::quiet_until).
    pub const fn faults_mut(&mut self) -> &mut FaultModel {
        &mut self.faults
    }

    /// Sets the acceptance filters of a station. Frames that pass none are not reported to it; they are
    /// acknowledged nevertheless. In force from the next acceptance on.
    pub fn set_filters(&mut self, station: StationId, filters: Filters) {
        self.stations[station.index()].filters = filters;
    }

    /// Sets what a station does the next time it goes bus-off.
    pub fn set_bus_off_recovery(&mut self, station: StationId, recovery: BusOffRecovery) {
        self.stations[station.index()].recovery = recovery;
    }

    /// Loads a frame into a transmit mailbox and requests its transmission.
    ///
    /// # Errors
    /// [`LoadError`] if the mailbox still holds a frame, or does not exist.
    pub fn load(
        &mut self,
        at: VirtualInstant,
        station: StationId,
        mailbox: usize,
        frame: WireFrame,
    ) -> Result<(), LoadError> {
        self.run(at);
        let slot = self.stations[station.index()].mailboxes.get_mut(mailbox);
        let slot = slot.ok_or(LoadError::NoSuchMailbox)?;
        if slot.is_some() {
            return Err(LoadError::Occupied);
        }
        let bits = frame.bit_count();
        *slot = Some(Loaded { frame, bits, failures: 0, withdrawal_requested: false });
        self.record(self.now, || TraceKind::Load { station, mailbox, frame });
        self.consider(station);
        Ok(())
    }

    /// Requests the withdrawal of a frame (RM0090, bxCAN transmission handling: ABRQ). A pending frame is
    /// withdrawn at once; one that is on the wire completes, or is dropped if it fails. An empty mailbox, or
    /// one that does not exist, is left alone.
    pub fn withdraw(&mut self, at: VirtualInstant, station: StationId, mailbox: usize) {
        self.run(at);
        let on_the_wire = self.is_on_the_wire(station, mailbox);
        let Some(slot) = self.stations[station.index()].mailboxes.get_mut(mailbox) else { return };
        let Some(loaded) = slot else { return };
        loaded.withdrawal_requested = true;
        if !on_the_wire {
            *slot = None;
        }
        self.record(self.now, || TraceKind::Withdraw { station, mailbox, on_the_wire });
        if !on_the_wire {
            self.report(self.now, station, EventKind::Withdrawn { mailbox });
            self.reconsider(station);
        }
    }

    /// Connects a station that was disconnected. It takes part once it has seen 11 recessive bits.
    pub fn connect(&mut self, at: VirtualInstant, station: StationId) {
        self.run(at);
        let now = self.now;
        let integrated = now + self.bits(INTEGRATION_BITS);
        let state = &mut self.stations[station.index()];
        if core::mem::replace(&mut state.is_connected, true) {
            return;
        }
        self.record(now, || TraceKind::Connection { station, connected: true });
        self.take_part_or_recover(station, integrated);
    }

    /// Disconnects a station from the wire: it neither sends, receives nor acknowledges. Its mailboxes and
    /// error counters stay as they are. A frame that it is sending breaks off, which the others see as an
    /// error, unless only the acknowledgement and the end of frame are left.
    pub fn disconnect(&mut self, at: VirtualInstant, station: StationId) {
        self.run(at);
        let state = &mut self.stations[station.index()];
        if !core::mem::replace(&mut state.is_connected, false) {
            return;
        }
        state.silence();
        self.recovering.retain(|recovering| recovering.station != station);
        self.record(self.now, || TraceKind::Connection { station, connected: false });
        self.reconsider(station);
        self.lose(station);
    }

    /// Resets a station's controller: mailboxes are emptied without an event, error counters cleared. It
    /// takes part again once it has seen 11 recessive bits, if it is connected. Filters stay.
    pub fn reset(&mut self, at: VirtualInstant, station: StationId) {
        self.run(at);
        let integrated = self.now + self.bits(INTEGRATION_BITS);
        let state = &mut self.stations[station.index()];
        state.silence();
        state.errors = ErrorState::NEW;
        self.recovering.retain(|recovering| recovering.station != station);
        self.record(self.now, || TraceKind::Reset { station });
        self.lose(station);
        let state = &mut self.stations[station.index()];
        state.mailboxes = [const { None }; MAILBOXES];
        if state.is_connected {
            state.take_part_from(integrated);
        }
        self.reconsider(station);
    }

    /// Starts the recovery of a station that is bus-off with [`BusOffRecovery::OnRequest`]: it takes part
    /// again after 128 sequences of 11 recessive bits. Otherwise nothing happens.
    pub fn request_recovery(&mut self, at: VirtualInstant, station: StationId) {
        self.run(at);
        self.recover(station, self.now);
    }

    /// The earliest instant at which an event can be reported if no further command is given; `None` if
    /// none ever will be.
    ///
    /// It is exact while a frame is on the wire. Before a frame starts it is a lower bound: an advance to
    /// it may report nothing, and then tells the next one.
    pub fn next_event(&self) -> Option<VirtualInstant> {
        if let Some(event) = self.outbox.first() {
            return Some(event.at);
        }
        if let Some(transmission) = &self.on_the_wire {
            return Some(transmission.next_event());
        }
        let by_frame = self.next_start.map(|start| start + self.lookahead());
        by_frame.into_iter().chain(self.next_recovery()).min()
    }

    /// The earliest instant at which an event can be reported whatever frames are loaded from now on.
    ///
    /// During a frame that is its acceptance or failure. On a free bus it is 30 bits or more from now, less
    /// only if the next frame will be hit by a fault: no frame is over sooner, and the error frame of the
    /// earliest collision (standard frames with the same identifier and different lengths) ends there.
    ///
    /// Other commands act at once, and who gives one stops at its instant: `withdraw` may report
    /// `Withdrawn` to its own station then, but nothing else sooner; `disconnect` and `reset` of a sender,
    /// and a new fault rule, may bring other events forward.
    pub fn quiet_until(&self) -> VirtualInstant {
        if let Some(event) = self.outbox.first() {
            return event.at;
        }
        if let Some(transmission) = &self.on_the_wire {
            return transmission.next_event();
        }
        let earliest = self.now.max(self.free_from) + self.lookahead();
        self.next_recovery().map_or(earliest, |recovery| recovery.min(earliest))
    }

    /// Lets time pass until `to`, inclusive, and appends the events that were not yet reported, in the order
    /// of time. An empty list is exchanged for the bus's own, so one that is used again costs no allocation.
    ///
    /// A frame that starts at `to` has not started yet, for commands given at `to` still take part.
    ///
    /// Work: proportional to the frames that end until `to`, times the stations.
    pub fn advance(&mut self, to: VirtualInstant, events: &mut Vec<Event>) {
        self.run(to);
        if events.is_empty() {
            core::mem::swap(events, &mut self.outbox);
        } else {
            events.append(&mut self.outbox);
        }
    }

    /// Starts or stops the recording of a trace.
    pub fn record_trace(&mut self, on: bool) {
        self.trace = if on { Some(self.trace.take().unwrap_or_default()) } else { None };
    }

    /// Moves what was recorded since the last call to the end of `into`.
    pub fn take_trace(&mut self, into: &mut Vec<TraceEvent>) {
        if let Some(trace) = &mut self.trace {
            into.append(trace);
        }
    }

    /// Does everything that happens until `to`.
    fn run(&mut self, to: VirtualInstant) {
        while let Some(next) = self.next_step().filter(|next| *next <= to) {
            self.now = self.now.max(next);
            self.step(next);
        }
        self.now = self.now.max(to);
    }

    /// Bits from the start of a frame until the first event that it can cause.
    fn lookahead(&self) -> Duration {
        let by_fault = self.faults.earliest_bit().map(|bit| bit + 1 + FLAG_BITS + ERROR_DELIMITER_BITS);
        self.bits(by_fault.unwrap_or(EARLIEST_EVENT_BITS).min(EARLIEST_EVENT_BITS))
    }

    const fn bits(&self, count: u32) -> Duration {
        self.bit_rate.bits(count)
    }

    fn report(&mut self, at: VirtualInstant, station: StationId, kind: EventKind) {
        self.outbox.push(Event { at, station, kind });
    }

    fn record(&mut self, at: VirtualInstant, kind: impl FnOnce() -> TraceKind) {
        if let Some(trace) = &mut self.trace {
            trace.push(TraceEvent { at, kind: kind() });
        }
    }

    /// Changes the error counters of a station and reports if that changes its level.
    fn count(&mut self, at: VirtualInstant, station: StationId, change: impl FnOnce(&mut ErrorState)) {
        let errors = &mut self.stations[station.index()].errors;
        let before = errors.level();
        change(errors);
        let state = *errors;
        if state.level() != before {
            self.record(at, || TraceKind::ErrorState { station, state });
            self.report(at, station, EventKind::ErrorState(state));
        }
    }
}

/// Bits from start of frame to the end of the earliest error frame without an injected fault: two standard
/// data frames with the same identifier differ in bit 15 at the earliest, the first of the data length
/// code; a flag and the delimiter follow. Every frame is longer.
const EARLIEST_EVENT_BITS: u32 = 16 + FLAG_BITS + ERROR_DELIMITER_BITS;
