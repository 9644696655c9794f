//! Exceptions and their priorities (ARMv7-M ARM, B1.5 and B3.4).
//!
//! This is the state only: which exceptions are enabled, pending and active, and which one is to be taken.
//! Stacking and unstacking is [`crate::exception`].

/// System exceptions, and the number of the first interrupt.
pub(crate) mod number {
    pub(crate) const NMI: u16 = 2;
    pub(crate) const HARD_FAULT: u16 = 3;
    pub(crate) const SV_CALL: u16 = 11;
    pub(crate) const PEND_SV: u16 = 14;
    pub(crate) const SYS_TICK: u16 = 15;
    pub(crate) const FIRST_INTERRUPT: u16 = 16;
}

/// Interrupts of the STM32F405 (RM0090, table 62).
pub(crate) const INTERRUPTS: u16 = 82;
const EXCEPTIONS: usize = (number::FIRST_INTERRUPT + INTERRUPTS) as usize;
/// The four priority bits of the STM32F4.
const PRIORITY_BITS: u8 = 0xF0;
/// No exception has a lower urgency than this; the thread has it.
const THREAD: i16 = 256;

/// The interrupt masks of the core.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Masks {
    pub(crate) primask: bool,
    pub(crate) faultmask: bool,
    pub(crate) basepri: u8,
}

/// The interrupt controller. Sets of exceptions are bits of a `u128`.
#[derive(Clone, Debug)]
pub(crate) struct Nvic {
    enabled: u128,
    pending: u128,
    active: u128,
    /// Interrupt lines that are asserted.
    asserted: u128,
    priorities: [u8; EXCEPTIONS],
    /// AIRCR.PRIGROUP: where the group priority ends.
    group: u8,
    /// Active exceptions, the one that runs last.
    running: Vec<u16>,
}

impl Nvic {
    pub(crate) const fn new() -> Self {
        // System exceptions need not be enabled, apart from the faults, which escalate here.
        let enabled = (1 << number::FIRST_INTERRUPT) - 1;
        Self {
            enabled,
            pending: 0,
            active: 0,
            asserted: 0,
            priorities: [0; EXCEPTIONS],
            group: 0,
            running: Vec::new(),
        }
    }

    /// Returns whether anything is pending that is enabled, masked or not.
    pub(crate) const fn any_pending(&self) -> bool {
        self.pending & self.enabled != 0
    }

    /// Would anything pending and enabled pre-empt the current execution if PRIMASK were clear? That is
    /// what ends WFI (B1.5.19).
    pub(crate) fn wakes(&self, masks: Masks) -> bool {
        self.to_take(Masks { primask: false, ..masks }).is_some()
    }

    /// The exception to be taken now, if there is one.
    pub(crate) fn to_take(&self, masks: Masks) -> Option<u16> {
        let candidate = self.most_urgent_pending()?;
        (self.group_priority(candidate) < self.execution_priority(masks)).then_some(candidate)
    }

    pub(crate) const fn is_pending(&self, exception: u16) -> bool {
        self.pending >> exception & 1 != 0
    }

    pub(crate) fn pend(&mut self, exception: u16) {
        self.pending |= 1 << exception;
    }

    pub(crate) fn unpend(&mut self, exception: u16) {
        self.pending &= !(1 << exception);
    }

    /// The exception is entered.
    pub(crate) fn activate(&mut self, exception: u16) {
        self.unpend(exception);
        self.active |= 1 << exception;
        self.running.push(exception);
    }

    /// The exception is left. A line that is still asserted makes it pending again.
    pub(crate) fn deactivate(&mut self, exception: u16) {
        self.active &= !(1 << exception);
        self.running.retain(|&running| running != exception);
        self.pending |= self.asserted & 1 << exception;
    }

    /// The exception that runs; 0 in thread mode.
    pub(crate) fn current(&self) -> u16 {
        self.running.last().copied().unwrap_or(0)
    }

