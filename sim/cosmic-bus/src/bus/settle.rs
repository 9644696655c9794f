//! What will become of a frame, settled at its start: collision, fault, acknowledgement; and again when a
//! station is lost in the middle of it.

use super::Bus;
use super::wire::{Sender, Transmission};
use crate::bits::{FLAG_BITS, Field, Level, RUN, TAIL_BITS, WireBits};
use crate::course::{self, Course, Disturbance, Parties, SenderCounts};
use crate::event::{ErrorCause, StationId};
use crate::fault::{Decision, Fault, Transmitter};
use crate::frame::WireFrame;
use crate::time::VirtualInstant;
use crate::trace::Origin;

impl Bus {
    /// Settles the course of the frame of these senders, whose arbitration fields are equal.
    pub(super) fn settle(&mut self, start: VirtualInstant, mut senders: Vec<Sender>) -> Option<Transmission> {
        let number = self.attempts;
        self.attempts += 1;
        let (station, frame, bits) = self.first_of(&senders)?;
        let decision = self.faults.decide(&frame);
        let inverted = decision.as_ref().and_then(|decision| match decision.fault {
            Fault::Inverted(position) => Some(decision.bit(position, bits)),
            Fault::InconsistentOmission { .. } => None,
        });
        let collision = if senders.len() > 1 { self.collide(start, &mut senders, inverted) } else { None };
        // Those that have given up leave the frame to others.
        let (station, frame, bits) = self.first_of(&senders).unwrap_or((station, frame, bits));
        let mut victims = Vec::new();
        let course = match (collision, inverted) {
            (Some(course), _) => course,
            (None, Some(bit)) => {
                self.accounting.inverted += 1;
                let bit = bit.min(bits - 1);
                course::inverted(&frame.wire_bits(), bit, self.parties(start, &senders))
            }
            (None, None) if self.receivers(start, &senders).next().is_none() => {
                Course::unacknowledged(bits, self.is_any_active(&senders))
            }
            (None, None) => match decision {
                Some(decision) => self.omit(start, &senders, bits, &decision, &mut victims),
                None => Course::undisturbed(bits),
            },
        };
        Some(Transmission::new(
            number,
            start,
            self.bit_rate,
            (station, frame, bits),
            senders,
            victims,
            course,
        ))
    }

    /// The first sender that has not given up, its frame and the length of that.
    fn first_of(&self, senders: &[Sender]) -> Option<(StationId, WireFrame, u32)> {
        let sender = senders.iter().find(|sender| !sender.has_given_up)?;
        let loaded = self.loaded(sender)?;
        Some((sender.station, loaded.0, loaded.1))
    }

    fn loaded(&self, sender: &Sender) -> Option<(WireFrame, u32)> {
        let loaded = self.stations[sender.station.index()].mailboxes[sender.mailbox].as_ref()?;
        Some((loaded.frame, loaded.bits))
    }

    fn is_any_active(&self, senders: &[Sender]) -> bool {
        senders.iter().any(|it| !it.has_given_up && self.error_state(it.station).is_error_active())
    }

    fn parties(&self, start: VirtualInstant, senders: &[Sender]) -> Parties {
        Parties {
            active_sender: self.is_any_active(senders),
            receiver: self.receivers(start, senders).next().is_some(),
            active_receiver: self
                .receivers(start, senders)
                .any(|station| self.error_state(station).is_error_active()),
        }
    }

    /// Several stations send the same identifier. Where their frames differ, who sends recessive sees a bit
    /// error. If it is error active it destroys the frame for all; if it is error passive it gives up.
    /// `None` if the rest sends one and the same frame, or if bit `inverted` comes first.
    fn collide(
        &self,
        start: VirtualInstant,
        senders: &mut [Sender],
        inverted: Option<u32>,
    ) -> Option<Course> {
        loop {
            let sending: Vec<(usize, WireBits)> = senders
                .iter()
                .enumerate()
                .filter(|(_, sender)| !sender.has_given_up)
                .filter_map(|(at, sender)| Some((at, self.loaded(sender)?.0.wire_bits())))
                .collect();
            let bit = first_difference(&sending)?;
            if inverted.is_some_and(|inverted| inverted < bit) {
                return None;
            }
            let sends = |bits: &WireBits| bits.as_slice()[bit as usize].level;
            let overruled = sending.iter().filter(|(_, bits)| sends(bits) == Level::Recessive);
            let overruled: Vec<usize> = overruled.map(|(at, _)| *at).collect();
            let is_active = |at: &usize| self.error_state(senders[*at].station).is_error_active();
            if !overruled.iter().any(is_active) {
                for at in overruled {
                    senders[at].has_given_up = true;
                }
                continue;
            }
            let dominant = sending.iter().map(|(_, bits)| bits);
            let dominant: Vec<&WireBits> = dominant.filter(|bits| sends(bits) == Level::Dominant).collect();
            return Some(collision(bit, &dominant, self.parties(start, senders)));
        }
    }

