//! How often events of a channel come: what a publisher announces, and what its node holds it to.
//!
//! A soft or non real-time channel may state its *event rate* (COSMIC section III-A asks for it). The publisher's
//! node then takes no more events than that, so an application that runs wild harms its own channel and not the
//! bus; and a subscriber of a periodic soft real-time channel is told of an event that does not come.
//!
//! What is enforced is what an analysis counts: a channel of the interval T, jitter J and bursts of b events is
//! published at most `b − 1 + ⌈(t + J) / T⌉` times in any span t. It is a token bucket in one instant: the
//! *nominal* instant of the next event, which each event moves on by T from itself or from now, whichever is
//! later. An event may come before its nominal instant by the tolerance J + (b − 1) T, and not earlier.
//!
//! ```
//! use cosmic_core::event_layer::EventRate;
//! use cosmic_core::time::Duration;
//!
//! const HEAT: EventRate = EventRate::periodic(Duration::from_millis(20)).with_jitter(Duration::from_micros(200));
//! const ALARM: EventRate = EventRate::sporadic(Duration::from_millis(100)).with_burst(3);
//! ```
//!
//! Local clocks run a little fast or slow. So the publisher is allowed a [4096th](EventRate::interval) more than it
//! announced, and a subscriber waits a little longer than one interval.

use super::attributes::SoftAttributes;
use crate::time::{Duration, Instant};

/// How often events of a channel come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EventRate {
    interval: Duration,
    /// How far before its nominal instant an event may come: jitter, and what a burst takes.
    tolerance: Duration,
    periodic: bool,
}

impl EventRate {
    /// The longest interval and the longest tolerance.
    pub const LONGEST: Duration = Duration::from_secs(3600 * 24 * 3660);

    /// One event in every period.
    pub const fn periodic(period: Duration) -> Self {
        Self { periodic: true, ..Self::sporadic(period) }
    }

    /// Events come at least this far apart.
    pub const fn sporadic(min_interarrival: Duration) -> Self {
        assert!(!min_interarrival.is_zero(), "events do not come infinitely often");
        assert!(
            min_interarrival.as_ticks() <= Self::LONGEST.as_ticks(),
            "more than ten years between events"
        );
        Self { interval: min_interarrival, tolerance: Duration::from_ticks(0), periodic: false }
    }

    /// An event may be published this much later than its nominal instant, so the next one comes sooner behind it.
    #[must_use]
    pub const fn with_jitter(self, jitter: Duration) -> Self {
        self.with_more_tolerance(jitter.as_ticks())
    }

    /// So many events may come at once, and then one every interval: one at least.
    #[must_use]
    pub const fn with_burst(self, events: u8) -> Self {
        assert!(events >= 1, "a burst has one event at least");
        assert!(!self.periodic || events == 1, "a periodic channel has one event in every period");
        self.with_more_tolerance(self.interval.as_ticks().saturating_mul((events as u64).saturating_sub(1)))
    }

    const fn with_more_tolerance(self, ticks: u64) -> Self {
        let tolerance = self.tolerance.as_ticks().saturating_add(ticks);
        assert!(tolerance <= Self::LONGEST.as_ticks(), "jitter and burst of more than ten years");
        Self { tolerance: Duration::from_ticks(tolerance), ..self }
    }

    /// The period, or the least distance of two events.
    pub const fn interval(&self) -> Duration {
        self.interval
    }

    /// Returns whether every interval has an event.
    pub const fn is_periodic(&self) -> bool {
        self.periodic
    }

    /// How far before its nominal instant an event may come: jitter, and what a burst takes.
    pub const fn tolerance(&self) -> Duration {
        self.tolerance
    }

    /// The same with another interval, jitter and burst in time as they were; `None` if it is zero or too long.
    pub(crate) const fn with_interval(self, interval: Duration) -> Option<Self> {
        if interval.is_zero() || interval.as_ticks() > Self::LONGEST.as_ticks() {
            return None;
        }
        Some(Self { interval, ..self })
    }

