//! The way back from bus-off: 128 sequences of 11 recessive bits.
//!
//! Delimiter, end of frame and intermission of any frame are one such sequence; on a free bus each 11 bits
//! are one.

use super::Bus;
use crate::confinement::{BusOffRecovery, ErrorLevel, ErrorState, INTEGRATION_BITS, RECOVERY_SEQUENCES};
use crate::event::StationId;
use crate::time::VirtualInstant;

/// A station that counts recessive bits.
#[derive(Debug)]
pub(super) struct Recovering {
    pub(super) station: StationId,
    since: VirtualInstant,
    /// Sequences seen before the bus was last free.
    sequences: u32,
}

impl Bus {
    /// Starts the recovery of a station, which sees the bus from `since` on, if it is bus-off and connected.
    pub(super) fn recover(&mut self, station: StationId, since: VirtualInstant) {
        let state = &self.stations[station.index()];
        let is_recovering = self.recovering.iter().any(|recovering| recovering.station == station);
        if state.errors.level() == ErrorLevel::BusOff && state.is_connected && !is_recovering {
            self.recovering.push(Recovering { station, since, sequences: 0 });
        }
    }

    /// Falls silent, and begins to recover if the station does so by itself.
    pub(super) fn enter_bus_off(&mut self, station: StationId, since: VirtualInstant) {
        let state = &mut self.stations[station.index()];
        state.silence();
        if state.recovery == BusOffRecovery::Automatic {
            self.recover(station, since);
        }
    }

    /// Takes part again from `integrated` on; a station that is bus-off has to recover first.
    pub(super) fn take_part_or_recover(&mut self, station: StationId, integrated: VirtualInstant) {
        let state = &mut self.stations[station.index()];
        if state.errors.level() == ErrorLevel::BusOff {
            self.enter_bus_off(station, self.now);
        } else {
            state.take_part_from(integrated);
        }
        self.reconsider(station);
    }

    /// When the next recovery ends, if the bus stays free; `None` during a frame, too.
    pub(super) fn next_recovery(&self) -> Option<VirtualInstant> {
        if self.on_the_wire.is_some() {
            return None;
        }
        self.recovering.iter().map(|recovering| self.recovered_at(recovering)).min()
    }

    fn recovered_at(&self, recovering: &Recovering) -> VirtualInstant {
        let missing = RECOVERY_SEQUENCES.saturating_sub(recovering.sequences);
        self.free_from.max(recovering.since) + self.bits(INTEGRATION_BITS * missing)
    }

    /// Ends the recoveries that are due.
    pub(super) fn end_recoveries(&mut self, at: VirtualInstant) {
        while let Some(due) = self.recovering.iter().position(|it| self.recovered_at(it) <= at) {
            let station = self.recovering.remove(due).station;
            self.count(at, station, |errors| *errors = ErrorState::NEW);
            self.stations[station.index()].take_part_from(at);
            self.reconsider(station);
        }
    }

    /// A frame starts: the free bits before it count as far as they fill sequences.
    pub(super) fn interrupt_recoveries(&mut self, start: VirtualInstant) {
        let sequence = self.bits(INTEGRATION_BITS);
        for recovering in &mut self.recovering {
            let free = start.checked_duration_since(self.free_from.max(recovering.since));
            recovering.sequences += free.map_or(0, |free| (free.as_ticks() / sequence.as_ticks()) as u32);
        }
    }

    /// A frame is over and so is its intermission: that was one sequence for who saw all of it.
    pub(super) fn continue_recoveries(&mut self) {
        let sequence = self.bits(INTEGRATION_BITS);
        for recovering in &mut self.recovering {
            if recovering.since + sequence <= self.free_from {
                recovering.sequences += 1;
            }
        }
    }
}
