//! The bxCAN controller: brings it up, and takes it apart for its owners.
//!
//! Modes, bit timing and interrupts are set here (RM0090, bxCAN operating modes), and the acceptance filters
//! [beside it](crate::bxcan_filters). What the controller does from then on belongs to the [`Parts`].

use cosmic_core::can::filter_banks::FilterBank;

use crate::bit_timing::BitTiming;
use crate::bxcan_filters::{BANKS, Banks, SpareBanks, TooManyFilters};
use crate::bxcan_rx::RxFrames;
use crate::bxcan_status::{self, BusStatus, Recovery, StatusChanges};
use crate::bxcan_tx::{self, HardMailbox, NonRealTimeMailbox, SoftMailbox, TxOutcomes};
use crate::registers::Registers;

/// Why a controller cannot be set up.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SetUpError {
    /// More filters than the peripheral has banks.
    TooManyFilters,
    /// It does not enter initialisation mode: it is not clocked, or a frame is under way that does not end.
    NoAnswer,
}

/// A controller as it comes out of reset: [`set_up`](Self::set_up), [`join`](Self::join), then
/// [`split`](Self::split).
pub struct Controller {
    registers: Registers,
    banks: Banks,
}

/// The parts of a controller, each for one owner.
pub struct Parts {
    /// Transmit mailbox of hard real-time.
    pub hard: HardMailbox,
    /// Transmit mailbox of soft real-time.
    pub soft: SoftMailbox,
    /// Transmit mailbox of non real-time.
    pub non_real_time: NonRealTimeMailbox,
    /// For the transmit interrupt.
    pub outcomes: TxOutcomes,
    /// For the interrupt of FIFO 0.
    pub urgent: RxFrames,
    /// For the interrupt of FIFO 1.
    pub other: RxFrames,
    /// For the status change interrupt.
    pub changes: StatusChanges,
    /// The error counters.
    pub bus: BusStatus,
}

impl Controller {
    /// Takes over CAN1.
    ///
    /// # Safety
    /// `base` is the address of the peripheral's registers, which stay valid for the rest of the program,
    /// and nothing else writes them.
    pub const unsafe fn new(base: *mut u32) -> Self {
        // SAFETY: what the caller promises.
        let registers = unsafe { Registers::new(base) };
        Self { registers, banks: Banks { registers, first: 0 } }
    }

    /// Takes over CAN2, and its banks among the filters of CAN1, whose clock must be on.
    ///
    /// # Safety
    /// As for [`new`](Self::new), for both.
    pub const unsafe fn second(base: *mut u32, of_can1: *mut u32) -> Self {
        // SAFETY: what the caller promises.
        let (registers, filters) = unsafe { (Registers::new(base), Registers::new(of_can1)) };
        Self { registers, banks: Banks { registers: filters, first: BANKS } }
    }

    /// Puts the controller into initialisation mode, and sets it up. It takes no part in the traffic yet. With
    /// `leaves_spare`, everything is accepted until the banks that are returned are set; without, there are none.
    ///
    /// # Errors
    /// If it does not answer, or there are more filters than [`BANKS`], of which two must be left to be spare; those that
    /// have a bank are written then.
    pub fn set_up<'a>(
        &mut self,
        timing: BitTiming,
        recovery: Recovery,
        filters: impl Iterator<Item = &'a FilterBank>,
        leaves_spare: bool,
    ) -> Result<SpareBanks, SetUpError> {
        let registers = self.registers;
        registers.write(MCR, registers.read(MCR) & MCR_DBF | MCR_INRQ);
        if !self.waits_until(|status| status & MSR_INAK != 0) {
            return Err(SetUpError::NoAnswer);
        }
        configure(registers, timing, recovery);
        self.banks.apply(filters, leaves_spare).map_err(|TooManyFilters| SetUpError::TooManyFilters)
    }

    /// Takes part in the traffic, once the bus has been recessive for 11 bits; waits for that, but not for ever.
    ///
    /// Returns whether it does. If not, the bus is held dominant (a short, a transceiver without supply): the
    /// controller joins by itself when that ends, and what is loaded until then waits in its mailbox.
    pub fn join(&mut self) -> bool {
        let registers = self.registers;
        registers.write(MCR, registers.read(MCR) & !(MCR_INRQ | MCR_SLEEP));
        self.waits_until(|status| status & (MSR_INAK | MSR_SLAK) == 0)
    }

    /// Returns whether the status became so within [`PATIENCE`] readings.
    fn waits_until(&self, is_so: impl Fn(u32) -> bool) -> bool {
        (0..PATIENCE).any(|_| is_so(self.registers.read(MSR)))
    }

    /// Takes the controller apart.
    pub const fn split(self) -> Parts {
        let registers = self.registers;
        let (hard, soft, non_real_time, outcomes) = bxcan_tx::split(registers);
        Parts {
            hard,
            soft,
            non_real_time,
            outcomes,
            urgent: RxFrames::urgent(registers),
            other: RxFrames::other(registers),
            changes: StatusChanges::new(registers),
            bus: BusStatus::new(registers),
        }
    }
}

