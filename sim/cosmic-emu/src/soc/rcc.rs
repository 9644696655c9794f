//! Reset and clock control (RM0090, chapter 7): oscillators are ready at once, the PLL is computed, the
//! prescalers give the clocks of CPU and timers, an access to a peripheral without clock is found out, and CSR
//! says by which resets the part came here.
//!
//! The crystal may fail. If the clock security system watches it, the core goes on by the internal oscillator, with an NMI
//! (7.2.7). If not, it is no longer ready, and that is all: what a PLL without its input does is not modelled.

use super::{CAN1, CAN2};
use crate::observation::ResetCause;

/// The internal oscillator.
const HSI_HERTZ: u32 = 16_000_000;

/// Registers up to DCKCFGR.
const WORDS: usize = 0x90 / 4;

/// Numbers of the registers, four bytes each.
mod register {
    pub(super) const CR: usize = 0;
    pub(super) const PLLCFGR: usize = 1;
    pub(super) const CFGR: usize = 0x08 / 4;
    pub(super) const CIR: usize = 0x0C / 4;
    pub(super) const AHB1RSTR: usize = 0x10 / 4;
    pub(super) const APB1RSTR: usize = 0x20 / 4;
    pub(super) const APB2RSTR: usize = 0x24 / 4;
    pub(super) const AHB1ENR: usize = 0x30 / 4;
    pub(super) const BDCR: usize = 0x70 / 4;
    pub(super) const CSR: usize = 0x74 / 4;
}

/// Bits of CR.
mod cr {
    pub(super) const HSI: u32 = 0b11;
    pub(super) const HSEON: u32 = 1 << 16;
    pub(super) const HSERDY: u32 = 1 << 17;
    pub(super) const CSSON: u32 = 1 << 19;
    /// On, and ready.
    pub(super) const PLL: u32 = 0b11 << 24;
}

/// Bits of PLLCFGR, CFGR and CIR.
const PLLSRC_HSE: u32 = 1 << 22;
const SW_SWS: u32 = 0xF;
const CSSF: u32 = 1 << 7;
const CSSC: u32 = 1 << 23;

/// Bits of CSR.
mod csr {
    pub(super) const RMVF: u32 = 1 << 24;
    pub(super) const PINRSTF: u32 = 1 << 26;
    pub(super) const SFTRSTF: u32 = 1 << 28;
    pub(super) const IWDGRSTF: u32 = 1 << 29;
    pub(super) const FLAGS: u32 = 0xFE00_0000;
    /// Power-on, brown-out and pin.
    pub(super) const AFTER_POWER_ON: u32 = 0x0E00_0000;
}

/// The clocks that follow from the registers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Clocks {
    /// CPU and AHB.
    pub(crate) hclk_hertz: u32,
    /// HCLK cycles of one period of PCLK1.
    pub(crate) apb1_divider: u32,
    /// HCLK cycles of one period of the timers on APB1: twice PCLK1, unless that is undivided.
    pub(crate) timer_divider: u32,
}

/// Reset and clock control.
#[derive(Clone, Debug)]
pub(crate) struct Rcc {
    words: [u32; WORDS],
    hse_hertz: u32,
    /// The crystal oscillates when it is asked to.
    crystal_runs: bool,
}

impl Rcc {
    /// After power-on, with a crystal of this frequency on the board, and whether it oscillates.
    pub(crate) const fn new(hse_hertz: u32, crystal_runs: bool) -> Self {
        let mut words = [0; WORDS];
        words[register::CR] = 0x0000_0083;
        words[register::PLLCFGR] = 0x2400_3010;
        words[register::AHB1ENR] = 0x0010_0000;
        // Power-on and pin reset flags.
        words[register::CSR] = csr::AFTER_POWER_ON;
        Self { words, hse_hertz, crystal_runs }
    }

    /// A reset that leaves the power on: the flags of the resets before stay until the software removes them. Each
    /// pulls the reset pin low, too (RM0090, 7.1.1).
    pub(crate) fn reset(&self, cause: ResetCause) -> Self {
        let mut new = Self::new(self.hse_hertz, self.crystal_runs);
        let flag = match cause {
            ResetCause::Pin => csr::PINRSTF,
            ResetCause::Software => csr::SFTRSTF,
            ResetCause::Watchdog => csr::IWDGRSTF,
        };
        new.words[register::CSR] = self.words[register::CSR] & csr::FLAGS | flag | csr::PINRSTF;
        new
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        self.words.get(offset as usize / 4).copied()
    }

