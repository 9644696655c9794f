//! A bxCAN (RM0090, chapter 32): modes, mailboxes, FIFOs, filters, errors, interrupts.
//!
//! The controller does not know the bus. What it wants done there is a list of [`Command`]s, each with
//! its cycle; what happens there is told to it. The bus itself counts errors and retransmits.
//!
//! Not modelled: loop-back and silent mode, no automatic retransmission (NART), automatic wake-up, the
//! time stamp sent in the last two bytes (TGT). Initialisation and sleep mode are entered at once, not
//! at the end of the current frame. LEC tells of transmitted frames only, and arbitration lost (ALST) is not
//! told. The status bits TXM, RXM, SAMP and RX of MSR read as after reset.

mod fifo;
mod filter;
#[cfg(test)]
mod manual;
mod pair;
#[cfg(test)]
mod random;
#[cfg(test)]
mod reception;
mod transmit;

use cosmic_bus::{ErrorCause, ErrorLevel, ErrorState, WireFrame};

use super::timer::NotModelled;
use fifo::Fifo;
use filter::{FilterBanks, Match};
pub use pair::CanController;
pub(crate) use pair::CanPair;
use transmit::Transmit;

mod mcr {
    pub(super) const INRQ: u32 = 1 << 0;
    pub(super) const SLEEP: u32 = 1 << 1;
    pub(super) const TXFP: u32 = 1 << 2;
    pub(super) const RFLM: u32 = 1 << 3;
    pub(super) const NART: u32 = 1 << 4;
    pub(super) const AWUM: u32 = 1 << 5;
    pub(super) const ABOM: u32 = 1 << 6;
    pub(super) const TTCM: u32 = 1 << 7;
    pub(super) const RESET: u32 = 1 << 15;
    pub(super) const ALL: u32 = 0x0001_80FF;
    /// Sleep mode, and the bus stays off in debug halt.
    pub(super) const AFTER_RESET: u32 = 0x0001_0002;
}

mod msr {
    pub(super) const INAK: u32 = 1 << 0;
    pub(super) const SLAK: u32 = 1 << 1;
    pub(super) const ERRI: u32 = 1 << 2;
    pub(super) const SLAKI: u32 = 1 << 4;
    /// The RX pin and its last sample are recessive.
    pub(super) const RECESSIVE: u32 = 3 << 10;
    pub(super) const CLEARED_BY_ONE: u32 = 0x1C;
}

mod ier {
    pub(super) const TMEIE: u32 = 1 << 0;
    pub(super) const FIFO0: u32 = 1;
    pub(super) const FIFO1: u32 = 4;
    pub(super) const LECIE: u32 = 1 << 11;
    pub(super) const ERRIE: u32 = 1 << 15;
    pub(super) const SLKIE: u32 = 1 << 17;
    pub(super) const ALL: u32 = 0x0003_8F7F;
}

mod esr {
    /// EWGF, EPVF, BOFF; the enables stand in IER at 8 and on.
    pub(super) const WARNING: u32 = 1 << 0;
    pub(super) const PASSIVE: u32 = 1 << 1;
    pub(super) const BUS_OFF: u32 = 1 << 2;
    pub(super) const LEC: u32 = 0x7 << 4;
}

mod btr {
    pub(super) const AFTER_RESET: u32 = 0x0123_0000;
    pub(super) const LOOP_BACK_OR_SILENT: u32 = 0x3 << 30;
}

/// Interrupts of CAN1 and CAN2, by number (RM0090, table 62).
const INTERRUPTS: [[u16; 4]; 2] = [[19, 20, 21, 22], [63, 64, 65, 66]];
/// Bits until a node that leaves initialisation mode takes part.
const INTEGRATION_BITS: u64 = 11;

/// What the controller wants of the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Command {
    /// The node takes part in the traffic.
    Connect,
    /// It no longer does.
    Disconnect,
    /// The controller's error counters and mailboxes are reset.
    Reset,
    /// What bus-off leads to (MCR.ABOM).
    RecoverAutomatically(bool),
    /// The software asks for the recovery from bus-off.
    RequestRecovery,
    Load {
        mailbox: usize,
        frame: WireFrame,
    },
    Withdraw {
        mailbox: usize,
    },
}

/// What became of a frame in a mailbox.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Outcome {
    Sent,
    Withdrawn,
    /// An attempt failed; the bus tries again.
    Failed,
}

/// The bit timing that the firmware set (BTR), in periods of PCLK1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct BitTiming {
    /// PCLK1 periods of one bit.
    pub(crate) periods: u32,
}

