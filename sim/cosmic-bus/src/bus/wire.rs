//! A frame on the wire: arbitration, and the steps of its course.

use super::Bus;
use crate::bits::{ERROR_DELIMITER_BITS, INTERMISSION_BITS, SUSPEND_BITS};
use crate::confinement::{ErrorLevel, ErrorState};
use crate::course::{Course, Disturbance, Milestone, SenderCounts};
use crate::event::{ErrorCause, Event, EventKind, StationId};
use crate::fault::Transmitter;
use crate::frame::WireFrame;
use crate::time::{FAR_FUTURE, VirtualInstant};
use crate::trace::{BusError, TraceKind};
use cosmic_core::can::BitRate;
use fugit::NanosDurationU64;

/// What a station would send next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contender {
    /// The arbitration field, or more than 32 bits if there is nothing to send.
    rank: u64,
    /// From here on it may start.
    from: VirtualInstant,
}

impl Contender {
    pub(super) const NONE: Self = Self { rank: u64::MAX, from: FAR_FUTURE };
}

/// One of the stations that send the frame on the wire.
#[derive(Debug)]
pub(super) struct Sender {
    pub(super) station: StationId,
    pub(super) mailbox: usize,
    /// It is error passive and found that another sends the same identifier with other contents: it has
    /// given up, and disturbs nobody.
    pub(super) has_given_up: bool,
}

/// The frame on the wire.
#[derive(Debug)]
pub(super) struct Transmission {
    pub(super) number: u64,
    pub(super) start: VirtualInstant,
    bit_rate: BitRate,
    pub(super) frame: WireFrame,
    pub(super) bits: u32,
    /// The station of the trace: the first sender.
    pub(super) station: StationId,
    /// Stations that send this frame: one, or more if they send the same; none if it was disconnected.
    pub(super) senders: Vec<Sender>,
    /// Receivers that see an error in the last but one bit.
    victims: Vec<StationId>,
    pub(super) course: Course,
    pub(super) next_step: usize,
}

impl Transmission {
    pub(super) fn new(
        number: u64,
        start: VirtualInstant,
        bit_rate: BitRate,
        (station, frame, bits): (StationId, WireFrame, u32),
        senders: Vec<Sender>,
        victims: Vec<StationId>,
        course: Course,
    ) -> Self {
        Self { number, start, bit_rate, frame, bits, station, senders, victims, course, next_step: 0 }
    }

    fn instant(&self, offset: u32) -> VirtualInstant {
        self.start + self.bit_rate.bits(offset)
    }

    fn upcoming(&self) -> impl Iterator<Item = (u32, Milestone)> + '_ {
        self.course.steps.iter().skip(self.next_step).flatten().copied()
    }

    /// The next step, and when.
    fn next_step(&self) -> Option<(VirtualInstant, Milestone)> {
        self.upcoming().next().map(|(offset, step)| (self.instant(offset), step))
    }

    /// The next step that stations hear of.
    pub(super) fn next_event(&self) -> VirtualInstant {
        let step = self.upcoming().find(|(_, step)| *step != Milestone::Disturb);
        step.map_or(FAR_FUTURE, |(offset, _)| self.instant(offset))
    }

    fn is_sent_by(&self, station: StationId) -> bool {
        self.senders.iter().any(|sender| sender.station == station)
    }
}

impl Bus {
    /// When the next step is due: of the frame on the wire, of a recovery, or the start of a frame.
    pub(super) fn next_step(&self) -> Option<VirtualInstant> {
        if let Some(transmission) = &self.on_the_wire {
            return transmission.next_step().map(|(at, _)| at);
        }
        // A frame is settled just after its start: until then commands of that instant take part.
        let start = self.next_start.map(|start| start + JUST_AFTER);
        start.into_iter().chain(self.next_recovery()).min()
    }

    /// Does the step that is due at `at`.
    pub(super) fn step(&mut self, at: VirtualInstant) {
        if let Some(mut transmission) = self.on_the_wire.take() {
            if let Some((_, step)) = transmission.next_step() {
                transmission.next_step += 1;
                match step {
                    Milestone::Accept => self.accept(at, &transmission),
                    Milestone::Disturb => self.disturb(at, &transmission),
                    Milestone::Complete => self.complete(at, &transmission),
                    Milestone::Fail => self.fail(at, &transmission),
                }
            }
            if transmission.upcoming().next().is_some() {
                self.on_the_wire = Some(transmission);
            } else {
                self.finish(transmission);
            }
        } else if self.next_recovery().is_some_and(|recovery| recovery <= at) {
            self.end_recoveries(at);
        } else if let Some(start) = self.next_start.take() {
            self.start(start);
        }
    }

