//! The global clock: local time to global time and back, and how far it may be off.
//!
//! A [`GlobalClock`] is a straight line through one pair of instants, with the bound ε on its distance
//! from global time. The clock synchronisation makes a new one with every synchronisation;
//! the owner copies it to both halves of the node. It is a value: an old copy stays usable, its ε just
//! grows.
//!
//! All numbers are integers; a conversion is two to six multiplications of 32 bits, without division.

use super::{Duration, GlobalInstant, Instant, Rate, RateChange, rate};

/// What is not known of a global clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Uncertainty {
    /// The distance from global time at the reference instant is at most this.
    pub error: Duration,
    /// The rate at the reference instant is wrong by at most this, either way.
    pub rate_error: Rate,
    /// The true rate changes by at most this.
    pub rate_change: RateChange,
    /// From here on nothing is known any more.
    pub valid_until: Instant,
}

impl Uncertainty {
    /// The clock *is* global time.
    pub const NONE: Self = Self {
        error: Duration::from_ticks(0),
        rate_error: Rate::ZERO,
        rate_change: RateChange::ZERO,
        valid_until: Instant::FAR_FUTURE,
    };
    /// Nothing is known.
    pub const COMPLETE: Self = Self { error: Duration::MAX, valid_until: Instant::EPOCH, ..Self::NONE };
}

/// Global time as a function of local time, with its accuracy.
///
/// ```text
/// global = reference.global + (local − reference.local) · (1 + rate)
/// ε(t)   = error + rate error · t + ½ rate change · t²      t = |local − reference.local|
/// ```
///
/// ```
/// use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate, Uncertainty};
///
/// let now = Instant::from_epoch(Duration::from_secs(5));
/// let then = GlobalInstant::from_epoch(Duration::from_secs(700));
/// let clock = GlobalClock::new(now, then, Rate::from_parts_per_billion(20_000), Uncertainty::NONE);
/// let later = now + Duration::from_secs(1);
/// let gained = clock.to_global(later).signed_since(then + Duration::from_secs(1));
/// assert!((19_998..=20_000).contains(&gained));
/// assert!(clock.to_local(clock.to_global(later)).signed_since(later).abs() <= 1);
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GlobalClock {
    local: Instant,
    global: GlobalInstant,
    rate: Rate,
    inverse: Rate,
    uncertainty: Uncertainty,
}

impl GlobalClock {
    /// The distance of a clock that knows nothing.
    pub const UNKNOWN: Duration = Duration::MAX;

    /// Global time is local time, exactly: for a master alone, and where there is one clock only.
    pub const fn free_running() -> Self {
        Self::new(Instant::EPOCH, GlobalInstant::EPOCH, Rate::ZERO, Uncertainty::NONE)
    }

    /// Nothing is known of global time yet. Conversions are those of [`GlobalClock::free_running`].
    pub const fn unsynchronised() -> Self {
        Self::new(Instant::EPOCH, GlobalInstant::EPOCH, Rate::ZERO, Uncertainty::COMPLETE)
    }

    /// The clock that is at `global` when local time is `local`, and runs faster than it by `rate`.
    ///
    /// One 64-bit division; not for the hot path.
    pub const fn new(local: Instant, global: GlobalInstant, rate: Rate, uncertainty: Uncertainty) -> Self {
        Self { local, global, rate, inverse: rate.inverse(), uncertainty }
    }

    /// The same clock with another uncertainty.
    pub const fn with_uncertainty(self, uncertainty: Uncertainty) -> Self {
        Self { uncertainty, ..self }
    }

    /// How much faster than local time it runs.
    pub const fn rate(&self) -> Rate {
        self.rate
    }

    /// What is not known of it.
    pub const fn uncertainty(&self) -> Uncertainty {
        self.uncertainty
    }

    /// The global time at a local instant. Monotone for one and the same clock; the next clock may
    /// differ from this one by what both are off. O(1), no division.
    #[inline]
    pub const fn to_global(&self, local: Instant) -> GlobalInstant {
        let span = local.signed_since(self.local);
        self.global.offset_by(span.wrapping_add(self.rate.gain(span)))
    }