    /// The interval as it is enforced: shorter, by what two oscillators may differ.
    pub(crate) const fn enforced(&self) -> Duration {
        let ticks = self.interval.as_ticks();
        Duration::from_ticks(ticks.saturating_sub(ticks / CLOCKS_DIFFER))
    }

    /// From one event to the instant at which the next is overdue, if each is sent by its deadline.
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "interval and tolerance are at most [`Self::LONGEST`], 59 bits"
    )]
    pub(super) const fn patience(&self, quality: &SoftAttributes) -> Duration {
        let ticks = self.interval.as_ticks();
        let span = ticks + ticks / CLOCKS_DIFFER + self.tolerance.as_ticks();
        Duration::from_ticks(span.saturating_add(quality.deadline.as_ticks()))
    }
}

/// What holds the events of a channel at one publisher to its rate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Guard {
    /// The nominal instant of the next event.
    nominal: Instant,
    /// An event that is being published has been charged, and is given back if it comes to nothing.
    charged: bool,
    /// The next event belongs to a message that has been charged as a whole.
    prepaid: bool,
}

impl Guard {
    /// With a full bucket.
    pub(super) const NEW: Self = Self { nominal: Instant::EPOCH, charged: false, prepaid: false };

    /// Charges an event, or says that it comes too early. O(1).
    #[expect(clippy::arithmetic_side_effects, reason = "interval and tolerance are of 59 bits")]
    pub(super) fn charge(&mut self, rate: &EventRate, now: Instant) -> bool {
        let interval = rate.enforced();
        let ahead = self.nominal.saturating_since(now);
        // No event brings the nominal instant further ahead, so the clock has gone back. The bucket is empty then,
        // but fills as always.
        let most = Duration::from_ticks(interval.as_ticks() + rate.tolerance.as_ticks());
        let ahead = ahead.min(most);
        let nominal = now + ahead;
        let conforms = ahead <= rate.tolerance;
        self.nominal = if conforms { nominal + interval } else { nominal };
        self.charged = conforms;
        conforms
    }

    /// Returns whether an event was ever charged: then a channel that is given up and announced again goes on from
    /// here, and has no fresh bucket.
    pub(super) fn is_in_use(&self) -> bool {
        self.nominal > Instant::EPOCH
    }

    /// The next event belongs to a message that has been charged as a whole.
    pub(super) fn prepay(&mut self) {
        self.prepaid = true;
    }

    /// Another event is to be published. Returns whether it is paid for.
    pub(super) fn begin(&mut self) -> bool {
        self.charged = false;
        core::mem::take(&mut self.prepaid)
    }

    /// Gives back what was charged for an event that was not published after all.
    pub(super) fn refund(&mut self, rate: &EventRate) {
        if core::mem::take(&mut self.charged) {
            self.nominal = self.nominal.saturating_sub(rate.enforced());
        }
    }
}

