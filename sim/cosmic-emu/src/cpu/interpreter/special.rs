//! Special registers and interrupt masks (ARMv7-M ARM, B5.2).

use super::{CONTROL_FPCA, CONTROL_SPSEL, Flags, Interpreter};
use crate::cpu::{Cpu as _, Register};

/// Numbers of the special registers in MRS and MSR.
mod number {
    pub(super) const MSP: u8 = 8;
    pub(super) const PSP: u8 = 9;
    pub(super) const PRIMASK: u8 = 16;
    pub(super) const BASEPRI: u8 = 17;
    pub(super) const BASEPRI_MAX: u8 = 18;
    pub(super) const FAULTMASK: u8 = 19;
    pub(super) const CONTROL: u8 = 20;
}

const IPSR: u32 = 0x1FF;
const NOTHING_MASKED: u16 = 256;
const APSR: u32 = 0xF80F_0000;

impl Interpreter {
    pub(super) fn read_special(&self, special: u8) -> u32 {
        match special {
            // Combinations of APSR (bit 2 clear) and IPSR (bit 0); EPSR reads as zero.
            0..=7 => {
                let mask = if special & 4 == 0 { APSR } else { 0 } | if special & 1 != 0 { IPSR } else { 0 };
                self.xpsr() & mask
            }
            number::MSP => self.register(Register::Msp),
            number::PSP => self.register(Register::Psp),
            number::PRIMASK => self.primask.into(),
            number::BASEPRI | number::BASEPRI_MAX => self.basepri.into(),
            number::FAULTMASK => self.faultmask.into(),
            number::CONTROL => self.control,
            _ => 0,
        }
    }

    /// `mask` says which part of APSR: bit 1 the flags, bit 0 GE.
    pub(super) fn write_special(&mut self, special: u8, mask: u8, value: u32) {
        match special {
            0..=3 => {
                let written = Flags::from_xpsr(value);
                let ge = if mask & 1 != 0 { written.ge } else { self.flags.ge };
                self.flags = if mask & 2 != 0 { Flags { ge, ..written } } else { Flags { ge, ..self.flags } };
            }
            number::MSP => self.set_register(Register::Msp, value & !3),
            number::PSP => self.set_register(Register::Psp, value & !3),
            number::PRIMASK => self.primask = value & 1 != 0,
            number::BASEPRI => self.basepri = value as u8,
            // Only ever raises the priority.
            number::BASEPRI_MAX => {
                let value = value as u8;
                if value != 0 && (value < self.basepri || self.basepri == 0) {
                    self.basepri = value;
                }
            }
            number::FAULTMASK => self.faultmask = value & 1 != 0,
            number::CONTROL => self.set_control(value),
            _ => {}
        }
        if special >= number::PRIMASK {
            self.masks_change();
        }
    }

    pub(super) fn change_masks(&mut self, disable: bool, primask: bool, faultmask: bool) {
        self.primask = if primask { disable } else { self.primask };
        self.faultmask = if faultmask { disable } else { self.faultmask };
        self.masks_change();
    }

    fn masks_change(&self) {
        let ceiling = match self.basepri {
            _ if self.primask || self.faultmask => 0,
            0 => NOTHING_MASKED,
            basepri => basepri.into(),
        };
        self.pace.masks_change(ceiling, self.ipsr as u16);
    }

    /// In handler mode the stack selection cannot be written.
    pub(super) fn set_control(&mut self, value: u32) {
        let writable = if self.ipsr == 0 { 1 | CONTROL_SPSEL | CONTROL_FPCA } else { 1 | CONTROL_FPCA };
        self.reselect_stack(|core| core.control = core.control & !writable | value & writable);
    }
}
