//! The parts of an STM32F405 around the core: address map, clocks, peripherals, interrupt lines.
//!
//! All of it counts in HCLK cycles. What a peripheral does by itself between two accesses is computed
//! when it is next looked at ([`System::advance`]); [`System::deadline`] says when that must be.
//!
//! Whatever the firmware accesses that is not modelled is reported, with a list of known exceptions:
//! [`Storage`].

pub(crate) mod can;
mod gpio;
mod nvic;
mod power;
mod rcc;
mod storage;
mod system_control;
mod timer;
mod watchdog;

use std::collections::BTreeSet;
use std::rc::Rc;

use crate::clock::{ClockError, Timebase};
use crate::cpu::{AccessKind, Io, Pace};
use crate::observation::ResetCause;
use can::{CanController, CanPair};
use cosmic_bus::VirtualInstant;
use gpio::Port;
pub(crate) use nvic::{Masks, Nvic, number};
use power::Power;
use rcc::{Clocks, Rcc};
use storage::Storage;
use system_control::{Effect, SystemControl};
use timer::Timer;
use watchdog::IndependentWatchdog;

const PERIPHERALS: u32 = 0x4000_0000;
const BIT_BAND: u32 = 0x4200_0000;
const PRIVATE: u32 = 0xE000_0000;
/// Interrupts of TIM2 to TIM5 (RM0090, table 62).
const TIMER_INTERRUPTS: [u16; 4] = [28, 29, 30, 50];
const IWDG: u32 = 0x4000_3000;
const CAN1: u32 = 0x4000_6400;
const CAN2: u32 = 0x4000_6800;

/// What stands around a part on its board.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Wiring {
    /// Of the crystal, and of what is derived from it.
    pub(crate) error: ClockError,
    pub(crate) crystal_hertz: u32,
    pub(crate) crystal_runs: bool,
    pub(crate) supply_is_low: bool,
    pub(crate) low_speed_hertz: u32,
    /// Where the transceiver is.
    pub(crate) can: CanController,
}

/// Something that happened in a node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Happening {
    pub(crate) at: VirtualInstant,
    pub(crate) instructions: u64,
    pub(crate) kind: HappeningKind,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum HappeningKind {
    /// An output pin changed: port (0 is A), pin, level.
    Pin(u8, u8, bool),
    /// An access to something that is not modelled; reported once for each place in the program.
    NotModelled { access: AccessKind, address: u32, pc: u32 },
    /// An access to a peripheral whose clock is off; it has no effect.
    NotClocked { access: AccessKind, address: u32, pc: u32 },
}

/// Everything in the part but core and memories.
pub(crate) struct System {
    pace: Rc<Pace>,
    pub(crate) timebase: Timebase,
    pub(crate) nvic: Nvic,
    pub(crate) control: SystemControl,
    pub(crate) can: CanPair,
    rcc: Rcc,
    power: Power,
    timers: [Timer; 4],
    ports: [Port; 9],
    storage: Storage,
    watchdog: IndependentWatchdog,
    /// When the watchdog resets the part, as a cycle.
    watchdog_deadline: Option<u64>,
    happenings: Vec<Happening>,
    /// Accesses that were reported: write, address, PC.
    reported: BTreeSet<(bool, u32, u32)>,
    /// The part is to be reset.
    pub(crate) reset_requested: Option<ResetCause>,
    /// HCLK has changed, so the horizon is at another cycle.
    clock_changed: bool,
    /// The end of the present run, before which the node need not stop for others.
    horizon: u64,
}

impl System {
    /// After power-on at `start`.
    pub(crate) fn new(pace: &Rc<Pace>, start: VirtualInstant, wiring: Wiring) -> Self {
        Self::with_clocks(pace, start, wiring, Rcc::new(wiring.crystal_hertz, wiring.crystal_runs))
    }

    /// After a reset at `start` that leaves the power on.
    pub(crate) fn reset(
        &self,
        pace: &Rc<Pace>,
        start: VirtualInstant,
        wiring: Wiring,
        cause: ResetCause,
    ) -> Self {
        Self::with_clocks(pace, start, wiring, self.rcc.reset(cause))
    }

