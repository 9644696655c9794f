//! Spans of true time that may be negative, and their spread.

use core::fmt;

use cosmic_bus::VirtualInstant;
use cosmic_core::time::Duration;
use serde::{Serialize, Serializer};

/// A signed span of true time. In reports it is a number of microseconds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Span(i64);

impl Span {
    /// No time.
    pub const ZERO: Self = Self(0);

    /// This many nanoseconds.
    pub const fn from_nanos(nanoseconds: i64) -> Self {
        Self(nanoseconds)
    }

    /// From `earlier` to `later`; negative if they stand the other way round.
    pub fn between(earlier: VirtualInstant, later: VirtualInstant) -> Self {
        Self(later.as_ticks().wrapping_sub(earlier.as_ticks()).cast_signed())
    }

    /// In nanoseconds.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// In microseconds, for people.
    pub fn as_micros(self) -> f64 {
        self.0 as f64 / 1e3
    }

    /// Without its sign.
    #[must_use]
    pub const fn abs(self) -> Self {
        Self(self.0.saturating_abs())
    }

    /// `at`, moved by this span; not before the start of the simulation.
    pub fn after(self, at: VirtualInstant) -> VirtualInstant {
        VirtualInstant::from_ticks(at.as_ticks().saturating_add_signed(self.0))
    }
}

impl From<Duration> for Span {
    fn from(duration: Duration) -> Self {
        Self(i64::try_from(duration.as_ticks()).unwrap_or(i64::MAX))
    }
}

impl core::ops::Neg for Span {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl core::ops::Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl core::ops::Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} µs", self.as_micros())
    }
}

impl Serialize for Span {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(self.as_micros())
    }
}

/// Smallest, mean and largest of some spans.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Spread {
    count: u64,
    sum: i128,
    min: Span,
    max: Span,
}

/// A [`Spread`] of at least one span, as it stands in reports.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Debug)]
pub struct Range {
    /// The smallest.
    pub min: Span,
    /// The arithmetic mean, rounded towards zero.
    pub mean: Span,
    /// The largest.
    pub max: Span,
}

impl Spread {
    /// Takes one more into account.
    pub fn add(&mut self, span: Span) {
        self.min = if self.count == 0 { span } else { self.min.min(span) };
        self.max = if self.count == 0 { span } else { self.max.max(span) };
        self.count += 1;
        self.sum += i128::from(span.0);
    }

    /// The numbers; `None` if there was no span.
    pub fn range(&self) -> Option<Range> {
        let count = i128::from(self.count);
        let mean = self.sum.checked_div(count)?;
        // A mean lies between the smallest and the largest, which fit.
        let mean = Span(i64::try_from(mean).unwrap_or(0));
        Some(Range { min: self.min, mean, max: self.max })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_of_nothing_has_no_range() {
        assert_eq!(Spread::default().range(), None);
    }

    #[test]
    fn negative_spans_count_too() {
        let mut spread = Spread::default();
        for nanoseconds in [5, -3, 1] {
            spread.add(Span::from_nanos(nanoseconds));
        }
        let range = spread.range().unwrap();
        assert_eq!((range.min, range.mean, range.max), (Span(-3), Span(1), Span(5)));
    }

    #[test]
    fn spans_know_which_way_they_go() {
        let at = VirtualInstant::from_ticks;
        assert_eq!(Span::between(at(100), at(40)), Span(-60));
        assert_eq!(Span(-60).after(at(100)), at(40));
        assert_eq!(Span(-60).after(at(20)), at(0));
    }
}
