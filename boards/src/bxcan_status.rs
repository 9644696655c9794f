//! The error state of bxCAN, and its status change interrupt.
//!
//! The interrupt `CAN1_SCE` comes when the controller reaches the warning limit (96 errors), becomes error
//! passive (128) or goes off the bus (256): not for each error, so that a disturbed bus costs no time, and
//! not when the counters fall. It may come 20 failed transmissions before bus-off is reached, and each
//! bus-off is told apart from the next by it.
//!
//! After 128 times 11 recessive bits, 1408 bit times, a controller that is bus-off takes part again, with its counters at
//! zero and its pending frames still in the mailboxes. It begins to count them [by itself](Recovery::Automatic), and then
//! the interrupt must be served within 1408 bit times, or the bus-off has passed unseen; or
//! [when it is asked](BusStatus::ask_to_rejoin).

use cosmic_core::can::ErrorCounters;

use crate::registers::Registers;

/// How the controller stands towards the bus (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ErrorState {
    /// Takes part in everything.
    Active,
    /// Takes part in everything, but a counter has reached 96: the bus or this node is disturbed.
    Warning,
    /// Over 127 errors: signals errors passively.
    Passive,
    /// Over 255 transmit errors: off the bus, until 128 times 11 recessive bits were seen.
    BusOff,
}

impl ErrorState {
    /// What `CAN_ESR` says.
    const fn of(status: u32) -> Self {
        if status & ESR_BOFF != 0 {
            Self::BusOff
        } else if status & ESR_EPVF != 0 {
            Self::Passive
        } else if status & ESR_EWGF != 0 {
            Self::Warning
        } else {
            Self::Active
        }
    }
}

/// What ends bus-off.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Recovery {
    /// The controller begins at once to count recessive bits (`CAN_MCR`, ABOM = 1).
    Automatic,
    /// It waits to be asked (ABOM = 0), which the runtime does after a pause that grows from 10 ms to a second, while the
    /// node goes off the bus again and again. A line that is shorted so costs the others little.
    Paced,
}

/// What `CAN_ESR` says.
const fn counters(status: u32) -> ErrorCounters {
    ErrorCounters { transmit: (status >> ESR_TEC_SHIFT) as u8, receive: (status >> ESR_REC_SHIFT) as u8 }
}

/// Reads the error counters and the state, at any time, and ends bus-off.
pub struct BusStatus {
    registers: Registers,
}

impl BusStatus {
    pub(crate) const fn new(registers: Registers) -> Self {
        Self { registers }
    }

    /// The error counters as they are now.
    #[inline]
    pub fn errors(&self) -> ErrorCounters {
        counters(self.registers.read(ESR))
    }

    /// What follows from them.
    #[inline]
    pub fn state(&self) -> ErrorState {
        ErrorState::of(self.registers.read(ESR))
    }

    /// Where recovery is not automatic: lets the controller enter its initialisation mode, and with the second call
    /// leave it, which is how it is asked to count recessive bits (RM0090, 32.7.6). Returns whether it was the second.
    /// Between the two are some bits.
    pub fn ask_to_rejoin(&mut self) -> bool {
        let mode = self.registers.read(MCR);
        // Since the controller has joined, the register is this owner's.
        self.registers.write(MCR, mode ^ MCR_INRQ);
        mode & MCR_INRQ != 0
    }
}

/// The error state has become worse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StatusChange {
    /// The error counters as they are now.
    pub errors: ErrorCounters,
    /// What follows from them. If they have fallen meanwhile, it may be better again.
    pub state: ErrorState,
    /// Whether the controller went off the bus since the last change.
    pub went_off: bool,
}

/// For the interrupt `CAN1_SCE`: alone acknowledges it.
pub struct StatusChanges {
    registers: Registers,
    is_off: bool,
}

impl StatusChanges {
    pub(crate) const fn new(registers: Registers) -> Self {
        Self { registers, is_off: false }
    }

    /// What changed, which is thereby acknowledged; `None` if nothing did. Call it once for each interrupt.
    ///
    /// Bounded: reads the state once more for each limit that is reached meanwhile, and there are three.
    pub fn take(&mut self) -> Option<StatusChange> {
        let mut status = None;
        // The flag is cleared first: what comes behind the last reading raises it again.
        for _ in 0..=LIMITS {
            if self.registers.read(MSR) & MSR_ERRI == 0 {
                break;
            }
            self.registers.write(MSR, MSR_ERRI);
            status = Some(self.registers.read(ESR));
        }
        let status = status?;
        let state = ErrorState::of(status);
        // Between two times off the bus the counters pass the warning limit, which is a change of its own.
        let was_off = core::mem::replace(&mut self.is_off, state == ErrorState::BusOff);
        Some(StatusChange { errors: counters(status), state, went_off: self.is_off && !was_off })
    }
}