    fn with_clocks(pace: &Rc<Pace>, start: VirtualInstant, wiring: Wiring, rcc: Rcc) -> Self {
        let Wiring { error, low_speed_hertz, supply_is_low, can: wired, .. } = wiring;
        Self {
            pace: Rc::clone(pace),
            timebase: Timebase::new(start, rcc.clocks().hclk_hertz, error),
            nvic: Nvic::new(),
            control: SystemControl::new(),
            can: CanPair::new(wired),
            rcc,
            power: Power::new(supply_is_low),
            timers: [u32::MAX, 0xFFFF, 0xFFFF, u32::MAX].map(Timer::new),
            ports: core::array::from_fn(|port| match port {
                0 => Port::new(0xA800_0000, 0x6400_0000),
                1 => Port::new(0x0000_0280, 0x0000_0100),
                _ => Port::new(0, 0),
            }),
            storage: Storage::new(),
            watchdog: IndependentWatchdog::new(low_speed_hertz),
            watchdog_deadline: None,
            happenings: Vec::new(),
            reported: BTreeSet::new(),
            reset_requested: None,
            clock_changed: false,
            horizon: 0,
        }
    }

    /// Present time.
    pub(crate) fn now(&self) -> VirtualInstant {
        self.timebase.instant(self.pace.cycle())
    }

    /// The bit rate that the firmware set in the controller that is on the bus, in bits per second, rounded.
    pub(crate) fn can_bits_per_second(&self) -> u32 {
        let clocks = self.rcc.clocks();
        clocks.hclk_hertz / clocks.apb1_divider / self.can.wired().bit_timing().periods
    }

    /// What TIM2 shows, and since when; `None` while it stands.
    pub(crate) fn tim2(&mut self) -> Option<(u32, VirtualInstant)> {
        self.advance();
        let (count, since) = self.timers.first()?.reading()?;
        Some((count, self.timebase.instant(since)))
    }

    /// What happened since the last call.
    pub(crate) fn take_happenings(&mut self) -> Vec<Happening> {
        std::mem::take(&mut self.happenings)
    }

    /// Brings all peripherals up to the present, and their interrupts into the NVIC.
    pub(crate) fn advance(&mut self) {
        let now = self.pace.cycle();
        for timer in &mut self.timers {
            timer.advance(now);
        }
        self.can.advance(now);
        if self.control.advance(now) {
            self.nvic.pend(number::SYS_TICK);
        }
        if self.watchdog_deadline.is_some_and(|deadline| deadline <= now) {
            self.reset_requested = Some(ResetCause::Watchdog);
        }
        self.update_lines();
    }

    /// The cycle at which a peripheral acts next by itself.
    pub(crate) fn deadline(&self) -> Option<u64> {
        let timers = self.timers.iter().filter_map(Timer::deadline);
        let others = self.can.deadline().into_iter().chain(self.control.deadline());
        timers.chain(others).chain(self.watchdog_deadline).min()
    }

    /// The cycle at which the watchdog resets the part, unless it is fed before.
    pub(crate) const fn watchdog_deadline(&self) -> Option<u64> {
        self.watchdog_deadline
    }

    /// After a change of the watchdog or of the core's clock.
    fn update_watchdog(&mut self) {
        self.watchdog_deadline = self.watchdog.expires_at().map(|at| self.timebase.cycle_at(at));
    }

    /// The core is to run until `horizon` at most. Sets the limit of the pace.
    pub(crate) fn set_horizon(&mut self, horizon: u64) {
        self.horizon = horizon;
        self.clock_changed = false;
        self.update_limit();
    }

    /// Returns whether the node must stop because others have to act first.
    pub(crate) fn must_stop(&self) -> bool {
        self.can.wired().waits_for_bus() || self.reset_requested.is_some()
    }

    fn update_limit(&self) {
        self.pace.set_limit(self.deadline().map_or(self.horizon, |deadline| deadline.min(self.horizon)));
    }

    pub(crate) fn update_lines(&mut self) {
        for (timer, interrupt) in self.timers.iter().zip(TIMER_INTERRUPTS) {
            self.nvic.set_line(interrupt, timer.interrupt());
        }
        self.nvic.set_line(power::INTERRUPT, self.power.interrupt());
        for (interrupt, asserted) in self.can.interrupts() {
            self.nvic.set_line(interrupt, asserted);
        }
    }

