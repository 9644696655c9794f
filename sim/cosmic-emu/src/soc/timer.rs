//! General-purpose timers TIM2 to TIM5 (RM0090, chapter 18): up-counting with prescaler, update event,
//! four compare channels and their interrupts.
//!
//! Nothing happens from tick to tick: the counter is computed from the cycle, and the flags of a span of
//! ticks are set in one step. A compare flag is set at the tick at which the counter *becomes* the compare
//! value; writing the present count into a compare register does not set it.
//!
//! Not modelled: counting down and centre-aligned, slave modes, input capture, outputs on pins, DMA.

const CHANNELS: usize = 4;

const CR1_CEN: u32 = 1 << 0;
const CR1_UDIS: u32 = 1 << 1;
const CR1_URS: u32 = 1 << 2;
const CR1_OPM: u32 = 1 << 3;
const CR1_DIRECTION: u32 = 0x7 << 4;
const CR1_ARPE: u32 = 1 << 7;
const UPDATE: u32 = 1 << 0;
/// SR and DIER bits that exist: update, four compares, trigger; overcaptures in SR, DMA in DIER.
const SR_BITS: u32 = 0x1E5F;
const DIER_INTERRUPTS: u32 = 0x5F;
const DIER_DMA: u32 = 0x5F00;

/// One timer. All times are HCLK cycles of the node.
#[derive(Clone, Debug)]
pub(crate) struct Timer {
    /// The largest count: 16 or 32 bits.
    max: u32,
    /// HCLK cycles of one period of the timer's input clock.
    input_period: u64,
    cr1: u32,
    dier: u32,
    sr: u32,
    ccmr: [u32; 2],
    ccer: u32,
    /// As written; takes effect with the next update event.
    prescaler_preload: u32,
    prescaler: u32,
    reload_preload: u32,
    reload: u32,
    compare: [u32; CHANNELS],
    count: u32,
    /// When `count` began; meaningful while counting.
    since: u64,
    /// Settings that are not modelled; plain storage.
    other: [u32; 4],
}

impl Timer {
    pub(crate) const fn new(max: u32) -> Self {
        Self {
            max,
            input_period: 1,
            cr1: 0,
            dier: 0,
            sr: 0,
            ccmr: [0; 2],
            ccer: 0,
            prescaler_preload: 0,
            prescaler: 0,
            reload_preload: max,
            reload: max,
            compare: [0; CHANNELS],
            count: 0,
            since: 0,
            other: [0; 4],
        }
    }

    /// Reset by RCC: all but the clock.
    pub(crate) fn reset(&mut self) {
        *self = Self { input_period: self.input_period, ..Self::new(self.max) };
    }

    /// What it shows, and the cycle at which that began; `None` while it stands. [`Timer::advance`] comes
    /// first.
    pub(crate) fn reading(&self) -> Option<(u32, u64)> {
        self.counts().then_some((self.count, self.since))
    }

    /// The input clock changes, from `now` on.
    pub(crate) fn set_input_period(&mut self, now: u64, cycles: u64) {
        if cycles != self.input_period {
            self.advance(now);
            self.input_period = cycles;
        }
    }

    /// Returns whether the interrupt line is asserted. [`Timer::advance`] comes first.
    pub(crate) const fn interrupt(&self) -> bool {
        self.sr & self.dier & DIER_INTERRUPTS != 0
    }

    /// The cycle at which [`Timer::advance`] must be called next, because the interrupt line may be asserted
    /// then. `None` if it is already, or never will be.
    pub(crate) fn deadline(&self) -> Option<u64> {
        if !self.counts() || self.interrupt() {
            return None;
        }
        let mut ticks = u64::MAX;
        // New preload values change what comes behind the overflow.
        let reloads = self.prescaler != self.prescaler_preload || self.reload != self.reload_preload;
        if (self.dier & UPDATE != 0 || reloads) && self.cr1 & CR1_UDIS == 0 {
            ticks = ticks.min(self.ticks_to_overflow());
        }
        for (channel, &compare) in self.compare.iter().enumerate() {
            if self.dier & channel_bit(channel) != 0
                && let Some(to_compare) = self.ticks_to(compare)
            {
                ticks = ticks.min(to_compare);
            }
        }
        (ticks != u64::MAX).then(|| self.since.saturating_add(ticks.saturating_mul(self.tick())))
    }