/// The controller.
#[derive(Clone, Debug)]
pub(crate) struct BxCan {
    mcr: u32,
    acknowledged: u32,
    /// ERRI, WKUI, SLAKI.
    causes: u32,
    ier: u32,
    btr: u32,
    last_error: u32,
    errors: ErrorState,
    transmit: Transmit,
    fifos: [Fifo; 2],
    filters: FilterBanks,
    commands: Vec<(u64, Command)>,
    /// HCLK cycles of one period of PCLK1.
    clock_period: u64,
    /// When INAK or SLAK is cleared.
    synchronised_at: Option<u64>,
    /// When the time stamp counter began.
    time_origin: u64,
}

impl BxCan {
    pub(crate) fn new() -> Self {
        Self {
            mcr: mcr::AFTER_RESET,
            acknowledged: msr::SLAK,
            causes: 0,
            ier: 0,
            btr: btr::AFTER_RESET,
            last_error: 0,
            errors: ErrorState::NEW,
            transmit: Transmit::default(),
            fifos: [Fifo::default(), Fifo::default()],
            filters: FilterBanks::new(),
            commands: Vec::new(),
            clock_period: 1,
            synchronised_at: None,
            time_origin: 0,
        }
    }

    /// Reset by RCC or by MCR.RESET.
    pub(crate) fn reset(&mut self, now: u64) {
        let mut commands = std::mem::take(&mut self.commands);
        commands.push((now, Command::Disconnect));
        commands.push((now, Command::Reset));
        *self = Self { commands, clock_period: self.clock_period, ..Self::new() };
    }

    /// HCLK cycles of one period of PCLK1.
    pub(crate) fn set_clock_period(&mut self, cycles: u64) {
        self.clock_period = cycles;
    }

    /// The commands given since the last call, with their cycles.
    pub(crate) fn take_commands(&mut self) -> Vec<(u64, Command)> {
        std::mem::take(&mut self.commands)
    }

    /// Returns whether the bus must carry out a command before this node goes on. A withdrawal reports back at once.
    pub(crate) fn waits_for_bus(&self) -> bool {
        self.commands.iter().any(|(_, command)| !matches!(command, Command::Load { .. }))
    }

    pub(crate) fn bit_timing(&self) -> BitTiming {
        let segment = |shift: u32, mask: u32| (self.btr >> shift & mask) + 1;
        BitTiming { periods: segment(0, 0x3FF) * (1 + segment(16, 0xF) + segment(20, 0x7)) }
    }

    /// The interrupt lines TX, RX0, RX1, SCE.
    pub(crate) fn interrupts(&self) -> [bool; 4] {
        let enabled = |bit: u32| self.ier & bit != 0;
        [
            enabled(ier::TMEIE) && self.transmit.interrupt(),
            self.fifos[0].interrupt(self.ier >> ier::FIFO0 & 7),
            self.fifos[1].interrupt(self.ier >> ier::FIFO1 & 7),
            enabled(ier::ERRIE) && self.causes & msr::ERRI != 0
                || enabled(ier::SLKIE) && self.causes & msr::SLAKI != 0,
        ]
    }

    /// Receives a frame as CAN1.
    #[cfg(test)]
    fn receive(&mut self, started: u64, frame: &WireFrame) {
        if let Some(found) = self.accept(CanController::Can1, frame) {
            self.store(started, frame, found);
        }
    }

    /// When [`BxCan::advance`] must be called next.
    pub(crate) fn deadline(&self) -> Option<u64> {
        self.synchronised_at
    }

    /// Time has passed.
    pub(crate) fn advance(&mut self, now: u64) {
        if self.synchronised_at.is_some_and(|at| at <= now) {
            self.synchronised_at = None;
            self.acknowledged = 0;
            self.causes &= !msr::SLAKI;
        }
    }

    /// The bus tells what became of a frame at the cycle `now`.
    pub(crate) fn complete(&mut self, now: u64, mailbox: usize, outcome: Outcome) {
        if outcome == Outcome::Sent {
            self.last_error = 0;
        }
        let command = self.transmit.complete(mailbox, outcome, self.mcr & mcr::TXFP != 0);
        self.commands.extend(command.map(|command| (now, command)));
    }

    /// An attempt to send failed.
    pub(crate) fn failed(&mut self, now: u64, mailbox: usize, cause: ErrorCause) {
        self.complete(now, mailbox, Outcome::Failed);
        self.last_error = match cause {
            ErrorCause::Stuff => 1,
            ErrorCause::Form => 2,
            ErrorCause::Acknowledgement => 3,
            ErrorCause::Crc => 6,
            // Sent dominant or recessive is not told apart: 5 is bit dominant error.
            ErrorCause::Bit => 5,
        };
        if self.ier & ier::LECIE != 0 {
            self.causes |= msr::ERRI;
        }
    }

