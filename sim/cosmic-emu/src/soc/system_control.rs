//! System control block, SysTick, cycle counter and debug registers of the core (ARMv7-M ARM, B3 and C1).

use super::nvic::{Nvic, number};

const AIRCR_KEY: u32 = 0x05FA;
const AIRCR_SYSRESETREQ: u32 = 1 << 2;
const CPUID_CORTEX_M4: u32 = 0x410F_C241;
const SCR_SLEEPONEXIT: u32 = 1 << 1;
const SCR_SLEEPDEEP: u32 = 1 << 2;
/// Frames are aligned to eight bytes.
const CCR_STKALIGN: u32 = 1 << 9;

/// The effect of a write that others must know of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Effect {
    /// None.
    Stored,
    /// The register or the setting is not modelled.
    NotModelled,
    /// The firmware asked for a system reset.
    Reset,
}

/// SCB, SysTick, DWT and DCB registers.
#[derive(Clone, Debug)]
pub(crate) struct SystemControl {
    pub(crate) vtor: u32,
    scr: u32,
    ccr: u32,
    shcsr: u32,
    cpacr: u32,
    /// FPCCR, FPCAR, FPDSCR.
    fpu: [u32; 3],
    demcr: u32,
    dwt_control: u32,
    /// The cycle at which CYCCNT was 0.
    cycle_origin: u64,
    systick: SysTick,
}

#[derive(Clone, Debug, Default)]
struct SysTick {
    control: u32,
    reload: u32,
    /// The count while it stands still.
    count: u32,
    /// When the counter reaches 0 next, while it runs.
    zero_at: u64,
    passed_zero: bool,
}

impl SystemControl {
    pub(crate) const fn new() -> Self {
        Self {
            vtor: 0,
            scr: 0,
            ccr: CCR_STKALIGN,
            shcsr: 0,
            cpacr: 0,
            fpu: [0xC000_0000, 0, 0],
            demcr: 0,
            dwt_control: 0x4000_0000,
            cycle_origin: 0,
            systick: SysTick { control: 0, reload: 0, count: 0, zero_at: 0, passed_zero: false },
        }
    }

    /// SCR.SLEEPONEXIT: sleep when the last handler returns.
    pub(crate) const fn sleeps_on_exit(&self) -> bool {
        self.scr & SCR_SLEEPONEXIT != 0
    }

    /// CCR.STKALIGN.
    pub(crate) const fn aligns_stack(&self) -> bool {
        self.ccr & CCR_STKALIGN != 0
    }

    /// When [`SystemControl::advance`] must be called next.
    pub(crate) fn deadline(&self) -> Option<u64> {
        (self.systick.runs() && self.systick.control & SysTick::TICKINT != 0).then_some(self.systick.zero_at)
    }

    /// Time has passed. Returns whether the SysTick exception is to be pended.
    pub(crate) fn advance(&mut self, now: u64) -> bool {
        self.systick.advance(now)
    }

    /// Reads a register at an offset from 0xE000_0000. `None` if it is not modelled.
    pub(crate) fn read(&mut self, now: u64, offset: u32, nvic: &Nvic) -> Option<u32> {
        Some(match offset {
            0x1000 => self.dwt_control,
            0x1004 => now.wrapping_sub(self.cycle_origin) as u32,
            0xE004 => 2, // ICTR: up to 96 interrupts
            0xE010 => self.systick.read_control(),
            0xE014 => self.systick.reload,
            0xE018 => self.systick.count(now),
            0xE01C => 0xC000_0000, // no reference clock, no calibration
            0xED00 => CPUID_CORTEX_M4,
            0xED04 => icsr(nvic),
            0xED08 => self.vtor,
            0xED0C => 0xFA05_0000 | u32::from(nvic.group()) << 8,
            0xED10 => self.scr,
            0xED14 => self.ccr,
            0xED18..=0xED23 => nvic.priority_word((offset - 0xED18) as u16 + 4),
            0xED24 => self.shcsr,
            // No fault is ever pending: a fault ends the node.
            0xED28 | 0xED2C | 0xED30 | 0xED34 | 0xED38 | 0xED3C => 0,
            // Main and single-precision FP extension registers (MVFR0, MVFR1), as Cortex-M4F.
            0xEF40 => 0x1011_0021,
            0xEF44 => 0x1100_0011,
            0xED88 => self.cpacr,
            0xED90 => 0x0800, // MPU_TYPE: 8 regions
            0xEDF0 => 0,      // no debugger is attached
            0xEDFC => self.demcr,
            0xEF34..=0xEF3F => self.fpu[(offset as usize - 0xEF34) / 4],
            _ => return None,
        })
    }