    /// Counts up to the cycle `now`, and sets the flags on the way.
    pub(crate) fn advance(&mut self, now: u64) {
        if !self.counts() {
            self.since = now;
            return;
        }
        loop {
            let ticks = now.saturating_sub(self.since) / self.tick();
            let to_overflow = self.ticks_to_overflow();
            let step = ticks.min(to_overflow);
            if step == 0 {
                return;
            }
            self.set_compare_flags(step, to_overflow);
            self.since += step * self.tick();
            if step < to_overflow {
                self.count += step as u32;
                return;
            }
            self.count = 0;
            if self.cr1 & CR1_UDIS == 0 {
                self.sr |= UPDATE;
                self.load();
            }
            if self.cr1 & CR1_OPM != 0 {
                self.cr1 &= !CR1_CEN;
                self.since = now;
                return;
            }
        }
    }

    /// Sets the flags of the compares that a step of `step` ticks reaches.
    fn set_compare_flags(&mut self, step: u64, to_overflow: u64) {
        for (channel, &compare) in self.compare.iter().enumerate() {
            let reached = match self.ticks_to(compare) {
                // A value behind the overflow is reached in a later step, unless it is the 0 itself.
                Some(ticks) => ticks <= step && (ticks < to_overflow || compare == 0),
                None => false,
            };
            if reached && self.is_output(channel) {
                self.sr |= channel_bit(channel);
            }
        }
    }

    /// Channels reset to output; CCxS other than 0 makes one an input.
    const fn is_output(&self, channel: usize) -> bool {
        self.ccmr[channel / 2] >> (channel % 2 * 8) & 0x3 == 0
    }

    const fn counts(&self) -> bool {
        self.cr1 & CR1_CEN != 0 && self.reload != 0
    }

    /// HCLK cycles of one tick.
    const fn tick(&self) -> u64 {
        self.input_period * (self.prescaler as u64 + 1)
    }

    fn ticks_to_overflow(&self) -> u64 {
        // A count beyond the reload value runs to the end of the counter first.
        let last = if self.count > self.reload { self.max } else { self.reload };
        u64::from(last - self.count) + 1
    }

    /// Ticks until the counter becomes `value`; `None` if it never does.
    fn ticks_to(&self, value: u32) -> Option<u64> {
        if value > self.count && (value <= self.reload || self.count > self.reload) {
            Some(u64::from(value - self.count))
        } else if value <= self.reload {
            Some(self.ticks_to_overflow() + u64::from(value))
        } else {
            None
        }
    }

    /// An update event loads the preload registers.
    fn load(&mut self) {
        self.prescaler = self.prescaler_preload;
        self.reload = self.reload_preload;
    }

    /// Reads a register; [`Timer::advance`] comes first. `None` if there is none.
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.cr1,
            0x04 => self.other[0],
            0x08 => self.other[1],
            0x0C => self.dier,
            0x10 => self.sr,
            0x14 => 0,
            0x18 | 0x1C => self.ccmr[(offset as usize - 0x18) / 4],
            0x20 => self.ccer,
            0x24 => self.count,
            0x28 => self.prescaler_preload,
            0x2C => self.reload_preload,
            0x34..=0x40 => self.compare[(offset as usize - 0x34) / 4],
            0x48 => self.other[2],
            0x50 => self.other[3],
            _ => return None,
        })
    }

    /// Writes a register at the cycle `now`; [`Timer::advance`] comes first. `Err` for what is not
    /// modelled; the value is stored all the same.
    pub(crate) fn write(&mut self, now: u64, offset: u32, value: u32) -> Result<(), NotModelled> {
        let mut modelled = true;
        match offset {
            0x00 => {
                if self.cr1 & CR1_CEN == 0 {
                    self.since = now;
                }
                self.cr1 = value & 0x3FF;
                modelled = value & CR1_DIRECTION == 0;
            }
            0x04 => modelled = store(&mut self.other[0], value),
            0x08 => modelled = store(&mut self.other[1], value),
            0x0C => {
                self.dier = value;
                modelled = value & DIER_DMA == 0;
            }
            // Flags are cleared by writing 0.
            0x10 => self.sr &= value | !SR_BITS,
            0x14 => self.generate(now, value),
            0x18 | 0x1C => {
                self.ccmr[(offset as usize - 0x18) / 4] = value;
                modelled = value & 0x0303 == 0;
            }
            0x20 => modelled = store(&mut self.ccer, value),
            0x24 => {
                self.count = value & self.max;
                self.since = now;
            }
            0x28 => self.prescaler_preload = value & 0xFFFF,
            0x2C => {
                self.reload_preload = value & self.max;
                if self.cr1 & CR1_ARPE == 0 {
                    self.reload = self.reload_preload;
                }
            }
            0x34..=0x40 => self.compare[(offset as usize - 0x34) / 4] = value & self.max,
            0x48 => modelled = store(&mut self.other[2], value),
            0x50 => modelled = store(&mut self.other[3], value),
            _ => modelled = false,
        }
        if modelled { Ok(()) } else { Err(NotModelled) }
    }

    /// EGR: events by software.
    fn generate(&mut self, now: u64, events: u32) {
        if events & UPDATE != 0 {
            self.count = 0;
            self.since = now;
            if self.cr1 & CR1_UDIS == 0 {
                self.load();
                if self.cr1 & CR1_URS == 0 {
                    self.sr |= UPDATE;
                }
            }
        }
        self.sr |= events & 0x1E;
    }
}