    /// After a write: new deadlines, and a stop if the run loop has something to do.
    fn settle(&mut self) {
        self.update_lines();
        self.update_limit();
        if self.nvic.any_pending() || self.must_stop() || self.clock_changed {
            self.pace.stop_soon();
        }
    }

    fn read_word(&mut self, address: u32) -> Option<u32> {
        let offset = address & 0x3FF;
        match address {
            0xE000_E100..=0xE000_E4FF => self.nvic.read(address - 0xE000_E000),
            _ if Storage::keeps(address) => self.storage.read(address),
            PRIVATE..=u32::MAX => self.control.read(self.pace.cycle(), address - PRIVATE, &self.nvic),
            0x4000_0000..=0x4000_0FFF => self.timers[timer_at(address)].read(offset),
            IWDG..=0x4000_33FF => self.watchdog.read(offset),
            power::PWR..=0x4000_73FF | power::EXTI..=0x4001_3FFF => self.power.read(address),
            CAN1..=0x4000_6BFF => self.can.read(controller_at(address), offset),
            0x4002_0000..=0x4002_23FF => self.ports[port_at(address)].read(offset),
            0x4002_3800..=0x4002_3BFF => self.rcc.read(offset),
            _ => None,
        }
    }

    /// Writes the bytes in `lanes` of a register. `Err` if it is not modelled.
    fn write_word(&mut self, address: u32, value: u32, lanes: u32) -> Result<(), ()> {
        let (now, offset) = (self.pace.cycle(), address & 0x3FF);
        match address {
            0xE000_E100..=0xE000_E4FF | 0xE000_EF00 => {
                self.nvic.write(address - 0xE000_E000, value, lanes).ok_or(())
            }
            _ if Storage::keeps(address) => self.storage.write(address, value),
            PRIVATE..=u32::MAX => {
                match self.control.write(now, address - PRIVATE, value, lanes, &mut self.nvic) {
                    Effect::Stored => Ok(()),
                    Effect::NotModelled => Err(()),
                    Effect::Reset => {
                        self.reset_requested = Some(ResetCause::Software);
                        Ok(())
                    }
                }
            }
            0x4000_0000..=0x4000_0FFF => {
                self.timers[timer_at(address)].write(now, offset, value).map_err(|_| ())
            }
            IWDG..=0x4000_33FF => {
                self.watchdog.write(self.now(), offset, value).ok_or(())?;
                self.update_watchdog();
                Ok(())
            }
            power::PWR..=0x4000_73FF | power::EXTI..=0x4001_3FFF => {
                self.power.write(address, value).ok_or(())
            }
            CAN1..=0x4000_6BFF => self.can.write(controller_at(address), now, offset, value).map_err(|_| ()),
            0x4002_0000..=0x4002_23FF => self.write_port(port_at(address), offset, value),
            0x4002_3800..=0x4002_3BFF => self.write_rcc(offset, value),
            _ => Err(()),
        }
    }

    fn write_port(&mut self, port: usize, offset: u32, value: u32) -> Result<(), ()> {
        let edges = self.ports[port].write(offset, value).ok_or(())?;
        for pin in (0..16).filter(|pin| edges.pins >> pin & 1 != 0) {
            self.happen(HappeningKind::Pin(port as u8, pin, edges.levels >> pin & 1 != 0));
        }
        Ok(())
    }

    fn write_rcc(&mut self, offset: u32, value: u32) -> Result<(), ()> {
        let before = self.rcc.clocks();
        self.rcc.write(offset, value).ok_or(())?;
        self.follow_clocks(before);
        Ok(())
    }

    /// The crystal begins to oscillate, or fails.
    pub(crate) fn set_crystal(&mut self, runs: bool) {
        self.advance();
        let before = self.rcc.clocks();
        if self.rcc.set_crystal(runs) {
            self.nvic.pend(number::NMI);
        }
        self.follow_clocks(before);
    }

    /// The supply sinks below the threshold of the voltage detector, or rises above it.
    pub(crate) fn set_supply(&mut self, is_low: bool) {
        self.advance();
        self.power.set_supply(is_low);
        self.update_lines();
    }