    /// The local instant of a global time: the inverse of [`GlobalClock::to_global`] to one nanosecond
    /// over hours, and monotone. O(1), no division.
    #[inline]
    pub const fn to_local(&self, global: GlobalInstant) -> Instant {
        let span = global.signed_since(self.global);
        let span = if span.wrapping_add(1 << 30).cast_unsigned() >> 31 == 0 {
            let (low, start) =
                (global.since_epoch().as_ticks() as u32, self.global.since_epoch().as_ticks() as u32);
            self.near_span(low.wrapping_sub(start).cast_signed()) as i64
        } else {
            self.local_span(span)
        };
        self.local.offset_by(span)
    }

    /// How long a global span is in local time. The inverse rate is rounded, which shows after seconds; but the local span
    /// that it gives is near enough to ask for what this clock gains in it.
    #[inline]
    const fn local_span(&self, span: i64) -> i64 {
        span.wrapping_sub(self.rate.gain(span.wrapping_add(self.inverse.gain(span))))
    }

    /// As [`local_span`](Self::local_span), in 32 bits, for a span of about a second either way: as all are between two
    /// synchronisations.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "a gain is at most a thousandth of a span")]
    const fn near_span(&self, span: i32) -> i32 {
        span - self.rate.gain_near(span + self.inverse.gain_near(span))
    }

    /// ε: at the local instant `now` this clock is no further than this from global time.
    /// [`GlobalClock::UNKNOWN`] if it is not synchronised. O(1), no division.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "rates and their changes are at most 23 and 31 bits")]
    pub const fn accuracy(&self, now: Instant) -> Duration {
        let Uncertainty { error, rate_error, rate_change, .. } = self.uncertainty;
        if !self.is_synchronised(now) {
            return Self::UNKNOWN;
        }
        if rate_error.fraction() == 0 && rate_change.is_zero() {
            return error;
        }
        let span = now.signed_since(self.local).unsigned_abs();
        // The mean of the rate error from the reference until now, rounded up.
        let mean = rate_error.fraction() + (rate_change.over(Duration::from_ticks(span)) + 1) / 2;
        let grown = rate::gain(mean, span as i64) + 1;
        Duration::from_ticks(error.as_ticks().saturating_add(grown.unsigned_abs()))
    }

    /// Returns whether this clock is within `bound` of global time at all local instants from `from` until
    /// `until`. O(1), no division.
    #[inline]
    pub(crate) fn is_accurate(&self, from: Instant, until: Instant, bound: Duration) -> bool {
        // The accuracy gets worse with the distance from the reference, so it is worst at one of the ends.
        self.accuracy(until) <= bound && (from >= self.local || self.accuracy(from) <= bound)
    }

    /// The rate at the local instant `now` is wrong by at most this, either way. `None` if the clock is not
    /// synchronised.
    #[expect(clippy::arithmetic_side_effects, reason = "31 bits in 64")]
    pub const fn rate_error(&self, now: Instant) -> Option<Rate> {
        if !self.is_synchronised(now) {
            return None;
        }
        let Uncertainty { rate_error, rate_change, .. } = self.uncertainty;
        let span = Duration::from_ticks(now.signed_since(self.local).unsigned_abs());
        Some(Rate::from_fraction(rate_error.fraction() as i64 + rate_change.over(span) as i64))
    }

    /// Returns whether anything is known of global time at the local instant `now`. How much, tells
    /// [`GlobalClock::accuracy`].
    #[inline]
    pub const fn is_synchronised(&self, now: Instant) -> bool {
        now.since_epoch().as_ticks() < self.uncertainty.valid_until.since_epoch().as_ticks()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SECOND: u64 = 1_000_000_000;

    fn local(nanoseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_ticks(nanoseconds))
    }

    fn global(nanoseconds: u64) -> GlobalInstant {
        GlobalInstant::from_epoch(Duration::from_ticks(nanoseconds))
    }

    #[test]
    fn a_free_running_clock_is_local_time() {
        let clock = GlobalClock::free_running();
        for at in [0, 1, SECOND, 1 << 60] {
            assert_eq!(clock.to_global(local(at)), global(at));
            assert_eq!(clock.to_local(global(at)), local(at));
            assert_eq!(clock.accuracy(local(at)), Duration::from_ticks(0));
            assert!(clock.is_synchronised(local(at)));
        }
    }