    /// Writes a register at an offset from 0xE000_0000.
    pub(crate) fn write(&mut self, now: u64, offset: u32, value: u32, lanes: u32, nvic: &mut Nvic) -> Effect {
        match offset {
            0x1000 => {
                self.dwt_control = value;
                // CYCCNTENA is the only thing that counts here.
                if value & 0x0FFF_FFFE != 0 {
                    return Effect::NotModelled;
                }
            }
            0x1004 => self.cycle_origin = now.wrapping_sub(u64::from(value)),
            // Unlocking the DWT (LAR) is not needed on this part, and harmless.
            0x1FB0 => {}
            0xE010 => self.systick.write_control(now, value),
            0xE014 => self.systick.reload = value & 0x00FF_FFFF,
            0xE018 => self.systick.clear(now),
            0xED04 => write_icsr(value, nvic),
            0xED08 => self.vtor = value & 0xFFFF_FF80,
            0xED0C => return write_aircr(value, nvic),
            0xED10 => {
                self.scr = value & 0x16;
                if value & SCR_SLEEPDEEP != 0 {
                    return Effect::NotModelled;
                }
            }
            0xED14 => self.ccr = value,
            0xED18..=0xED23 => nvic.write_priorities((offset - 0xED18) as u16 + 4, value, lanes),
            // CpuFault enables: faults end the node whether enabled or not.
            0xED24 => self.shcsr = value & 0x0007_0000,
            0xED28 | 0xED2C | 0xED30 => {}
            0xED88 => self.cpacr = value,
            0xEDFC => self.demcr = value,
            0xEF34..=0xEF3F => self.fpu[(offset as usize - 0xEF34) / 4] = value,
            _ => return Effect::NotModelled,
        }
        Effect::Stored
    }
}

fn icsr(nvic: &Nvic) -> u32 {
    let flag = |exception: u16, bit: u32| if nvic.is_pending(exception) { 1 << bit } else { 0 };
    let next = u32::from(nvic.most_urgent_pending().unwrap_or(0)) << 12;
    u32::from(nvic.current())
        | next
        | flag(number::SYS_TICK, 26)
        | flag(number::PEND_SV, 28)
        | flag(number::NMI, 31)
}

fn write_icsr(value: u32, nvic: &mut Nvic) {
    let bit = |n: u32| value >> n & 1 != 0;
    let pairs = [(number::PEND_SV, 28, 27), (number::SYS_TICK, 26, 25)];
    for (exception, set, clear) in pairs {
        if bit(set) {
            nvic.pend(exception);
        } else if bit(clear) {
            nvic.unpend(exception);
        }
    }
    if bit(31) {
        nvic.pend(number::NMI);
    }
}

fn write_aircr(value: u32, nvic: &mut Nvic) -> Effect {
    if value >> 16 != AIRCR_KEY {
        return Effect::Stored;
    }
    nvic.set_group((value >> 8) as u8);
    if value & AIRCR_SYSRESETREQ != 0 { Effect::Reset } else { Effect::Stored }
}

impl SysTick {
    const ENABLE: u32 = 1 << 0;
    const TICKINT: u32 = 1 << 1;
    /// Processor clock; else HCLK / 8.
    const CLKSOURCE: u32 = 1 << 2;
    const COUNTFLAG: u32 = 1 << 16;