    /// Where a controller stores the frame, by the filters of both, which are CAN1's; `None` if none accepts it.
    fn accept(&self, whose: CanController, frame: &WireFrame) -> Option<Match> {
        self.filters.accept(whose, frame)
    }

    /// A frame whose start of frame was at the cycle `started` was received, and accepted.
    fn store(&mut self, started: u64, frame: &WireFrame, found: Match) {
        self.last_error = 0;
        let time = if self.mcr & mcr::TTCM == 0 {
            0
        } else {
            let bit = u64::from(self.bit_timing().periods) * self.clock_period;
            (started.saturating_sub(self.time_origin) / bit) as u32 & 0xFFFF
        };
        let data = u64::from_le_bytes(frame.padded_data());
        let message = [
            filter::identifier_32(frame),
            time << 16 | u32::from(found.index) << 8 | u32::from(frame.length_code()),
            data as u32,
            (data >> 32) as u32,
        ];
        self.fifos[found.fifo].push(message, self.mcr & mcr::RFLM != 0);
    }

    /// The error counters of the bus.
    pub(crate) fn set_errors(&mut self, errors: ErrorState) {
        let before = error_flags(self.errors);
        self.errors = errors;
        let risen = error_flags(errors) & !before;
        if risen & (self.ier >> 8 & 7) != 0 {
            self.causes |= msr::ERRI;
        }
    }

    /// Reads a register. `None` if there is none.
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.mcr,
            0x04 => self.acknowledged | self.causes | msr::RECESSIVE,
            0x08 => self.transmit.status(),
            0x0C | 0x10 => self.fifos[(offset as usize - 0x0C) / 4].status(),
            0x14 => self.ier,
            0x18 => self.error_status(),
            0x1C => self.btr,
            0x180..=0x1AF => {
                let word = (offset as usize - 0x180) / 4;
                self.transmit.read(word / 4, word % 4)
            }
            0x1B0..=0x1CF => {
                let word = (offset as usize - 0x1B0) / 4;
                self.fifos[word / 4].read(word % 4)
            }
            _ => return self.filters.read(offset),
        })
    }

    /// Writes a register at the cycle `now`. `Err` if there is none, or for what is not modelled.
    pub(crate) fn write(&mut self, now: u64, offset: u32, value: u32) -> Result<(), NotModelled> {
        let oldest_first = self.mcr & mcr::TXFP != 0;
        match offset {
            0x00 => return self.write_mcr(now, value),
            0x04 => self.causes &= !(value & msr::CLEARED_BY_ONE),
            0x08 => {
                let commands = self.transmit.write_status(value, oldest_first);
                self.commands.extend(commands.into_iter().map(|command| (now, command)));
            }
            0x0C | 0x10 => self.fifos[(offset as usize - 0x0C) / 4].write_status(value),
            0x14 => self.ier = value & ier::ALL,
            0x18 => self.last_error = value >> 4 & 7,
            0x1C => {
                // Write protected outside of initialisation mode.
                if self.acknowledged & msr::INAK != 0 {
                    self.btr = value;
                }
                return if value & btr::LOOP_BACK_OR_SILENT == 0 { Ok(()) } else { Err(NotModelled) };
            }
            0x180..=0x1AF => {
                let word = (offset as usize - 0x180) / 4;
                let command = self.transmit.write(word / 4, word % 4, value, oldest_first);
                self.commands.extend(command.map(|command| (now, command)));
            }
            _ => return self.filters.write(offset, value).ok_or(NotModelled),
        }
        Ok(())
    }

    fn write_mcr(&mut self, now: u64, value: u32) -> Result<(), NotModelled> {
        if value & mcr::RESET != 0 {
            self.reset(now);
            return Ok(());
        }
        let changed = self.mcr ^ value;
        self.mcr = value & mcr::ALL;
        if changed & mcr::ABOM != 0 {
            self.commands.push((now, Command::RecoverAutomatically(value & mcr::ABOM != 0)));
        }
        let wanted = match value & (mcr::INRQ | mcr::SLEEP) {
            mcr::INRQ => msr::INAK,
            mcr::SLEEP => msr::SLAK,
            0 => 0,
            _ => self.acknowledged,
        };
        self.change_mode(now, wanted);
        if value & (mcr::NART | mcr::AWUM) == 0 { Ok(()) } else { Err(NotModelled) }
    }

    /// `wanted` is INAK, SLAK, or nothing for normal mode.
    fn change_mode(&mut self, now: u64, wanted: u32) {
        if wanted == 0 {
            if self.acknowledged != 0 && self.synchronised_at.is_none() {
                let bit = u64::from(self.bit_timing().periods) * self.clock_period;
                self.synchronised_at = Some(now + INTEGRATION_BITS * bit);
                self.time_origin = now;
                self.commands.push((now, Command::Connect));
                if self.acknowledged == msr::INAK && self.errors.level() == ErrorLevel::BusOff {
                    self.commands.push((now, Command::RequestRecovery));
                }
            }
            return;
        }
        if self.acknowledged == 0 || self.synchronised_at.is_some() {
            self.commands.push((now, Command::Disconnect));
        }
        if wanted == msr::SLAK && self.acknowledged != msr::SLAK && self.ier & ier::SLKIE != 0 {
            self.causes |= msr::SLAKI;
        }
        if wanted != msr::SLAK {
            self.causes &= !msr::SLAKI;
        }
        self.synchronised_at = None;
        self.acknowledged = wanted;
    }

    fn error_status(&self) -> u32 {
        let counters = self.errors;
        // TEC has eight bits: bus-off reads as it overflowed.
        u32::from(counters.receive_errors) << 24
            | u32::from(counters.transmit_errors & 0xFF) << 16
            | self.last_error << 4 & esr::LEC
            | error_flags(counters)
    }
}