    /// Writes a register. `None` if there is none.
    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        let index = offset as usize / 4;
        let slot = self.words.get_mut(index)?;
        *slot = match index {
            // Each ON bit is followed by its RDY bit: HSI, HSE, PLL, PLLI2S.
            register::CR => {
                let ready = (value & 0x0501_0001) << 1;
                value & !0x0A02_0002 | if self.crystal_runs { ready } else { ready & !cr::HSERDY }
            }
            // SWS follows SW.
            register::CFGR => value & !0xC | (value & 0x3) << 2,
            register::CIR => value & 0x3F00 | if value & CSSC == 0 { *slot & CSSF } else { 0 },
            register::BDCR => value & !0x2 | (value & 1) << 1,
            register::CSR => {
                let flags = if value & csr::RMVF != 0 { 0 } else { *slot & csr::FLAGS };
                flags | (value & 1) << 1 | value & 1
            }
            _ => value,
        };
        Some(())
    }

    /// The crystal begins to oscillate, or fails. Returns whether that is to be told by an NMI.
    pub(crate) fn set_crystal(&mut self, runs: bool) -> bool {
        self.crystal_runs = runs;
        let [control, configuration] = [register::CR, register::CFGR].map(|at| self.words[at]);
        if runs {
            self.words[register::CR] |= (control & cr::HSEON) << 1;
            return false;
        }
        self.words[register::CR] &= !cr::HSERDY;
        let watched = cr::HSERDY | cr::CSSON;
        if control & watched != watched {
            return false;
        }
        self.words[register::CR] &= !cr::HSEON;
        self.words[register::CIR] |= CSSF;
        let by_pll = self.words[register::PLLCFGR] & PLLSRC_HSE != 0;
        match configuration >> 2 & 3 {
            1 => {}
            2 if by_pll => self.words[register::CR] &= !cr::PLL,
            _ => return true,
        }
        self.words[register::CR] |= cr::HSI;
        self.words[register::CFGR] &= !SW_SWS;
        true
    }

    /// The clocks as set now.
    pub(crate) fn clocks(&self) -> Clocks {
        let cfgr = self.words[register::CFGR];
        let sysclk = match cfgr >> 2 & 3 {
            0 => HSI_HERTZ,
            1 => self.hse_hertz,
            _ => self.pll_hertz(),
        };
        let hpre = match cfgr >> 4 & 0xF {
            code @ 8..=11 => 2 << (code - 8),
            code @ 12..=15 => 64 << (code - 12),
            _ => 1,
        };
        let apb1_divider = match cfgr >> 10 & 7 {
            code @ 4..=7 => 2 << (code - 4),
            _ => 1,
        };
        // The timebase divides by it; a PLL that is set to nonsense stands still in reality.
        let hclk_hertz = (sysclk / hpre).max(1);
        Clocks {
            hclk_hertz,
            apb1_divider,
            timer_divider: if apb1_divider == 1 { 1 } else { apb1_divider / 2 },
        }
    }

    fn pll_hertz(&self) -> u32 {
        let pll = self.words[register::PLLCFGR];
        let source = if pll & PLLSRC_HSE != 0 { self.hse_hertz } else { HSI_HERTZ };
        let (m, n, p) = (pll & 0x3F, pll >> 6 & 0x1FF, ((pll >> 16 & 3) + 1) * 2);
        if m == 0 {
            return 0;
        }
        u32::try_from(u64::from(source) * u64::from(n) / u64::from(m) / u64::from(p)).unwrap_or(0)
    }

    /// Returns whether the peripheral at this address has its clock. Those without an enable bit always have.
    pub(crate) fn is_clocked(&self, address: u32) -> bool {
        let is_on = |address| match gate(address) {
            Some((bus, bit)) => self.words[register::AHB1ENR + bus] >> bit & 1 != 0,
            None => true,
        };
        // CAN2 reaches its memory through CAN1 (RM0090, dual CAN).
        is_on(address) && (!(CAN2..CAN2 + 0x400).contains(&address) || is_on(CAN1))
    }

    /// Returns whether the peripheral at this address is held in reset.
    pub(crate) fn is_in_reset(&self, address: u32) -> bool {
        match gate(address) {
            Some((bus, bit)) => self.words[register::AHB1RSTR + bus] >> bit & 1 != 0,
            None => false,
        }
    }
}