    /// An inconsistent omission. Nobody sees the flags of error passive victims.
    fn omit(
        &mut self,
        start: VirtualInstant,
        senders: &[Sender],
        bits: u32,
        decision: &Decision,
        victims: &mut Vec<StationId>,
    ) -> Course {
        let Fault::InconsistentOmission { victims: chosen, transmitter } = &decision.fault else {
            return Course::undisturbed(bits);
        };
        *victims = decision.victims(chosen, self.receivers(start, senders).collect());
        if victims.is_empty() {
            return Course::undisturbed(bits);
        }
        self.accounting.omitted += 1;
        if !victims.iter().any(|station| self.error_state(*station).is_error_active()) {
            return Course::undisturbed(bits);
        }
        match transmitter {
            Transmitter::Retransmits => Course::omitted(bits),
            Transmitter::Accepts => Course::omitted_unseen(bits),
        }
    }

    /// A station has left the wire, possibly in the middle of a frame.
    pub(super) fn lose(&mut self, station: StationId) {
        let Some(mut transmission) = self.on_the_wire.take() else { return };
        let was_sending = transmission.senders.iter().any(|sender| sender.station == station);
        transmission.senders.retain(|sender| sender.station != station);
        let elapsed = self.now.checked_duration_since(transmission.start);
        let elapsed = elapsed.map_or(0, |it| it.as_ticks() / self.bit_rate.bit_time().as_ticks()) as u32;
        let seen = transmission.course.disturbance.map(|disturbance| disturbance.bit);
        let acknowledge_slot = transmission.bits - TAIL_BITS + 1;
        if was_sending {
            let is_orphan = transmission.senders.iter().all(|sender| sender.has_given_up);
            if is_orphan && seen.is_none_or(|bit| bit >= elapsed) {
                break_off(&mut transmission, elapsed);
            }
        } else if elapsed <= acknowledge_slot && seen.is_none_or(|bit| bit > acknowledge_slot) {
            let senders = &transmission.senders;
            if self.receivers(transmission.start, senders).next().is_none() {
                transmission.course = Course::unacknowledged(transmission.bits, self.is_any_active(senders));
            }
        }
        self.on_the_wire = Some(transmission);
    }
}

/// The first bit in which not all of the frames are equal.
fn first_difference(sending: &[(usize, WireBits)]) -> Option<u32> {
    let (_, first) = sending.first()?;
    let differs = |bit: usize| {
        let level = |bits: &WireBits| bits.as_slice().get(bit).map(|bit| bit.level);
        sending.iter().any(|(_, bits)| level(bits) != level(first))
    };
    (0..first.len()).find(|bit| differs(*bit as usize))
}

/// The course of frames that collide in `bit`; `dominant` are the frames of those that do not see it there.
fn collision(bit: u32, dominant: &[&WireBits], parties: Parties) -> Course {
    let seen = Disturbance {
        bit,
        field: dominant.first().and_then(|bits| bits.field(bit)).unwrap_or(Field::Control),
        cause: ErrorCause::Bit,
        origin: Origin::Collision,
        sender_counts: SenderCounts::Transmit,
        receivers_count: true,
    };
    let levels: Vec<Level> =
        dominant.iter().take(1).flat_map(|bits| bits.levels()).take(bit as usize + 1).collect();
    // The other senders see the flag at their next recessive bit, which the stuffing rule puts no later
    // than the receivers' sixth equal bit.
    let later_senders = dominant.iter().map(|bits| {
        let behind = bits.levels().skip(bit as usize + 1);
        let dominant_run = behind.take_while(|level| *level == Level::Dominant).count() as u32;
        bit + 1 + dominant_run + 1 + FLAG_BITS
    });
    let parties = Parties { active_sender: true, ..parties };
    let end = later_senders.max().unwrap_or(0).max(course::flags_end(&levels, parties));
    Course::broken(seen, end)
}

/// The last sender falls silent in bit `from`: the bus stays recessive.
fn break_off(transmission: &mut Transmission, from: u32) {
    let bits = transmission.frame.wire_bits();
    let stuffed = transmission.bits - TAIL_BITS;
    let levels: Vec<Level> = bits.levels().collect();
    let rest = levels.get(from as usize..stuffed as usize).unwrap_or_default();
    if rest.iter().all(|level| *level == Level::Recessive) {
        // What is missing is recessive anyway: the receivers notice nothing.
        return;
    }
    let run = levels[..from as usize].iter().rev().take_while(|level| **level == Level::Recessive).count();
    let sixth = from + RUN - run as u32;
    let (bit, cause) = if sixth < stuffed {
        (sixth, ErrorCause::Stuff)
    } else {
        // A wrong CRC is signalled behind the acknowledge delimiter.
        (stuffed + 2, ErrorCause::Crc)
    };
    let seen = Disturbance {
        bit,
        field: bits.field(bit).unwrap_or(Field::EndOfFrame),
        cause,
        origin: Origin::SenderLost,
        sender_counts: SenderCounts::Nothing,
        receivers_count: true,
    };
    transmission.course = Course::broken(seen, bit + 1 + FLAG_BITS);
}
