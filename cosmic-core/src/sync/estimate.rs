//! What is known of a master's clock: intervals that surely contain its offset and its rate.
//!
//! An estimate by least squares has an error that one can state only statistically. Here each
//! synchronisation gives an interval that contains the offset for certain, from the bound on the
//! time-stamps. Three facts keep the intervals narrow:
//!
//! * the offset now is the offset then plus the rate in between, so the old interval, moved and widened,
//!   contains it as well: the intersection does;
//! * two offsets apart in time bound the rate, the better the further they are apart;
//! * the rate changes slowly, so older pairs still count.
//!
//! The clock runs through the middle, and half of the width is its error. An empty intersection proves
//! that the master, or a time-stamp, did not keep its promise.

use super::config::SyncConfig;
use crate::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate, RateChange, Uncertainty, rate};

/// The values from `low` to `high`. Both are of 62 bits at most, so that sums and differences do not wrap: global time is
/// of [60 bits](crate::protocol::FollowUp::END) on the wire, local time of fewer in any life.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Interval {
    low: i64,
    high: i64,
}

impl Interval {
    const fn around(centre: i64, radius: i64) -> Self {
        Self { low: centre.wrapping_sub(radius), high: centre.wrapping_add(radius) }
    }

    const fn widened(self, by: i64) -> Self {
        Self { low: self.low.wrapping_sub(by), high: self.high.wrapping_add(by) }
    }

    /// `None` if they have nothing in common.
    fn intersection(self, other: Self) -> Option<Self> {
        let both = Self { low: self.low.max(other.low), high: self.high.min(other.high) };
        if both.low <= both.high { Some(both) } else { None }
    }

    const fn centre(self) -> i64 {
        // Without the sum, which may overflow.
        self.low.wrapping_add((self.high.wrapping_sub(self.low) as u64 / 2) as i64)
    }

    /// Rounded up.
    const fn radius(self) -> u64 {
        (self.high.wrapping_sub(self.low) as u64).div_ceil(2)
    }
}

/// Where the master's clock surely was at one local instant: global less local time, in nanoseconds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Point {
    at: Instant,
    offset: Interval,
}

impl Point {
    /// The rate at a later point, in units of 2⁻³², if it changes by no more than `change`. `None` if the
    /// points are too far apart, or too close, to tell.
    #[expect(clippy::arithmetic_side_effects, reason = "halves of 31 bits")]
    fn rate_at(&self, later: &Self, change: RateChange) -> Option<Interval> {
        let span = later.at.signed_since(self.at);
        if span <= 0 || span > LONGEST_SPAN {
            return None;
        }
        let half_change = i64::from(change.over(Duration::from_ticks(span.cast_unsigned()))) / 2 + 1;
        let low = slope(later.offset.low.wrapping_sub(self.offset.high), span)?;
        let high = slope(later.offset.high.wrapping_sub(self.offset.low), span)?;
        // One unit more, for the rounding of the quotients.
        Some(Interval { low, high }.widened(half_change + 1))
    }
}

/// `rise / run` in units of 2⁻³²; `None` if the rise is more than two seconds.
#[expect(
    clippy::arithmetic_side_effects,
    reason = "31 bits shifted by 32 fit, and the caller's span is not zero"
)]
fn slope(rise: i64, run: i64) -> Option<i64> {
    let rise = i32::try_from(rise).ok()?;
    Some((i64::from(rise) << 32) / run)
}

/// A time-stamp contradicts what is known: the master stepped, or one of the bounds does not hold.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Implausible;

/// Bounds on the offset and the rate of one time scale against local time. See the [module](self).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Estimate {
    stamp_error: i64,
    rate_limit: i64,
    rate_change: RateChange,
    now: Point,
    /// In units of 2⁻³².
    rate: Interval,
    /// Earlier points; the one after the newest is the oldest. At first they are all the same.
    earlier: [Point; WINDOW],
    newest: usize,
}

impl Estimate {
    /// From the first pair of time-stamps: `sent_at` the master's, `received_at` ours, of one frame.
    pub(super) fn new(config: &SyncConfig, received_at: Instant, sent_at: GlobalInstant) -> Self {
        // A nanosecond each for the rounding of the two stamps and for the drift while they were taken.
        let stamp_error = i64::try_from(config.stamp_error.as_ticks()).unwrap_or(i64::MAX).saturating_add(3);
        let limit = i64::from(config.rate_limit());
        let now =
            Point { at: received_at, offset: Interval::around(offset(received_at, sent_at), stamp_error) };
        Self {
            stamp_error,
            rate_limit: limit,
            rate_change: config.max_rate_change,
            now,
            rate: Interval::around(0, limit),
            earlier: [now; WINDOW],
            newest: 0,
        }
    }