    /// The line of an interrupt. A rising edge makes it pending.
    pub(crate) fn set_line(&mut self, interrupt: u16, asserted: bool) {
        let bit = 1 << (number::FIRST_INTERRUPT + interrupt);
        if asserted && self.asserted & bit == 0 {
            self.pending |= bit;
        }
        if asserted { self.asserted |= bit } else { self.asserted &= !bit }
    }

    pub(crate) fn set_priority(&mut self, exception: u16, priority: u8) {
        if let Some(slot) = self.priorities.get_mut(usize::from(exception)) {
            *slot = priority & PRIORITY_BITS;
        }
    }

    pub(crate) fn priority(&self, exception: u16) -> u8 {
        self.priorities.get(usize::from(exception)).copied().unwrap_or(0)
    }

    /// AIRCR.PRIGROUP.
    pub(crate) fn set_group(&mut self, group: u8) {
        self.group = group & 7;
    }

    pub(crate) const fn group(&self) -> u8 {
        self.group
    }

    /// The most urgent: the smallest priority, then the smallest number.
    pub(crate) fn most_urgent_pending(&self) -> Option<u16> {
        let mut left = self.pending & self.enabled;
        let mut best: Option<(i16, u16)> = None;
        while left != 0 {
            let exception = left.trailing_zeros() as u16;
            left &= left - 1;
            let key = (self.full_priority(exception), exception);
            if best.is_none_or(|best| key < best) {
                best = Some(key);
            }
        }
        best.map(|(_, exception)| exception)
    }

    fn full_priority(&self, exception: u16) -> i16 {
        match exception {
            number::NMI => -2,
            number::HARD_FAULT => -1,
            _ => i16::from(self.priority(exception)),
        }
    }

    fn group_priority(&self, exception: u16) -> i16 {
        self.grouped(self.full_priority(exception))
    }

    /// Only the group part of a priority counts for pre-emption.
    fn grouped(&self, priority: i16) -> i16 {
        if priority < 0 { priority } else { priority & (0xFF << (self.group + 1)) }
    }

    fn execution_priority(&self, masks: Masks) -> i16 {
        let mut priority = THREAD;
        let mut left = self.active;
        while left != 0 {
            priority = priority.min(self.group_priority(left.trailing_zeros() as u16));
            left &= left - 1;
        }
        if masks.basepri != 0 {
            priority = priority.min(self.grouped(i16::from(masks.basepri & PRIORITY_BITS)));
        }
        if masks.primask {
            priority = priority.min(0);
        }
        if masks.faultmask {
            priority = priority.min(-1);
        }
        priority
    }