    pub(super) fn is_on_the_wire(&self, station: StationId, mailbox: usize) -> bool {
        self.on_the_wire.as_ref().is_some_and(|transmission| {
            transmission.senders.iter().any(|it| it.station == station && it.mailbox == mailbox)
        })
    }

    /// A station has one frame more: it can only make the next start earlier.
    pub(super) fn consider(&mut self, station: StationId) {
        let contender = self.contender(station);
        self.contenders[station.index()] = contender;
        if self.on_the_wire.is_none() && contender.from < FAR_FUTURE {
            let start = contender.from.max(self.free_from).max(self.now);
            self.next_start = Some(self.next_start.map_or(start, |next| next.min(start)));
        }
    }

    /// The mailboxes of a station, or its right to send, have changed. Looks at all stations.
    pub(super) fn reconsider(&mut self, station: StationId) {
        self.contenders[station.index()] = self.contender(station);
        self.reconsider_start();
    }

    fn contender(&self, station: StationId) -> Contender {
        let state = &self.stations[station.index()];
        let first = state.first_mailbox();
        first.map_or(Contender::NONE, |(arbitration, _)| Contender {
            rank: u64::from(arbitration.raw()),
            from: state.sends_from,
        })
    }

    /// When the next frame starts, if nothing is on the wire.
    fn reconsider_start(&mut self) {
        if self.on_the_wire.is_some() {
            return;
        }
        let earliest = self.contenders.iter().map(|contender| contender.from).min();
        let earliest = earliest.filter(|from| *from < FAR_FUTURE);
        self.next_start = earliest.map(|from| from.max(self.free_from).max(self.now));
    }

    /// Arbitration: of the stations that start now, the smallest arbitration field goes on.
    fn start(&mut self, start: VirtualInstant) {
        self.interrupt_recoveries(start);
        let mut senders = core::mem::take(&mut self.spare_senders);
        let (mut best, mut contenders) = (u64::MAX, 0);
        for (at, contender) in self.contenders.iter().enumerate() {
            if contender.from > start {
                continue;
            }
            contenders += 1;
            if contender.rank < best {
                best = contender.rank;
                senders.clear();
            }
            if contender.rank == best {
                let mailbox = NOT_YET_KNOWN;
                senders.push(Sender { station: StationId(at as u32), mailbox, has_given_up: false });
            }
        }
        for sender in &mut senders {
            let first = self.stations[sender.station.index()].first_mailbox();
            sender.mailbox = first.map_or(NOT_YET_KNOWN, |(_, mailbox)| mailbox);
        }
        let Some(transmission) = self.settle(start, senders) else { return };
        let (number, station, frame) = (transmission.number, transmission.station, transmission.frame);
        if self.trace.is_some() {
            let mailbox = transmission.senders.iter().find(|it| it.station == station);
            let mailbox = mailbox.map_or(0, |sender| sender.mailbox);
            let loaded = self.stations[station.index()].mailboxes[mailbox].as_ref();
            let attempt = loaded.map_or(0, |loaded| loaded.failures) + 1;
            self.record(start, || TraceKind::FrameStart {
                number,
                station,
                mailbox,
                frame,
                attempt,
                contenders,
            });
        }
        self.on_the_wire = Some(transmission);
    }