fn error_flags(errors: ErrorState) -> u32 {
    match errors.level() {
        ErrorLevel::Active => 0,
        ErrorLevel::Warning => esr::WARNING,
        ErrorLevel::Passive => esr::WARNING | esr::PASSIVE,
        ErrorLevel::BusOff => esr::WARNING | esr::PASSIVE | esr::BUS_OFF,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, Frame as _};

    /// A controller in normal mode, 1 Mbit/s from 42 MHz, all frames to FIFO 0.
    fn normal() -> BxCan {
        let mut can = BxCan::new();
        can.set_clock_period(4);
        can.write(0, 0x00, mcr::INRQ | mcr::TTCM).unwrap();
        assert_eq!(can.read(0x04).map(|value| value & 3), Some(msr::INAK));
        can.write(0, 0x1C, 2 | 9 << 16 | 2 << 20).unwrap();
        can.write(0, 0x20C, 1).unwrap();
        can.write(0, 0x21C, 1).unwrap();
        can.write(0, 0x200, 0x0E00).unwrap();
        can.write(100, 0x00, mcr::TTCM).unwrap();
        can
    }

    #[test]
    fn the_handshake_takes_eleven_bits() {
        let mut can = normal();
        assert_eq!(can.bit_timing(), BitTiming { periods: 42 });
        assert_eq!(can.take_commands(), [(100, Command::Connect)]);
        let at = 100 + 11 * 168;
        assert_eq!(can.deadline(), Some(at));
        can.advance(at - 1);
        assert_eq!(can.read(0x04).map(|value| value & 3), Some(msr::INAK));
        can.advance(at);
        assert_eq!(can.read(0x04).map(|value| value & 3), Some(0));
    }

    #[test]
    fn a_received_frame_is_stamped_and_raises_its_interrupt() {
        let mut can = normal();
        can.write(200, 0x14, 1 << 1).unwrap();
        let frame = WireFrame::new(ExtendedId::new(0x0AB_CDEF).unwrap(), &[1, 2, 3, 4, 5]).unwrap();
        can.receive(100 + 168 * 70_000, &frame);
        assert_eq!(can.interrupts(), [false, true, false, false]);
        assert_eq!(can.read(0x1B0), Some(0x0AB_CDEF << 3 | 1 << 2));
        assert_eq!(can.read(0x1B4), Some(((70_000 & 0xFFFF) << 16) | 5));
        assert_eq!((can.read(0x1B8), can.read(0x1BC)), (Some(0x0403_0201), Some(5)));
        can.write(200, 0x0C, 1 << 5).unwrap();
        assert_eq!(can.interrupts(), [false; 4]);
    }

    #[test]
    fn error_levels_raise_the_status_change_interrupt() {
        let mut can = normal();
        can.write(0, 0x14, ier::ERRIE | 1 << 9).unwrap();
        can.set_errors(ErrorState { transmit_errors: 100, receive_errors: 0 });
        assert_eq!(can.interrupts(), [false; 4]);
        can.set_errors(ErrorState { transmit_errors: 130, receive_errors: 7 });
        assert_eq!(can.interrupts(), [false, false, false, true]);
        assert_eq!(can.read(0x18), Some(7 << 24 | 130 << 16 | 3));
        can.write(0, 0x04, msr::ERRI).unwrap();
        assert_eq!(can.interrupts(), [false; 4]);
    }

    #[test]
    fn what_is_not_modelled_is_told() {
        let mut can = normal();
        assert_eq!(can.write(0, 0x00, mcr::NART), Err(NotModelled));
        assert_eq!(can.write(0, 0x1C, 1 << 30), Err(NotModelled));
        assert_eq!(can.write(0, 0x320, 0), Err(NotModelled));
        assert_eq!(can.read(0x320), None);
    }
}