    const fn runs(&self) -> bool {
        self.control & Self::ENABLE != 0 && self.reload != 0
    }

    const fn tick(&self) -> u64 {
        if self.control & Self::CLKSOURCE != 0 { 1 } else { 8 }
    }

    const fn period(&self) -> u64 {
        (self.reload as u64 + 1) * self.tick()
    }

    fn advance(&mut self, now: u64) -> bool {
        if !self.runs() || now < self.zero_at {
            return false;
        }
        let periods = (now - self.zero_at) / self.period() + 1;
        self.zero_at += periods * self.period();
        self.passed_zero = true;
        self.control & Self::TICKINT != 0
    }

    fn count(&self, now: u64) -> u32 {
        if !self.runs() {
            return self.count;
        }
        let left = self.zero_at.saturating_sub(now).div_ceil(self.tick());
        // At the zero itself the counter reads 0, one tick later the reload value.
        (left % (u64::from(self.reload) + 1)) as u32
    }

    fn read_control(&mut self) -> u32 {
        let flag = if self.passed_zero { Self::COUNTFLAG } else { 0 };
        self.passed_zero = false;
        self.control | flag
    }

    fn write_control(&mut self, now: u64, value: u32) {
        self.count = self.count(now);
        self.control = value & 7;
        // A count of 0 loads the reload value with the first tick.
        let left = if self.count == 0 { u64::from(self.reload) + 1 } else { u64::from(self.count) };
        self.zero_at = now + left * self.tick();
    }

    fn clear(&mut self, now: u64) {
        self.count = 0;
        self.passed_zero = false;
        self.zero_at = now + self.period();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systick_counts_down_and_reloads() {
        let (mut control, mut nvic) = (SystemControl::new(), Nvic::new());
        let mut write = |control: &mut SystemControl, offset, value| {
            assert_eq!(control.write(1000, offset, value, u32::MAX, &mut nvic), Effect::Stored);
        };
        write(&mut control, 0xE014, 99);
        write(&mut control, 0xE018, 0);
        write(&mut control, 0xE010, 7);
        assert_eq!(control.deadline(), Some(1100));
        let nvic = Nvic::new();
        assert_eq!(control.read(1001, 0xE018, &nvic), Some(99));
        assert!(!control.advance(1099));
        assert!(control.advance(1100));
        assert_eq!(control.deadline(), Some(1200));
        assert_eq!(control.read(1100, 0xE010, &nvic), Some(0x1_0007));
        assert_eq!(control.read(1100, 0xE010, &nvic), Some(7));
    }

    #[test]
    fn the_cycle_counter_counts_and_can_be_set() {
        let (mut control, mut nvic) = (SystemControl::new(), Nvic::new());
        assert_eq!(control.read(500, 0x1004, &nvic), Some(500));
        assert_eq!(control.write(600, 0x1004, 5, u32::MAX, &mut nvic), Effect::Stored);
        assert_eq!(control.read(700, 0x1004, &nvic), Some(105));
    }

    #[test]
    fn reset_needs_the_key() {
        let (mut control, mut nvic) = (SystemControl::new(), Nvic::new());
        let mut aircr = |value| control.write(0, 0xED0C, value, u32::MAX, &mut nvic);
        assert_eq!(aircr(AIRCR_SYSRESETREQ), Effect::Stored);
        assert_eq!(aircr(AIRCR_KEY << 16 | AIRCR_SYSRESETREQ), Effect::Reset);
    }

    #[test]
    fn pend_sv_by_icsr() {
        let (mut control, mut nvic) = (SystemControl::new(), Nvic::new());
        control.write(0, 0xED04, 1 << 28, u32::MAX, &mut nvic);
        assert!(nvic.is_pending(number::PEND_SV));
        assert_eq!(control.read(0, 0xED04, &nvic), Some(1 << 28 | 14 << 12));
        control.write(0, 0xED04, 1 << 27, u32::MAX, &mut nvic);
        assert!(!nvic.any_pending());
    }
}