/// Warning, passive, off.
const LIMITS: usize = 3;

/// The causes of the interrupt in `CAN_IER`: EWGIE, EPVIE, BOFIE, and ERRIE for all of them. LECIE, which
/// would raise it for each error on the bus, is not among them.
pub(crate) const INTERRUPTS: u32 = 1 << 8 | 1 << 9 | 1 << 10 | 1 << 15;

// RM0090, bxCAN register map.
const MCR: usize = 0x00;
const MSR: usize = 0x04;
const ESR: usize = 0x18;

const MCR_INRQ: u32 = 1 << 0;
const MSR_ERRI: u32 = 1 << 2;
const ESR_EWGF: u32 = 1 << 0;
const ESR_EPVF: u32 = 1 << 1;
const ESR_BOFF: u32 = 1 << 2;
const ESR_TEC_SHIFT: u32 = 16;
const ESR_REC_SHIFT: u32 = 24;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::Memory;
    use proptest::prelude::*;

    #[test]
    fn the_state_follows_the_flags() {
        let mut memory = Memory::new();
        let states = [
            (0, ErrorState::Active),
            (0b001, ErrorState::Warning),
            (0b011, ErrorState::Passive),
            (0b111, ErrorState::BusOff),
        ];
        for (flags, state) in states {
            memory.set(ESR, 0x1234_0050 | flags);
            let bus = BusStatus::new(memory.registers());
            assert_eq!(bus.state(), state);
            assert_eq!(bus.errors(), ErrorCounters { transmit: 0x34, receive: 0x12 });
        }
    }

    /// The interrupt, with these flags in `CAN_ESR`.
    fn interrupt(memory: &mut Memory, changes: &mut StatusChanges, flags: u32) -> Option<(ErrorState, bool)> {
        memory.set(ESR, flags);
        memory.set(MSR, MSR_ERRI);
        changes.take().map(|change| (change.state, change.went_off))
    }

    #[test]
    fn each_bus_off_is_told_once() {
        let mut memory = Memory::new();
        let mut changes = StatusChanges::new(memory.registers());
        assert_eq!(changes.take(), None);
        for _ in 0..2 {
            assert_eq!(interrupt(&mut memory, &mut changes, 1), Some((ErrorState::Warning, false)));
            assert_eq!(interrupt(&mut memory, &mut changes, 3), Some((ErrorState::Passive, false)));
            assert_eq!(interrupt(&mut memory, &mut changes, 7), Some((ErrorState::BusOff, true)));
            // Raised again between the acknowledgement and the reading.
            assert_eq!(interrupt(&mut memory, &mut changes, 7), Some((ErrorState::BusOff, false)));
        }
    }

    #[test]
    fn the_request_enters_initialisation_mode_and_leaves_it() {
        let mut memory = Memory::new();
        memory.set(MCR, 1 << 16);
        let mut bus = BusStatus::new(memory.registers());
        assert!(!bus.ask_to_rejoin());
        assert_eq!(memory.at(MCR), 1 << 16 | 1);
        assert!(bus.ask_to_rejoin());
        assert_eq!(memory.at(MCR), 1 << 16);
    }

    #[test]
    fn only_its_own_flag_is_acknowledged() {
        let mut memory = Memory::new();
        // Also pending: SLAKI and WKUI, which a 1 would clear, and the state bits.
        memory.set(MSR, 0xC1F);
        assert!(StatusChanges::new(memory.registers()).take().is_some());
        assert_eq!(memory.at(MSR), MSR_ERRI);
    }

    proptest! {
        #[test]
        fn any_register_values_are_a_state(msr: u32, esr: u32) {
            let mut memory = Memory::new();
            memory.set(MSR, msr);
            memory.set(ESR, esr);
            let change = StatusChanges::new(memory.registers()).take();
            prop_assert_eq!(change.is_some(), msr & MSR_ERRI != 0);
            prop_assert!(change.is_none_or(|change| change.went_off == (esr & ESR_BOFF != 0)));
        }
    }
}
