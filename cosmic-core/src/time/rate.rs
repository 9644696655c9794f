//! How much faster one clock runs than another, as a binary fraction.

use super::Duration;

/// The rate of one clock against another, less one, in units of 2⁻³² (0.23 parts in 10⁹).
///
/// Kept within ±[`Rate::LIMIT`], far more than any crystal is off, so that products with it stay small.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rate(i32);

impl Rate {
    /// Both run alike.
    pub const ZERO: Self = Self(0);
    /// The largest rate, just under 1000 parts in 10⁶.
    pub const LIMIT: Self = Self(1 << 22);

    /// From units of 2⁻³², clamped to ±[`Rate::LIMIT`].
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "a constant of 23 bits")]
    pub const fn from_fraction(fraction: i64) -> Self {
        let limit = Self::LIMIT.0 as i64;
        Self(if fraction > limit {
            limit as i32
        } else if fraction < -limit {
            -limit as i32
        } else {
            fraction as i32
        })
    }

    /// From parts in 10⁹, rounded down in size, clamped to ±[`Rate::LIMIT`].
    pub const fn from_parts_per_billion(parts: i32) -> Self {
        Self::from_fraction(((parts as i64) << 32) / 1_000_000_000)
    }

    /// In units of 2⁻³².
    #[inline]
    pub const fn fraction(self) -> i32 {
        self.0
    }

    /// The rate seen from the other clock, `1 / (1 + rate) - 1`, to the nearest unit. May exceed the
    /// limit by a thousandth.
    #[expect(clippy::arithmetic_side_effects, reason = "23 bits shifted by 32, and a denominator near 2^32")]
    pub const fn inverse(self) -> Self {
        let numerator = -((self.0 as i64) << 32);
        let denominator = (1 << 32) + self.0 as i64;
        let half = if numerator < 0 { -denominator / 2 } else { denominator / 2 };
        Self(((numerator + half) / denominator) as i32)
    }

    /// What the faster clock gains in a span of the slower one, in nanoseconds, rounded down.
    ///
    /// Exact for every span: two multiplications of 32 bits by 32.
    #[inline]
    pub(super) const fn gain(self, nanoseconds: i64) -> i64 {
        gain(self.0, nanoseconds)
    }

    /// As [`gain`](Self::gain), for a short span: one multiplication.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "32 bits by 32 bits fit")]
    pub(super) const fn gain_near(self, nanoseconds: i32) -> i32 {
        ((self.0 as i64 * nanoseconds as i64) >> 32) as i32
    }
}

/// `nanoseconds` times a fraction in units of 2⁻³², rounded down. No sum overflows below 2³⁰ units.
#[inline]
#[expect(clippy::arithmetic_side_effects, reason = "31 bits by 32 bits fit")]
pub(crate) const fn gain(fraction: i32, nanoseconds: i64) -> i64 {
    let high = (nanoseconds >> 32) * fraction as i64;
    let low = ((nanoseconds as u32 as i64) * fraction as i64) >> 32;
    high + low
}

/// How much a [`Rate`] may change per second, in units of 2⁻³² each 2³⁰ ns.
///
/// What bounds it is the temperature: a crystal changes by less than 1 part in 10⁶ for one kelvin.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RateChange(u32);

impl RateChange {
    /// The rate is constant.
    pub const ZERO: Self = Self(0);
    /// The largest change: [`Rate::LIMIT`] in a second.
    pub const LIMIT: Self = Self(1 << 22);
    /// Longer spans count as this one, about 69 s, so that products stay small.
    const LONGEST: u64 = 1 << 36;

    /// From parts in 10⁹ per second, rounded up, at most [`RateChange::LIMIT`].
    #[expect(clippy::arithmetic_side_effects, reason = "32 bits by 13 bits fit")]
    pub const fn from_parts_per_billion(parts: u32) -> Self {
        // 2^32 * 2^30 / 10^18 = 4.612 units for each part in 10^9.
        let units = (parts as u64 * 4_612).div_ceil(1_000);
        Self(if units < Self::LIMIT.0 as u64 { units as u32 } else { Self::LIMIT.0 })
    }

    /// Returns whether the rate is constant.
    #[inline]
    pub const fn is_zero(self) -> bool {
        self.0 == 0
    }

    /// The largest change of the rate in a span, in units of 2⁻³², rounded up.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "22 bits by 27 bits, less 20")]
    pub(crate) const fn over(self, span: Duration) -> i32 {
        let span = if span.as_ticks() < Self::LONGEST { span.as_ticks() } else { Self::LONGEST };
        // 22 bits times 26 bits, less 20.
        ((self.0 as u64 * ((span >> 10) + 1)) >> 20) as i32 + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_of_a_second() {
        let rate = Rate::from_parts_per_billion(50_000);
        assert_eq!(rate.gain(1_000_000_000), 49_999);
        assert_eq!(Rate::from_parts_per_billion(-50_000).gain(1_000_000_000), -50_000);
        // A day, more than 32 bits of nanoseconds: 4.32 s.
        assert_eq!(rate.gain(86_400_000_000_000) / 1_000_000, 4_319);
    }

    #[test]
    fn inverse_of_a_rate() {
        assert_eq!(Rate::ZERO.inverse(), Rate::ZERO);
        let rate = Rate::from_parts_per_billion(100_000);
        assert_eq!(rate.fraction(), 429_496);
        // 429496 * (1 - 100 ppm) = 429453.1
        assert_eq!(rate.inverse().fraction(), -429_453);
    }

    #[test]
    fn rates_beyond_the_limit_are_clamped() {
        assert_eq!(Rate::from_parts_per_billion(5_000_000), Rate::LIMIT);
        assert_eq!(Rate::from_fraction(i64::MIN).fraction(), -Rate::LIMIT.fraction());
        assert_eq!(RateChange::from_parts_per_billion(u32::MAX), RateChange::LIMIT);
    }

    #[test]
    fn change_of_a_rate() {
        let change = RateChange::from_parts_per_billion(2_000);
        // 2 ppm are 8590 units; rounding is upwards, by a few units.
        let second = change.over(Duration::from_secs(1));
        assert!((8_590..8_600).contains(&second), "{second}");
        assert_eq!(change.over(Duration::MAX), change.over(Duration::from_secs(100)));
    }
}