    /// For the time scale that `clock` itself defines, which is known exactly.
    pub(super) fn exact(config: &SyncConfig, at: Instant, clock: &GlobalClock) -> Self {
        let mut estimate = Self::new(config, at, clock.to_global(at));
        estimate.now.offset = Interval::around(offset(at, clock.to_global(at)), 1);
        estimate.earlier = [estimate.now; WINDOW];
        estimate.rate = Interval::around(clock.rate().fraction().into(), 0);
        estimate
    }

    /// Takes in another pair of time-stamps. Work: one step for each of the [`WINDOW`] earlier points, with
    /// two divisions.
    ///
    /// # Errors
    /// If the pair contradicts what is known. Then nothing has changed.
    #[expect(clippy::arithmetic_side_effects, reason = "below `WINDOW`, which is not zero")]
    pub(super) fn observe(
        &mut self,
        received_at: Instant,
        sent_at: GlobalInstant,
    ) -> Result<(), Implausible> {
        let predicted = self.moved_to(received_at).ok_or(Implausible)?;
        let measured = Interval::around(offset(received_at, sent_at), self.stamp_error);
        let offset = predicted.now.offset.intersection(measured).ok_or(Implausible)?;
        let now = Point { at: received_at, offset };
        let mut rate = predicted.rate;
        for seen in [self.now].iter().chain(&self.earlier) {
            if let Some(bounds) = seen.rate_at(&now, self.rate_change) {
                rate = rate.intersection(bounds).ok_or(Implausible)?;
            }
        }
        self.newest = (self.newest + 1) % WINDOW;
        if let Some(oldest) = self.earlier.get_mut(self.newest) {
            *oldest = self.now;
        }
        self.now = now;
        self.rate = rate;
        Ok(())
    }

    /// From `at` on another master continues the time scale, within `distance` of it and with a rate
    /// within `rate_error` of it. `None` if too much time has passed.
    pub(super) fn continued(&self, at: Instant, distance: Duration, rate_error: i32) -> Option<Self> {
        let mut moved = self.moved_to(at)?;
        moved.now.offset = moved.now.offset.widened(i64::try_from(distance.as_ticks()).ok()?);
        moved.rate = moved.rate.widened(rate_error.into()).intersection(self.any_rate())?;
        // Their offsets are those of the old scale.
        moved.earlier = [moved.now; WINDOW];
        Some(moved)
    }

    /// The clock through the middle of what is possible, with `more` distance from global time added to
    /// its error.
    pub(super) fn clock(&self, more: Duration, more_rate: i32, valid_until: Instant) -> GlobalClock {
        let global = GlobalInstant::EPOCH
            .offset_by(self.now.at.since_epoch().as_ticks().cast_signed())
            .offset_by(self.now.offset.centre());
        // The centre of the rate may be rounded, by less than a unit.
        let rate_error = self.rate.radius().cast_signed().wrapping_add(1);
        let uncertainty = Uncertainty {
            error: Duration::from_ticks(self.now.offset.radius().saturating_add(more.as_ticks())),
            rate_error: Rate::from_fraction(rate_error.wrapping_add(more_rate.into())),
            rate_change: self.rate_change,
            valid_until,
        };
        GlobalClock::new(self.now.at, global, Rate::from_fraction(self.rate.centre()), uncertainty)
    }

    /// What is known at a later instant without further observation. `None` if it is earlier, or too
    /// late.
    #[expect(clippy::arithmetic_side_effects, reason = "far below 63 bits: see `gain`")]
    fn moved_to(&self, at: Instant) -> Option<Self> {
        let span = at.signed_since(self.now.at);
        if !(0..=LONGEST_SPAN).contains(&span) {
            return None;
        }
        let change = i64::from(self.rate_change.over(Duration::from_ticks(span.cast_unsigned())));
        // On the way, the rate differs from that at its start by half of the change on the mean.
        let mean = self.rate.widened(change / 2 + 1).intersection(self.any_rate())?;
        let gain = |fraction: i64| rate::gain(i32::try_from(fraction).unwrap_or(0), span);
        let offset = Interval {
            low: self.now.offset.low.wrapping_add(gain(mean.low)),
            high: self.now.offset.high.wrapping_add(gain(mean.high) + 1),
        };
        let rate = self.rate.widened(change).intersection(self.any_rate())?;
        Some(Self { now: Point { at, offset }, rate, ..*self })
    }

    const fn any_rate(&self) -> Interval {
        Interval::around(0, self.rate_limit)
    }
}

const fn offset(local: Instant, global: GlobalInstant) -> i64 {
    global.since_epoch().as_ticks().wrapping_sub(local.since_epoch().as_ticks()).cast_signed()
}

/// How many earlier points are kept. More would help little: over a longer time the rate itself changes.
const WINDOW: usize = 8;

/// The longest span, in nanoseconds, over which the rate is extrapolated: 68 s. Longer than the longest
/// holdover.
const LONGEST_SPAN: i64 = 68_000_000_000;
