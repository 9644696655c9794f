//! From a node's cycles to true time and back.
//!
//! Inside a node everything is counted in HCLK cycles, in whole numbers. Between nodes only true time
//! counts. A node's oscillator is off by its [`ClockError`]; both directions of the conversion are exact
//! (128-bit integers), so nothing accumulates.

use cosmic_bus::VirtualInstant;

/// How far a node's oscillator is from its nominal frequency. Positive: it runs fast.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub struct ClockError(i32);

impl ClockError {
    /// No error.
    pub const ZERO: Self = Self(0);
    /// The largest error, one per cent: what an internal RC oscillator has.
    pub const MAX: Self = Self(10_000_000);

    /// An error in parts per billion; `None` beyond [`ClockError::MAX`] in either direction.
    pub const fn parts_per_billion(error: i32) -> Option<Self> {
        if error.unsigned_abs() > Self::MAX.0.unsigned_abs() { None } else { Some(Self(error)) }
    }

    /// An error in parts per million; `None` beyond [`ClockError::MAX`] in either direction.
    pub const fn parts_per_million(error: i32) -> Option<Self> {
        match error.checked_mul(1000) {
            Some(error) => Self::parts_per_billion(error),
            None => None,
        }
    }

    const fn factor(self) -> u128 {
        (BILLION as i64 + self.0 as i64).unsigned_abs() as u128
    }
}

const BILLION: u128 = 1_000_000_000;

/// The relation of cycles to true time; a new segment begins whenever the firmware changes its clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timebase {
    error: ClockError,
    hertz: u32,
    segment_cycle: u64,
    segment_start: VirtualInstant,
}

impl Timebase {
    /// Cycle 0 is at `start`; cycles have the nominal frequency `hertz`, which is not 0.
    pub(crate) const fn new(start: VirtualInstant, hertz: u32, error: ClockError) -> Self {
        Self { error, hertz, segment_cycle: 0, segment_start: start }
    }

    /// The frequency changes from `cycle` on.
    pub(crate) fn change_frequency(&mut self, cycle: u64, hertz: u32) {
        self.segment_start = self.instant(cycle);
        self.segment_cycle = cycle;
        self.hertz = hertz;
    }

    /// When a cycle begins. Cycles before the last change of the frequency are not asked for.
    pub(crate) fn instant(&self, cycle: u64) -> VirtualInstant {
        let cycles = u128::from(cycle.saturating_sub(self.segment_cycle));
        let nanoseconds = cycles * (BILLION * BILLION) / self.scale();
        VirtualInstant::from_ticks(self.segment_start.as_ticks().saturating_add(saturate(nanoseconds)))
    }

    /// The first cycle that begins at `instant` or later.
    pub(crate) fn cycle_at(&self, instant: VirtualInstant) -> u64 {
        let span = instant.as_ticks().saturating_sub(self.segment_start.as_ticks());
        let cycles = (u128::from(span) * self.scale()).div_ceil(BILLION * BILLION);
        self.segment_cycle.saturating_add(saturate(cycles))
    }

    /// Cycles per second, times a billion.
    fn scale(&self) -> u128 {
        u128::from(self.hertz) * self.error.factor()
    }
}

fn saturate(value: u128) -> u64 {
    u64::try_from(value).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_directions_agree() {
        let error = ClockError::parts_per_million(-37).unwrap();
        let mut base = Timebase::new(VirtualInstant::from_ticks(1234), 16_000_000, error);
        base.change_frequency(1_000_001, 168_000_000);
        for cycle in [1_000_001, 1_000_002, 1_234_567, 168_000_000_000] {
            let instant = base.instant(cycle);
            assert_eq!(base.cycle_at(instant), cycle);
            assert!(base.cycle_at(VirtualInstant::from_ticks(instant.as_ticks() + 1)) > cycle);
        }
    }

    #[test]
    fn a_fast_clock_has_more_cycles_a_second() {
        let base = |ppm| {
            let error = ClockError::parts_per_million(ppm).unwrap();
            Timebase::new(VirtualInstant::from_ticks(0), 168_000_000, error)
        };
        let second = VirtualInstant::from_ticks(1_000_000_000);
        assert_eq!(base(0).cycle_at(second), 168_000_000);
        assert_eq!(base(50).cycle_at(second), 168_008_400);
        assert_eq!(base(-50).cycle_at(second), 167_991_600);
        assert_eq!(ClockError::parts_per_million(10_001), None);
    }
}