/// Enable and reset bit of the peripheral at an address, as register index from AHB1's and bit.
fn gate(address: u32) -> Option<(usize, u32)> {
    const APB1: usize = register::APB1RSTR - register::AHB1RSTR;
    const APB2: usize = register::APB2RSTR - register::AHB1RSTR;
    Some(match address {
        0x4002_0000..=0x4002_23FF => (0, (address - 0x4002_0000) / 0x400),
        // TIM2 to TIM14, in the order of their addresses.
        0x4000_0000..=0x4000_23FF => (APB1, (address - 0x4000_0000) / 0x400),
        CAN1..=0x4000_67FF => (APB1, 25),
        CAN2..=0x4000_6BFF => (APB1, 26),
        0x4000_7000..=0x4000_73FF => (APB1, 28),
        0x4001_3800..=0x4001_3BFF => (APB2, 14),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_clock_tree_of_an_f405() {
        let mut rcc = Rcc::new(8_000_000, true);
        let reset = Clocks { hclk_hertz: HSI_HERTZ, apb1_divider: 1, timer_divider: 1 };
        assert_eq!(rcc.clocks(), reset);
        rcc.write(0x00, 0x0101_0083).unwrap();
        assert_eq!(rcc.read(0x00), Some(0x0303_0083));
        // M 4, N 168, P 2, source HSE; PPRE1 4, PPRE2 2; SW PLL.
        rcc.write(0x04, 1 << 22 | 168 << 6 | 4).unwrap();
        rcc.write(0x08, 4 << 13 | 5 << 10 | 2).unwrap();
        let fast = Clocks { hclk_hertz: 168_000_000, apb1_divider: 4, timer_divider: 2 };
        assert_eq!(rcc.clocks(), fast);
        assert_eq!(rcc.read(0x08).map(|cfgr| cfgr >> 2 & 3), Some(2));
    }

    #[test]
    fn a_crystal_that_fails() {
        let running = || {
            let mut rcc = Rcc::new(8_000_000, true);
            for (register, value) in
                [(0x00, 0x0101_0083), (0x04, 1 << 22 | 168 << 6 | 4), (0x08, 5 << 10 | 2)]
            {
                rcc.write(register, value).unwrap();
            }
            rcc
        };
        let mut unwatched = running();
        assert!(!unwatched.set_crystal(false));
        assert_eq!((unwatched.read(0x00), unwatched.read(0x0C)), (Some(0x0301_0083), Some(0)));

        let mut rcc = running();
        rcc.write(0x00, 0x0109_0083).unwrap();
        assert!(rcc.set_crystal(false));
        // By the internal oscillator; crystal and PLL are off, and CSSF stays until CSSC.
        assert_eq!((rcc.read(0x00), rcc.read(0x08)), (Some(0x0008_0083), Some(5 << 10)));
        assert_eq!(rcc.clocks().hclk_hertz, HSI_HERTZ);
        rcc.write(0x0C, 0).unwrap();
        assert_eq!(rcc.read(0x0C), Some(CSSF));
        rcc.write(0x0C, CSSC).unwrap();
        assert_eq!(rcc.read(0x0C), Some(0));

        // A reset does not mend it; it is ready when it oscillates.
        let mut rcc = rcc.reset(ResetCause::Software);
        rcc.write(0x00, 0x0001_0083).unwrap();
        assert_eq!(rcc.read(0x00), Some(0x0001_0083));
        assert!(!rcc.set_crystal(true));
        assert_eq!(rcc.read(0x00), Some(0x0003_0083));
    }

    #[test]
    fn the_flags_of_resets_add_up_until_they_are_removed() {
        let csr = |rcc: &Rcc| rcc.read(0x74).unwrap();
        let mut rcc = Rcc::new(8_000_000, true);
        assert_eq!(csr(&rcc), 0x0E00_0000);
        // They are read-only, but for RMVF.
        rcc.write(0x74, 0xF000_0001).unwrap();
        assert_eq!(csr(&rcc), 0x0E00_0003);
        rcc = rcc.reset(ResetCause::Software);
        assert_eq!(csr(&rcc), 0x1E00_0000);
        rcc.write(0x74, 1 << 24).unwrap();
        assert_eq!(csr(&rcc), 0);
        assert_eq!(csr(&rcc.reset(ResetCause::Pin)), 0x0400_0000);
        rcc = rcc.reset(ResetCause::Watchdog);
        assert_eq!(csr(&rcc), 0x2400_0000);
        assert_eq!(rcc.read(0x30), Some(0x0010_0000), "the clocks are as after power-on");
    }

    #[test]
    fn clock_gates() {
        let mut rcc = Rcc::new(8_000_000, true);
        assert!(!rcc.is_clocked(0x4000_6400));
        rcc.write(0x40, 1 << 25).unwrap();
        assert!(rcc.is_clocked(0x4000_6400) && !rcc.is_clocked(0x4000_6800));
        rcc.write(0x40, 1 << 26).unwrap();
        assert!(!rcc.is_clocked(0x4000_6800), "CAN2 needs the clock of CAN1, too");
        rcc.write(0x40, 1 << 26 | 1 << 25).unwrap();
        assert!(rcc.is_clocked(0x4000_6800));
        rcc.write(0x20, 1).unwrap();
        assert!(rcc.is_in_reset(0x4000_0024));
        assert!(rcc.is_clocked(0x4002_3C00));
        assert_eq!(rcc.read(0x400), None);
    }
}