    /// After a change of RCC: what depends on its clocks and resets.
    fn follow_clocks(&mut self, before: Clocks) {
        let (now, clocks) = (self.pace.cycle(), self.rcc.clocks());
        if clocks.hclk_hertz != before.hclk_hertz {
            self.timebase.change_frequency(now, clocks.hclk_hertz);
            self.clock_changed = true;
            self.update_watchdog();
        }
        for (n, timer) in self.timers.iter_mut().enumerate() {
            timer.set_input_period(now, clocks.timer_divider.into());
            if self.rcc.is_in_reset(PERIPHERALS + 0x400 * n as u32) {
                timer.reset();
            }
        }
        self.can.set_clock_period(clocks.apb1_divider.into());
        for (which, address) in CanController::BOTH.into_iter().zip([CAN1, CAN2]) {
            if self.rcc.is_in_reset(address) {
                self.can.reset(which, now);
            }
        }
    }

    fn happen(&mut self, kind: HappeningKind) {
        let (at, instructions) = (self.now(), self.pace.instructions());
        self.happenings.push(Happening { at, instructions, kind });
    }

    /// Reports an access, once for each instruction that makes it.
    fn report(&mut self, access: AccessKind, address: u32, kind: fn(AccessKind, u32, u32) -> HappeningKind) {
        let pc = self.pace.pc();
        if self.reported.insert((access == AccessKind::Write, address, pc)) {
            self.happen(kind(access, address, pc));
        }
    }

    fn report_not_modelled(&mut self, access: AccessKind, address: u32) {
        self.report(access, address, |access, address, pc| HappeningKind::NotModelled {
            access,
            address,
            pc,
        });
    }

    /// Reads a word, or reports that it cannot be read.
    fn load(&mut self, address: u32) -> u32 {
        self.advance();
        if !self.rcc.is_clocked(address) {
            self.report(AccessKind::Read, address, |access, address, pc| HappeningKind::NotClocked {
                access,
                address,
                pc,
            });
            return 0;
        }
        self.read_word(address).unwrap_or_else(|| {
            self.report_not_modelled(AccessKind::Read, address);
            0
        })
    }

    fn store(&mut self, address: u32, value: u32, lanes: u32) {
        self.advance();
        if !self.rcc.is_clocked(address) {
            self.report(AccessKind::Write, address, |access, address, pc| HappeningKind::NotClocked {
                access,
                address,
                pc,
            });
            return;
        }
        if self.write_word(address, value, lanes).is_err() {
            self.report_not_modelled(AccessKind::Write, address);
        }
        self.settle();
    }
}

impl Io for System {
    fn read(&mut self, address: u32, size: usize) -> u32 {
        if let Some((word, bit)) = bit_band(address) {
            return self.load(word) >> bit & 1;
        }
        let shift = 8 * (address & 3);
        self.load(address & !3) >> shift & mask(size)
    }

    fn write(&mut self, address: u32, size: usize, value: u32) {
        if let Some((word, bit)) = bit_band(address) {
            let others = self.load(word) & !(1 << bit);
            self.store(word, others | (value & 1) << bit, u32::MAX);
            return;
        }
        let (word, shift) = (address & !3, 8 * (address & 3));
        let lanes = mask(size) << shift;
        let value = value << shift & lanes;
        // The NVIC knows byte accesses; elsewhere the other bytes are written back as they read, except
        // where writing has an effect of its own: those registers read as 0 (BSRR, EGR).
        let others = if lanes == u32::MAX || address >= PRIVATE { 0 } else { self.load(word) & !lanes };
        self.store(word, others | value, lanes);
    }
}

/// The word and bit behind an address of the bit-band alias.
fn bit_band(address: u32) -> Option<(u32, u32)> {
    let offset = address.checked_sub(BIT_BAND).filter(|offset| *offset < 0x0200_0000)?;
    let bit = offset / 4;
    Some((PERIPHERALS + bit / 32 * 4, bit % 32))
}

const fn mask(size: usize) -> u32 {
    match size {
        1 => 0xFF,
        2 => 0xFFFF,
        _ => u32::MAX,
    }
}

const fn timer_at(address: u32) -> usize {
    (address - PERIPHERALS) as usize / 0x400 % 4
}

const fn controller_at(address: u32) -> CanController {
    if address < CAN2 { CanController::Can1 } else { CanController::Can2 }
}

const fn port_at(address: u32) -> usize {
    (address - 0x4002_0000) as usize / 0x400 % 9
}

#[cfg(test)]
mod tests;