/// Two local clocks differ by no more than one tick in so many: 244 ppm.
const CLOCKS_DIFFER: u64 = 4096;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const fn us(microseconds: u64) -> Duration {
        Duration::from_micros(microseconds)
    }

    fn at(microseconds: u64) -> Instant {
        Instant::from_epoch(us(microseconds))
    }

    fn taken(rate: &EventRate, instants: &[u64]) -> std::vec::Vec<bool> {
        let mut guard = Guard::NEW;
        instants.iter().map(|&now| guard.charge(rate, at(now))).collect()
    }

    #[test]
    fn events_on_the_boundary() {
        let interval = us(4096);
        let sporadic = EventRate::sporadic(interval);
        // A 4096th of the interval is for the clocks.
        assert_eq!(taken(&sporadic, &[0, 4094, 4095, 8189, 8190]), [true, false, true, false, true]);
        let jittery = EventRate::periodic(interval).with_jitter(us(100));
        // Nominally at 0, 4095, 8190, ...; up to 100 us early, but never two in one tolerance.
        assert_eq!(taken(&jittery, &[0, 3994, 3995, 8089, 8090]), [true, false, true, false, true]);
        // After an event that was late the next may be on time again.
        assert_eq!(taken(&jittery, &[0, 4195, 8190, 8191]), [true, true, true, false]);
    }

    #[test]
    fn bursts_fill_again_one_by_one() {
        let rate = EventRate::sporadic(us(4096)).with_burst(3);
        assert_eq!(
            taken(&rate, &[0, 0, 0, 0, 4092, 4093, 4094]),
            [true, true, true, false, false, true, false]
        );
        // After a long silence there are three again, not more.
        assert_eq!(taken(&rate, &[0, 1 << 40, 1 << 40, 1 << 40, 1 << 40]), [true, true, true, true, false]);
    }

    #[test]
    fn a_clock_that_is_set_back_neither_blocks_nor_opens_the_channel() {
        let rate = EventRate::sporadic(us(4096)).with_burst(2);
        let mut guard = Guard::NEW;
        assert!(guard.charge(&rate, at(1 << 50)));
        // Back to the start: as after a full burst, and one interval later the first event.
        assert!(!guard.charge(&rate, at(10)));
        assert!(!guard.charge(&rate, at(10 + 4094)));
        assert!(guard.charge(&rate, at(10 + 4095)));
        assert!(!guard.charge(&rate, at(10 + 4096)));
    }

    #[test]
    fn at_the_end_of_the_time_scale_the_channel_stays_usable() {
        let rate = EventRate::sporadic(us(4096));
        let mut guard = Guard::NEW;
        let last = Instant::FAR_FUTURE.saturating_sub(us(10));
        assert!(guard.charge(&rate, last));
        // The nominal instant has wrapped. At worst one event more is taken, and then the rate holds again.
        assert!(guard.charge(&rate, at(5000)));
        assert!(!guard.charge(&rate, at(5001)));
    }

    #[test]
    fn what_was_not_published_is_given_back() {
        let rate = EventRate::sporadic(us(4096));
        let mut guard = Guard::NEW;
        assert!(guard.charge(&rate, at(0)));
        guard.refund(&rate);
        assert!(guard.charge(&rate, at(1)));
        assert!(!guard.charge(&rate, at(2)));
        guard.refund(&rate);
        assert!(!guard.charge(&rate, at(3)), "nothing was charged for the one that was refused");
    }

    proptest! {
        /// What an analysis counts: at most `b - 1 + ceil((t + J) / T)` in any span t, whatever is asked for.
        #[test]
        fn no_span_has_more_than_the_rate_allows(
            interval in 1_u64..5000,
            jitter in 0_u64..10_000,
            burst in 1_u8..5,
            gaps in prop::collection::vec(prop_oneof![0_u64..3, 0_u64..9000], 1..80),
        ) {
            let rate = EventRate::sporadic(Duration::from_ticks(interval))
                .with_jitter(Duration::from_ticks(jitter))
                .with_burst(burst);
            let enforced = rate.enforced().as_ticks();
            let mut guard = Guard::NEW;
            let (mut now, mut taken) = (1_000_000_u64, std::vec::Vec::new());
            for gap in gaps {
                now += gap;
                if guard.charge(&rate, Instant::from_epoch(Duration::from_ticks(now))) {
                    taken.push(now);
                }
            }
            let tolerance = jitter + u64::from(burst - 1) * interval;
            for (first, from) in taken.iter().enumerate() {
                for (last, until) in taken.iter().enumerate().skip(first) {
                    let (events, span) = (last - first + 1, until - from + 1);
                    let most = (span + tolerance).div_ceil(enforced);
                    prop_assert!(events as u64 <= most, "{events} in {span}, at most {most}");
                }
            }
        }

        /// An application that keeps its rate is never refused, late as it may be now and then.
        #[test]
        fn who_keeps_the_rate_is_never_refused(
            interval in 10_000_u64..50_000,
            lates in prop::collection::vec(0_u64..3000, 1..200),
        ) {
            let rate = EventRate::periodic(Duration::from_ticks(interval)).with_jitter(Duration::from_ticks(3000));
            let mut guard = Guard::NEW;
            for (number, late) in (0_u64..).zip(lates) {
                // Its clock runs 200 ppm fast.
                let now = number * (interval - interval / 5000) + late;
                prop_assert!(guard.charge(&rate, Instant::from_epoch(Duration::from_ticks(now))));
            }
        }
    }
}
