//! The local clock of a simulated node: an oscillator that is off, a timer that ticks, and stamps that are
//! late.

use crate::time::VirtualInstant;
use cosmic_core::time::{Duration, Instant, Rate};

/// What is wrong with a node's clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ClockErrors {
    /// How much faster than true time the oscillator runs.
    pub drift: Rate,
    /// What the timer shows at power-on.
    pub starts_at: Instant,
    /// The resolution of the timer.
    pub tick: Duration,
    /// Time-stamps are late by a span drawn uniformly from zero to this.
    pub stamp_delay: Duration,
    /// The calendar dispatcher acts late by a span drawn uniformly from zero to this.
    pub release_delay: Duration,
}

impl ClockErrors {
    /// A perfect clock.
    pub const NONE: Self = Self {
        drift: Rate::ZERO,
        starts_at: Instant::EPOCH,
        tick: Duration::from_ticks(1),
        stamp_delay: Duration::from_ticks(0),
        release_delay: Duration::from_ticks(0),
    };

    /// A crystal that is off by `drift`, a timer of 4 MHz, and interrupts within 1 µs.
    pub const fn realistic(drift: Rate) -> Self {
        Self {
            drift,
            starts_at: Instant::EPOCH,
            tick: Duration::from_ticks(250),
            stamp_delay: Duration::from_micros(1),
            release_delay: Duration::from_micros(2),
        }
    }
}

/// A timer that was started at power-on.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalClock {
    errors: ClockErrors,
    powered_on: VirtualInstant,
}

impl LocalClock {
    pub(super) const fn new(errors: ClockErrors, powered_on: VirtualInstant) -> Self {
        Self { errors, powered_on }
    }

    /// What the timer shows.
    pub(super) fn read(&self, at: VirtualInstant) -> Instant {
        let tick = self.errors.tick.as_ticks();
        self.errors.starts_at + Duration::from_ticks(self.counted(at) / tick * tick)
    }

    /// What it would show if it had no ticks.
    pub(super) fn exact(&self, at: VirtualInstant) -> Instant {
        self.errors.starts_at + Duration::from_ticks(self.counted(at))
    }

    /// Nanoseconds since power-on by the oscillator.
    fn counted(&self, at: VirtualInstant) -> u64 {
        let elapsed = at.as_ticks().saturating_sub(self.powered_on.as_ticks());
        (elapsed as i64 + self.gained(elapsed as i64)) as u64
    }

    /// What the drift makes of a span; in arithmetic of its own, for it judges the core's.
    fn gained(&self, span: i64) -> i64 {
        ((i128::from(span) * i128::from(self.errors.drift.fraction())) >> 32) as i64
    }

    /// The first instant at which the timer shows `local` or more.
    pub(super) fn when(&self, local: Instant) -> VirtualInstant {
        let tick = self.errors.tick.as_ticks();
        let shown = local.saturating_since(self.errors.starts_at).as_ticks().next_multiple_of(tick);
        // Two steps of a fixed-point iteration come within a nanosecond; the rest is searched.
        let first = shown as i64 - self.gained(shown as i64);
        let mut elapsed = shown as i64 - self.gained(first);
        while elapsed + self.gained(elapsed) < shown as i64 {
            elapsed += 1;
        }
        while elapsed > 0 && elapsed - 1 + self.gained(elapsed - 1) >= shown as i64 {
            elapsed -= 1;
        }
        VirtualInstant::from_ticks(self.powered_on.as_ticks() + elapsed as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_timer_shows_an_instant_when_it_says(
            drift in -200_000_i32..200_000, local in 0_u64..1 << 50, tick in 1_u64..2_000
        ) {
            let errors = ClockErrors {
                drift: Rate::from_parts_per_billion(drift),
                tick: Duration::from_ticks(tick),
                ..ClockErrors::NONE
            };
            let clock = LocalClock::new(errors, VirtualInstant::from_ticks(77));
            let local = Instant::from_epoch(Duration::from_ticks(local));
            let at = clock.when(local);
            prop_assert!(clock.read(at) >= local);
            if at.as_ticks() > 77 {
                prop_assert!(clock.read(VirtualInstant::from_ticks(at.as_ticks() - 1)) < local);
            }
        }
    }
}
