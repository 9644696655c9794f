//! The independent watchdog (RM0090, chapter 21).
//!
//! It counts the internal low-speed oscillator, which nothing else uses here: it stops in no mode, and once it is
//! started only a reset stops it. Its instants are true time, whatever the clock of the core.
//!
//! Not modelled: the few periods that a new prescaler or reload value takes to arrive (SR reads 0; a value counts from
//! the next reload on), and the option byte that starts the watchdog by hardware.

use cosmic_bus::VirtualInstant;
use cosmic_core::time::Duration;

const KEY_RELOAD: u32 = 0xAAAA;
const KEY_ACCESS: u32 = 0x5555;
const KEY_START: u32 = 0xCCCC;
const LARGEST_RELOAD: u32 = 0xFFF;

/// The watchdog.
#[derive(Clone, Debug)]
pub(crate) struct IndependentWatchdog {
    /// Frequency of the low-speed oscillator.
    hertz: u32,
    prescaler: u32,
    reload: u32,
    is_open: bool,
    /// When it resets the part, once it is started.
    expires_at: Option<VirtualInstant>,
}

impl IndependentWatchdog {
    /// Not started, with an oscillator of this frequency.
    pub(crate) const fn new(hertz: u32) -> Self {
        Self { hertz, prescaler: 0, reload: LARGEST_RELOAD, is_open: false, expires_at: None }
    }

    /// When it resets the part, unless it is fed before; `None` if it is not started.
    pub(crate) const fn expires_at(&self) -> Option<VirtualInstant> {
        self.expires_at
    }

    /// Reads KR, PR, RLR or SR. `None` if there is no such register.
    pub(crate) const fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            // The key register is write-only.
            0x0 | 0xC => Some(0),
            0x4 => Some(self.prescaler),
            0x8 => Some(self.reload),
            _ => None,
        }
    }

    /// Writes a register at `now`. `None` if there is no such register.
    pub(crate) fn write(&mut self, now: VirtualInstant, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x0 => self.write_key(now, value & 0xFFFF),
            // Write protected without the key.
            0x4 if self.is_open => self.prescaler = value & 0x7,
            0x8 if self.is_open => self.reload = value & LARGEST_RELOAD,
            0x4 | 0x8 | 0xC => {}
            _ => return None,
        }
        Some(())
    }

    fn write_key(&mut self, now: VirtualInstant, key: u32) {
        self.is_open = key == KEY_ACCESS;
        if key == KEY_START || key == KEY_RELOAD && self.expires_at.is_some() {
            self.expires_at = Some(now + self.period());
        }
    }

    /// From a reload to the reset. The prescaler divides by 4 to 256.
    fn period(&self) -> Duration {
        let divider = 4_u64 << self.prescaler.min(6);
        Duration::from_ticks((u64::from(self.reload) + 1) * divider * 1_000_000_000 / u64::from(self.hertz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(milliseconds: u64) -> VirtualInstant {
        VirtualInstant::from_ticks(milliseconds * 1_000_000)
    }

    #[test]
    fn it_counts_from_the_start_and_from_each_reload_on() {
        let mut watchdog = IndependentWatchdog::new(32_000);
        watchdog.write(at(0), 0, KEY_ACCESS).unwrap();
        watchdog.write(at(0), 4, 3).unwrap(); // by 32: a millisecond
        watchdog.write(at(0), 8, 99).unwrap();
        // A reload of one that is not started starts nothing.
        watchdog.write(at(5), 0, KEY_RELOAD).unwrap();
        assert_eq!(watchdog.expires_at(), None);
        watchdog.write(at(10), 0, KEY_START).unwrap();
        assert_eq!(watchdog.expires_at(), Some(at(110)));
        watchdog.write(at(109), 0, KEY_RELOAD).unwrap();
        assert_eq!(watchdog.expires_at(), Some(at(209)));
        // Any other key closes the registers, and stops nothing.
        watchdog.write(at(120), 8, 9).unwrap();
        watchdog.write(at(120), 0, 0).unwrap();
        assert_eq!((watchdog.read(8), watchdog.expires_at()), (Some(99), Some(at(209))));
        assert_eq!((watchdog.read(0xC), watchdog.read(0x10)), (Some(0), None));
    }
}
