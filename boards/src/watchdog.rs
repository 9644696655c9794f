//! The independent watchdog (IWDG).
//!
//! It has an oscillator of its own, of 32 kHz, which nothing can stop once it is started; a reset is the only end. But
//! that oscillator is anything from 17 to 47 kHz (STM32F405 datasheet, LSI characteristics), so a time is a range: a
//! watchdog that must not come before 100 ms may come after 277 ms.

use cosmic_core::time::Duration;

/// How long a watchdog waits to be fed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Patience {
    prescaler: u8,
    reload: u16,
}

impl Patience {
    /// At least this long, with the fastest oscillator. `None` if it is zero, or longer than the watchdog can wait
    /// (22 s).
    pub const fn at_least(span: Duration) -> Option<Self> {
        let periods = span.as_ticks().saturating_mul(FASTEST).div_ceil(1_000_000_000);
        let mut prescaler = 0;
        while prescaler <= LARGEST_PRESCALER {
            let counts = periods.div_ceil(4 << prescaler);
            if counts >= 1 && counts <= LARGEST_RELOAD + 1 {
                return Some(Self { prescaler, reload: (counts - 1) as u16 });
            }
            prescaler += 1;
        }
        None
    }

    /// With the slowest oscillator: by then a node that is not fed has been reset.
    pub const fn at_most(self) -> Duration {
        let periods = (self.reload as u64 + 1) * (4 << self.prescaler);
        Duration::from_ticks((periods * 1_000_000_000).div_ceil(SLOWEST))
    }
}

/// The watchdog, which runs.
#[cfg(target_arch = "arm")]
pub struct Watchdog {
    registers: stm32f4xx_hal::pac::IWDG,
}

#[cfg(target_arch = "arm")]
impl Watchdog {
    /// Starts it. While a debug probe holds the core, it waits, too.
    pub fn start(registers: stm32f4xx_hal::pac::IWDG, patience: Patience) -> Self {
        let Patience { prescaler, reload } = patience;
        // SAFETY: a bit of its own, which only this sets.
        unsafe { (*stm32f4xx_hal::pac::DBGMCU::ptr()).apb1_fz().modify(|_, w| w.dbg_iwdg_stop().set_bit()) };
        // RM0090, 21.3: the settings arrive within five periods of the oscillator, which the start switches on. Until it is
        // fed first, the reset value counts, which is 349 ms and more.
        registers.kr().write(|w| w.key().start());
        registers.kr().write(|w| w.key().unlock());
        registers.pr().write(|w| w.pr().set(prescaler));
        registers.rlr().write(|w| w.rl().set(reload));
        Self { registers }
    }
}

#[cfg(target_arch = "arm")]
impl cosmic_rtic::board::Watchdog for Watchdog {
    #[inline]
    fn feed(&mut self) {
        self.registers.kr().write(|w| w.key().feed());
    }
}

const FASTEST: u64 = 47_000;
const SLOWEST: u64 = 17_000;
const LARGEST_PRESCALER: u8 = 6;
const LARGEST_RELOAD: u64 = 0xFFF;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_never_shorter_and_three_times_as_long_at_most() {
        for us in [100, 1_000, 20_000, 87_123, 100_000, 1_000_000, 22_000_000] {
            let span = Duration::from_micros(us);
            let Patience { prescaler, reload } = Patience::at_least(span).unwrap();
            let periods = (u64::from(reload) + 1) * (4 << prescaler);
            assert!(periods * 1_000_000 / 47_000 >= us, "{us}");
            // The finest prescaler that is possible is within a count of 4096th.
            let slowest = Patience::at_least(span).unwrap().at_most();
            assert!(
                slowest <= span * 277 / 100 + Duration::from_micros(240) + span / 1000,
                "{us}: {slowest}"
            );
        }
        assert_eq!(
            Patience::at_least(Duration::from_millis(100)),
            Some(Patience { prescaler: 0, reload: 1174 })
        );
    }

    #[test]
    fn what_it_cannot_wait_is_refused() {
        assert_eq!(Patience::at_least(Duration::from_ticks(0)), None);
        assert_eq!(Patience::at_least(Duration::from_secs(23)), None);
    }
}