    #[test]
    fn an_unsynchronised_clock_says_so() {
        let clock = GlobalClock::unsynchronised();
        assert!(!clock.is_synchronised(local(0)));
        assert_eq!(clock.accuracy(local(SECOND)), GlobalClock::UNKNOWN);
        assert_eq!(clock.to_global(local(7)), global(7));
    }

    #[test]
    fn accuracy_grows_from_the_reference_until_nothing_is_known() {
        let uncertainty = Uncertainty {
            error: Duration::from_ticks(1_000),
            rate_error: Rate::from_parts_per_billion(4_000),
            rate_change: RateChange::from_parts_per_billion(2_000),
            valid_until: local(12 * SECOND),
        };
        let clock = GlobalClock::new(local(10 * SECOND), global(0), Rate::ZERO, uncertainty);
        let error = |at| clock.accuracy(local(at)).as_ticks();
        assert!((1_000..=1_002).contains(&error(10 * SECOND)));
        // 1000 + 400 + 10 ns, either way from the reference.
        assert!((1_410..=1_413).contains(&error(10 * SECOND + SECOND / 10)));
        assert!((1_410..=1_413).contains(&error(10 * SECOND - SECOND / 10)));
        assert!((6_000..=6_005).contains(&error(11 * SECOND)));
        assert_eq!(clock.accuracy(local(12 * SECOND)), GlobalClock::UNKNOWN);
        assert!(!clock.is_synchronised(local(12 * SECOND)));
    }

    fn clocks() -> impl Strategy<Value = GlobalClock> {
        let limit = i64::from(Rate::LIMIT.fraction());
        (0..1u64 << 62, 0..1u64 << 62, -limit..=limit).prop_map(|(at, then, rate)| {
            GlobalClock::new(local(at), global(then), Rate::from_fraction(rate), Uncertainty::NONE)
        })
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_same_instant(clock in clocks(), span in -(1i64 << 43)..1 << 43) {
            let at = clock.local.offset_by(span);
            let back = clock.to_local(clock.to_global(at));
            prop_assert!(back.signed_since(at).abs() <= 1, "{}", back.signed_since(at));
            let then = clock.global.offset_by(span);
            let back = clock.to_global(clock.to_local(then));
            prop_assert!(back.signed_since(then).abs() <= 1, "{}", back.signed_since(then));
        }

        #[test]
        fn near_spans_are_converted_as_any(clock in clocks(), span in -(1i32 << 30)..1 << 30) {
            prop_assert_eq!(i64::from(clock.near_span(span)), clock.local_span(span.into()));
        }

        #[test]
        fn near_and_far_instants_are_converted_alike(clock in clocks(), span in -(1i64 << 31)..1 << 31) {
            let then = clock.global.offset_by(span);
            prop_assert_eq!(clock.to_local(then), clock.local.offset_by(clock.local_span(span)));
        }

        #[test]
        fn conversions_are_monotone(clock in clocks(), span in -(1i64 << 50)..1 << 50, step in 0i64..5_000) {
            let (first, second) = (clock.local.offset_by(span), clock.local.offset_by(span + step));
            prop_assert!(clock.to_global(second).signed_since(clock.to_global(first)) >= 0);
            let (first, second) = (clock.global.offset_by(span), clock.global.offset_by(span + step));
            prop_assert!(clock.to_local(second).signed_since(clock.to_local(first)) >= 0);
        }

        #[test]
        fn any_instants_convert_without_a_panic(
            at in any::<u64>(), then in any::<u64>(), rate in any::<i64>(), now in any::<u64>(),
        ) {
            let uncertainty = Uncertainty {
                error: Duration::MAX,
                rate_error: Rate::LIMIT,
                rate_change: RateChange::LIMIT,
                valid_until: Instant::FAR_FUTURE,
            };
            let clock = GlobalClock::new(local(at), global(then), Rate::from_fraction(rate), uncertainty);
            let _ = (clock.to_global(local(now)), clock.to_local(global(now)));
            prop_assert_eq!(clock.accuracy(local(now)), Duration::MAX);
        }
    }
}