    /// The receivers of a frame that started at `start`.
    pub(super) fn receivers<'a>(
        &'a self,
        start: VirtualInstant,
        senders: &'a [Sender],
    ) -> impl Iterator<Item = StationId> + 'a {
        let listening = self.stations.iter().enumerate().filter(move |(_, it)| it.listens_from <= start);
        let listening = listening.map(|(at, _)| StationId(at as u32));
        listening.filter(|station| senders.iter().all(|sender| sender.station != *station))
    }

    fn accept(&mut self, at: VirtualInstant, transmission: &Transmission) {
        let is_own = |it: usize| transmission.senders.iter().any(|sender| sender.station.index() == it);
        for index in 0..self.stations.len() {
            let state = &self.stations[index];
            if state.listens_from > transmission.start || is_own(index) {
                continue;
            }
            let station = StationId(index as u32);
            if transmission.victims.contains(&station) {
                self.reject(at, station);
                continue;
            }
            if state.filters.accept(&transmission.frame) {
                self.outbox.push(Event { at, station, kind: EventKind::Received(transmission.frame) });
            }
            if state.errors.receive_errors > 0 {
                self.count(at, station, ErrorState::received);
            }
        }
        if !transmission.victims.is_empty() {
            let victims = transmission.victims.clone();
            let seen = transmission.course.disturbance.is_some();
            self.record(at, || TraceKind::Omission {
                number: transmission.number,
                victims,
                transmitter: if seen { Transmitter::Retransmits } else { Transmitter::Accepts },
            });
        }
    }

    /// A victim of an inconsistent omission. Its flag is answered by those of the others, so it finds the bus
    /// dominant behind it; unless it is error passive, for then nobody sees its flag.
    fn reject(&mut self, at: VirtualInstant, station: StationId) {
        self.count(at, station, |errors| {
            let is_active = errors.is_error_active();
            errors.receive_error();
            if is_active {
                errors.first_to_see_receive_error();
            }
        });
    }

    fn disturb(&mut self, at: VirtualInstant, transmission: &Transmission) {
        if let Some(Disturbance { bit, field, cause, origin, .. }) = transmission.course.disturbance {
            let (number, station) = (transmission.number, transmission.station);
            self.record(at, || TraceKind::Error(BusError { number, station, bit, field, cause, origin }));
        }
    }

    fn complete(&mut self, at: VirtualInstant, transmission: &Transmission) {
        let frame_bits = transmission.bits + INTERMISSION_BITS;
        self.accounting.complete(&transmission.frame, frame_bits);
        // Overload flags that the transmitter's intermission was broken by.
        self.accounting.error_bits += u64::from(transmission.course.free - frame_bits);
        self.record(at, || TraceKind::FrameEnd {
            number: transmission.number,
            station: transmission.station,
            frame: transmission.frame,
            bits: transmission.bits,
        });
        for sender in &transmission.senders {
            if sender.has_given_up {
                self.fail_sender(at, sender, ErrorCause::Bit, SenderCounts::Transmit);
                continue;
            }
            let mailbox = sender.mailbox;
            if let Some(sent) = self.stations[sender.station.index()].mailboxes[mailbox].take() {
                self.accounting.sent_after(sent.failures);
            }
            self.report(at, sender.station, EventKind::Sent { mailbox });
            self.count(at, sender.station, ErrorState::sent);
        }
    }

    fn fail(&mut self, at: VirtualInstant, transmission: &Transmission) {
        self.accounting.failed_attempts += 1;
        self.accounting.error_bits += u64::from(transmission.course.free);
        let Some(disturbance) = transmission.course.disturbance else { return };
        for sender in &transmission.senders {
            let counts = if sender.has_given_up { SenderCounts::Transmit } else { disturbance.sender_counts };
            self.fail_sender(at, sender, disturbance.cause, counts);
        }
        if disturbance.receivers_count {
            for index in 0..self.stations.len() {
                let station = StationId(index as u32);
                if self.stations[index].listens_from <= transmission.start
                    && !transmission.is_sent_by(station)
                {
                    self.count(at, station, ErrorState::receive_error);
                }
            }
        }
    }

    fn fail_sender(&mut self, at: VirtualInstant, sender: &Sender, cause: ErrorCause, counts: SenderCounts) {
        let (station, mailbox) = (sender.station, sender.mailbox);
        self.report(at, station, EventKind::Failed { mailbox, cause });
        let slot = &mut self.stations[station.index()].mailboxes[mailbox];
        if let Some(loaded) = slot {
            loaded.failures += 1;
            if loaded.withdrawal_requested {
                *slot = None;
                self.report(at, station, EventKind::Withdrawn { mailbox });
            }
        }
        match counts {
            SenderCounts::Transmit => self.count(at, station, ErrorState::transmit_error),
            SenderCounts::Receive => self.count(at, station, ErrorState::receive_error),
            SenderCounts::Nothing => {}
        }
        if self.error_state(station).level() == ErrorLevel::BusOff {
            let delimiter = self.bits(ERROR_DELIMITER_BITS);
            // It has seen the delimiter already.
            let since = at.checked_sub_duration(delimiter).unwrap_or(at);
            self.enter_bus_off(station, since);
        }
    }

    /// The frame is over; intermission begins.
    fn finish(&mut self, mut transmission: Transmission) {
        self.free_from = transmission.instant(transmission.course.free);
        self.continue_recoveries();
        let mut senders = core::mem::take(&mut transmission.senders);
        for Sender { station, .. } in &senders {
            let state = &mut self.stations[station.index()];
            if state.sends_from <= transmission.start && state.errors.level() == ErrorLevel::Passive {
                state.sends_from = self.free_from + self.bit_rate.bits(SUSPEND_BITS);
            }
            self.contenders[station.index()] = self.contender(*station);
        }
        senders.clear();
        self.spare_senders = senders;
        self.reconsider_start();
    }
}

/// The mailbox of a sender until it has been looked up.
const NOT_YET_KNOWN: usize = 0;

/// The smallest step of virtual time.
const JUST_AFTER: NanosDurationU64 = NanosDurationU64::from_ticks(1);