/// Needs initialisation mode.
fn configure(registers: Registers, timing: BitTiming, recovery: Recovery) {
    registers.write(BTR, timing.register());
    // Frames are sent in the order of their identifiers (TXFP = 0), and again until they succeed (NART = 0).
    // A full FIFO keeps the newest frame (RFLM = 0).
    let recovery = if recovery == Recovery::Automatic { MCR_ABOM } else { 0 };
    registers.write(MCR, registers.read(MCR) & (MCR_DBF | MCR_INRQ) | recovery);
    registers.write(IER, IER_TMEIE | IER_FMPIE0 | IER_FMPIE1 | bxcan_status::INTERRUPTS);
}

/// So often the status is read until a mode has changed: each takes 5 cycles at least, 30 ms at 168 MHz in all. A frame
/// takes 3 ms at 50 kbit/s.
const PATIENCE: u32 = 1_000_000;

// RM0090, bxCAN register map.
const MCR: usize = 0x00;
const MSR: usize = 0x04;
const IER: usize = 0x14;
const BTR: usize = 0x1C;

const MCR_INRQ: u32 = 1 << 0;
const MCR_SLEEP: u32 = 1 << 1;
const MCR_ABOM: u32 = 1 << 6;
const MCR_DBF: u32 = 1 << 16;
const MSR_INAK: u32 = 1 << 0;
const MSR_SLAK: u32 = 1 << 1;
const IER_TMEIE: u32 = 1 << 0;
const IER_FMPIE0: u32 = 1 << 1;
const IER_FMPIE1: u32 = 1 << 4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bxcan_filters::{FA1R, FFA1R, FM1R, FMR, FS1R};
    use crate::registers::Memory;
    use cosmic_core::can::BitRate;
    use cosmic_core::can::filter_banks::Fifo;

    fn first(memory: &mut Memory) -> Controller {
        let registers = memory.registers();
        Controller { registers, banks: Banks { registers, first: 0 } }
    }

    #[test]
    fn the_second_controller_has_the_other_banks_of_the_first() {
        let (mut first, mut second) = (Memory::new(), Memory::new());
        second.set(MSR, MSR_INAK);
        for register in [FM1R, FS1R, FFA1R, FA1R] {
            first.set(register, 0x0800_0021);
        }
        let timing = BitTiming::new(42_000_000, BitRate::MAX).unwrap();
        let banks = Banks { registers: first.registers(), first: BANKS };
        let mut controller = Controller { registers: second.registers(), banks };
        let filters = [FilterBank::Mask { id: 0x0020_0012, mask: 0x1FE0_3FFF, fifo: Fifo::Other }];
        assert!(controller.set_up(timing, Recovery::Paced, filters.iter(), false).is_ok());
        assert_eq!([FM1R, FS1R, FFA1R, FA1R].map(|at| first.at(at)), [0x21, 0x4021, 0x4021, 0x4021]);
        assert_eq!((first.at(0x240 + 8 * 14), first.at(MCR), first.at(BTR)), (0x0100_0094, 0, 0));
        assert_eq!((second.at(BTR), second.at(FA1R), second.at(FMR)), (timing.register(), 0, 0));
    }

    #[test]
    fn modes_and_interrupts() {
        let mut memory = Memory::new();
        // The reset value with INRQ in place of SLEEP; TXFP, NART and RFLM as somebody may have left them.
        memory.set(MCR, 0x0001_001D);
        let timing = BitTiming::new(42_000_000, BitRate::MAX).unwrap();
        memory.set(MSR, MSR_INAK);
        let mut controller = first(&mut memory);
        assert!(controller.set_up(timing, Recovery::Paced, [].iter(), false).is_ok());
        assert_eq!(memory.at(MCR), 0x0001_0001);
        assert!(controller.set_up(timing, Recovery::Automatic, [].iter(), false).is_ok());
        assert_eq!(memory.at(MCR), 0x0001_0041);
        assert_eq!(memory.at(BTR), timing.register());
        assert_eq!(memory.at(IER), 0x8713);
        memory.set(MSR, 0xC00);
        assert!(controller.join());
        assert_eq!(memory.at(MCR), 0x0001_0040);
    }

    #[test]
    fn a_controller_that_does_not_answer_and_a_bus_that_is_stuck_stop_nobody() {
        let mut memory = Memory::new();
        let timing = BitTiming::new(42_000_000, BitRate::MAX).unwrap();
        let mut controller = first(&mut memory);
        assert_eq!(
            controller.set_up(timing, Recovery::Paced, [].iter(), false).err(),
            Some(SetUpError::NoAnswer)
        );
        // Held dominant: the controller stays in initialisation mode, and is asked to leave it.
        memory.set(MSR, MSR_INAK);
        assert!(controller.set_up(timing, Recovery::Paced, [].iter(), false).is_ok());
        assert!(!controller.join());
        assert_eq!(memory.at(MCR), 0);
    }
}