    /// Reads a register at this offset from 0xE000_E000; `None` if there is none.
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        let word = |set: u128, base: u32| (set >> number::FIRST_INTERRUPT >> ((offset - base) * 8)) as u32;
        Some(match offset {
            0x100..=0x10B => word(self.enabled, 0x100),
            0x180..=0x18B => word(self.enabled, 0x180),
            0x200..=0x20B => word(self.pending, 0x200),
            0x280..=0x28B => word(self.pending, 0x280),
            0x300..=0x30B => word(self.active, 0x300),
            0x400..=0x453 => self.priority_word((offset - 0x400) as u16 + number::FIRST_INTERRUPT),
            _ => return None,
        })
    }

    /// Writes the bytes in `lanes` of a register; `None` if there is none.
    pub(crate) fn write(&mut self, offset: u32, value: u32, lanes: u32) -> Option<()> {
        let bits = |base: u32| {
            let shift = (offset - base) * 8;
            (u128::from(value & lanes) << shift & ((1 << INTERRUPTS) - 1)) << number::FIRST_INTERRUPT
        };
        match offset {
            0x100..=0x10B => self.enabled |= bits(0x100),
            0x180..=0x18B => self.enabled &= !bits(0x180),
            0x200..=0x20B => self.pending |= bits(0x200),
            // A line that is still asserted keeps its interrupt pending.
            0x280..=0x28B => self.pending &= !(bits(0x280) & !(self.asserted & !self.active)),
            0x300..=0x30B => {}
            0x400..=0x453 => {
                self.write_priorities((offset - 0x400) as u16 + number::FIRST_INTERRUPT, value, lanes);
            }
            0xF00 => {
                self.pend(number::FIRST_INTERRUPT + (value & 0x7F).min(u32::from(INTERRUPTS) - 1) as u16)
            }
            _ => return None,
        }
        Some(())
    }

    /// The priorities of four exceptions, as IPR and SHPR show them.
    pub(crate) fn priority_word(&self, first: u16) -> u32 {
        u32::from_le_bytes([0, 1, 2, 3].map(|n| self.priority(first + n)))
    }

    /// Writes priorities as IPR and SHPR take them.
    pub(crate) fn write_priorities(&mut self, first: u16, value: u32, lanes: u32) {
        for (n, (byte, lane)) in value.to_le_bytes().into_iter().zip(lanes.to_le_bytes()).enumerate() {
            if lane != 0 {
                self.set_priority(first + n as u16, byte);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREE: Masks = Masks { primask: false, faultmask: false, basepri: 0 };

    fn nvic(priorities: &[(u16, u8)]) -> Nvic {
        let mut nvic = Nvic::new();
        for &(interrupt, priority) in priorities {
            nvic.enabled |= 1 << (16 + interrupt);
            nvic.set_priority(16 + interrupt, priority);
        }
        nvic
    }

    #[test]
    fn the_most_urgent_pre_empts_and_equals_wait() {
        let mut nvic = nvic(&[(3, 0x20), (5, 0x10), (7, 0x20)]);
        nvic.pend(16 + 7);
        nvic.pend(16 + 3);
        assert_eq!(nvic.to_take(FREE), Some(16 + 3));
        nvic.activate(16 + 3);
        assert_eq!(nvic.to_take(FREE), None);
        nvic.pend(16 + 5);
        assert_eq!(nvic.to_take(FREE), Some(16 + 5));
        nvic.activate(16 + 5);
        nvic.deactivate(16 + 5);
        nvic.deactivate(16 + 3);
        assert_eq!(nvic.to_take(FREE), Some(16 + 7));
    }

    #[test]
    fn masks_hold_interrupts_back_but_end_a_sleep() {
        let mut nvic = nvic(&[(3, 0x20)]);
        nvic.pend(16 + 3);
        assert_eq!(nvic.to_take(Masks { basepri: 0x20, ..FREE }), None);
        assert_eq!(nvic.to_take(Masks { basepri: 0x30, ..FREE }), Some(16 + 3));
        let masked = Masks { primask: true, ..FREE };
        assert_eq!(nvic.to_take(masked), None);
        assert!(nvic.wakes(masked));
        assert!(!nvic.wakes(Masks { basepri: 0x20, ..FREE }));
    }

    #[test]
    fn a_line_that_stays_asserted_pends_again() {
        let mut nvic = nvic(&[(3, 0)]);
        nvic.set_line(3, true);
        nvic.activate(16 + 3);
        nvic.set_line(3, true);
        assert!(!nvic.is_pending(16 + 3));
        nvic.deactivate(16 + 3);
        assert!(nvic.is_pending(16 + 3));
        nvic.set_line(3, false);
        assert_eq!(nvic.write(0x280, 1 << 3, u32::MAX), Some(()));
        assert!(!nvic.is_pending(16 + 3));
    }

    #[test]
    fn subpriorities_order_but_do_not_pre_empt() {
        let mut nvic = nvic(&[(3, 0x10), (4, 0x00)]);
        nvic.set_group(4); // bits 7..5 are the group
        nvic.activate(16 + 3);
        nvic.pend(16 + 4);
        assert_eq!(nvic.to_take(FREE), None);
        nvic.deactivate(16 + 3);
        nvic.pend(16 + 3);
        assert_eq!(nvic.to_take(FREE), Some(16 + 4));
    }

    #[test]
    fn priorities_are_written_byte_by_byte() {
        let mut nvic = Nvic::new();
        assert_eq!(nvic.write(0x400 + 28, 0x0055_0000, 0x00FF_0000), Some(()));
        assert_eq!(nvic.priority(16 + 30), 0x50);
        assert_eq!(nvic.read(0x400 + 28), Some(0x0050_0000));
        assert_eq!(nvic.read(0x500), None);
    }
}