/// The firmware asked a peripheral for something that the model does not have.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct NotModelled;

const fn channel_bit(channel: usize) -> u32 {
    1 << (channel + 1)
}

/// Stores a setting that has no effect here; only its reset value 0 is as good as modelled.
const fn store(slot: &mut u32, value: u32) -> bool {
    *slot = value;
    value == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn running(writes: &[(u32, u32)]) -> Timer {
        let mut timer = Timer::new(u32::MAX);
        timer.set_input_period(0, 2);
        for &(offset, value) in writes {
            timer.write(0, offset, value).unwrap();
        }
        timer.write(0, 0x00, CR1_CEN).unwrap();
        timer
    }

    #[test]
    fn a_compare_fires_at_the_exact_tick() {
        // Prescaler 41 by an update event: one tick is 84 cycles.
        let mut timer = running(&[(0x28, 41), (0x14, 1), (0x10, 0), (0x38, 10), (0x0C, 1 << 2)]);
        assert_eq!(timer.deadline(), Some(840));
        timer.advance(839);
        assert_eq!((timer.read(0x24), timer.interrupt()), (Some(9), false));
        timer.advance(840);
        assert_eq!((timer.read(0x24), timer.interrupt()), (Some(10), true));
        timer.write(840, 0x10, !(1 << 2)).unwrap();
        assert_eq!(timer.read(0x10).map(|sr| sr & 1 << 2), Some(0));
        assert!(!timer.interrupt());
        // The next match is one turn of the counter away.
        assert_eq!(timer.deadline(), Some(840 + (1 << 32) * 84));
    }

    #[test]
    fn an_overflow_sets_the_update_flag_and_loads_the_preloads() {
        let mut timer = running(&[(0x2C, 99), (0x0C, UPDATE)]);
        timer.write(0, 0x28, 1).unwrap();
        assert_eq!(timer.deadline(), Some(200));
        timer.advance(200 + 4 * 7);
        assert_eq!((timer.read(0x24), timer.interrupt()), (Some(7), true));
    }

    #[test]
    fn a_compare_value_of_zero_matches_at_the_overflow() {
        let mut timer = running(&[(0x2C, 9), (0x34, 0), (0x0C, 1 << 1)]);
        assert_eq!(timer.deadline(), Some(20));
        timer.advance(20);
        assert!(timer.interrupt());
    }

    #[test]
    fn compares_behind_the_overflow_are_found() {
        let mut timer = running(&[(0x2C, 9), (0x34, 3)]);
        timer.advance(10); // count 5, flag set on the way
        timer.write(10, 0x10, 0).unwrap();
        timer.write(10, 0x0C, 1 << 1).unwrap();
        assert_eq!(timer.deadline(), Some(26));
        timer.advance(25);
        assert!(!timer.interrupt());
        timer.advance(26);
        assert!(timer.interrupt());
    }

    #[test]
    fn events_by_software_and_what_is_not_modelled() {
        let mut timer = Timer::new(0xFFFF);
        timer.write(0, 0x14, 1 << 2).unwrap();
        assert_eq!(timer.read(0x10), Some(1 << 2));
        assert_eq!(timer.read(0x2C), Some(0xFFFF));
        assert_eq!(timer.write(0, 0x00, 1 << 4), Err(NotModelled));
        assert_eq!(timer.write(0, 0x44, 0), Err(NotModelled));
    }
}
