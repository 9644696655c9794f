//! How old an event is that was sent by a clock that is not ours.
//!
//! Segments have no common clock, and need none. Whoever sends events also answers the question what its clock says. Of
//! one question and its answer, asked at `a` and received at `r` of our clock and answered at `s` of theirs, this much is
//! certain, however unequal the two ways were: their clock was not further ahead of ours than `s − a`, for the answer was
//! given after the question. So an event that was stamped `t` by their clock and is seen at `n` by ours is
//!
//! ```text
//! not older than  n + (s − a) − t
//! ```
//!
//! plus what the two clocks have drifted since. That bound is never less than the age, and more by at most the round trip
//! `r − a`. Of several answers the one with the lowest bound is kept. An event is discarded when it *may* have expired:
//! none that has expired is let through.
//!
//! The clock is the kernel's of the time since boot: it does not step, and goes on while the machine sleeps. Where a clock
//! steps all the same (a virtual machine that is put back to an earlier state), the next answer contradicts what was
//! known before, and takes its place: for as long as it takes to ask, ages are wrong by the step.

use cosmic_core::time::Duration;

/// What a clock says, in nanoseconds. Readings of different clocks have nothing to do with each other.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Reading(pub u64);

impl Reading {
    /// What our clock says now.
    pub fn now() -> Self {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
        let seconds = u64::try_from(now.tv_sec).unwrap_or(0);
        Self(seconds * 1_000_000_000 + u64::try_from(now.tv_nsec).unwrap_or(0))
    }

    /// The span from an earlier reading of the same clock; zero if it is later.
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_ticks(self.0.saturating_sub(earlier.0))
    }
}

/// A question and its answer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Exchange {
    /// By our clock.
    pub asked_at: Reading,
    /// By their clock.
    pub answered_at: Reading,
    /// By our clock.
    pub received_at: Reading,
}

impl Exchange {
    /// The answer was given before it was received.
    fn ahead_at_least(self) -> i128 {
        i128::from(self.answered_at.0) - i128::from(self.received_at.0)
    }
}

/// What is known of the clock of another.
#[derive(Clone, Copy, Debug)]
pub struct PeerClock {
    best: Exchange,
}

impl PeerClock {
    /// After the first answer.
    pub const fn new(first: Exchange) -> Self {
        Self { best: first }
    }

    /// Another answer has come. It is kept if it says more than what is known, which gets worse with time; or if it
    /// contradicts that: then one of the clocks has stepped, and what was known is of no use any more.
    pub fn note(&mut self, exchange: Exchange) {
        let now = exchange.received_at;
        let known = self.ahead_at_most(now);
        if Self::new(exchange).ahead_at_most(now) <= known || exchange.ahead_at_least() > known {
            self.best = exchange;
        }
    }

    /// Not less than the age of what they stamped with `sent_at`; `None` if that is in their future, so the stamp is
    /// wrong.
    pub fn age_at_most(&self, sent_at: Reading, now: Reading) -> Option<Duration> {
        let age = i128::from(now.0) + self.ahead_at_most(now) - i128::from(sent_at.0);
        u64::try_from(age).ok().map(Duration::from_ticks)
    }

    /// How much more than the age [`age_at_most`](Self::age_at_most) may say.
    pub fn uncertainty(&self, now: Reading) -> Duration {
        let round_trip = self.best.received_at.since(self.best.asked_at);
        round_trip + Duration::from_ticks(self.drifted(now).saturating_mul(2))
    }

    /// How far their clock is ahead of ours, at most; negative if it is behind.
    fn ahead_at_most(&self, now: Reading) -> i128 {
        let Exchange { asked_at, answered_at, .. } = self.best;
        i128::from(answered_at.0) - i128::from(asked_at.0) + i128::from(self.drifted(now))
    }

    fn drifted(&self, now: Reading) -> u64 {
        now.since(self.best.asked_at).as_ticks() / DRIFT
    }
}

/// Two clocks drift apart by less than a thousandth: the kernel steers each by half of that at most.
const DRIFT: u64 = 1000;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    fn exchange(asked: u64, answered: u64, received: u64) -> Exchange {
        Exchange { asked_at: Reading(asked), answered_at: Reading(answered), received_at: Reading(received) }
    }

    #[test]
    fn an_age_is_never_told_too_low_however_unequal_the_ways_are() {
        // Their clock is 1000 ms ahead; the question takes 1 ms, the answer 200 ms.
        let clock = PeerClock::new(exchange(0, 1001 * MS, 201 * MS));
        let age = clock.age_at_most(Reading(1300 * MS), Reading(310 * MS)).unwrap();
        assert_eq!(age.as_ticks(), 11 * MS + 310_000, "10 ms, 1 ms of the question, drift");
        // The other way round: the question takes 200 ms.
        let clock = PeerClock::new(exchange(0, 1200 * MS, 201 * MS));
        let age = clock.age_at_most(Reading(1300 * MS), Reading(310 * MS)).unwrap();
        assert_eq!(age.as_ticks(), 210 * MS + 310_000);
        assert!(age.as_ticks() - 10 * MS <= clock.uncertainty(Reading(310 * MS)).as_ticks());
    }

    #[test]
    fn the_best_answer_is_kept_until_drift_has_eaten_what_it_was_better() {
        let mut clock = PeerClock::new(exchange(0, MS, 2 * MS));
        clock.note(exchange(100 * MS, 150 * MS, 160 * MS));
        assert_eq!(clock.ahead_at_most(Reading(0)), i128::from(MS), "the first was better");
        clock.note(exchange(60_000 * MS, 60_050 * MS, 60_060 * MS));
        assert_eq!(clock.ahead_at_most(Reading(0)), i128::from(50 * MS), "a minute later it is not");
    }

    #[test]
    fn a_clock_that_steps_is_believed_until_it_is_asked_again() {
        let mut clock = PeerClock::new(exchange(0, MS, 2 * MS));
        // A second later theirs is five seconds ahead: all it stamps would be too fresh for over an hour.
        clock.note(exchange(1000 * MS, 6001 * MS, 1002 * MS));
        let age = clock.age_at_most(Reading(6001 * MS), Reading(1201 * MS)).unwrap();
        assert_eq!(age.as_ticks(), 201 * MS + 201_000);
        // And back again.
        clock.note(exchange(2000 * MS, 2001 * MS, 2002 * MS));
        let age = clock.age_at_most(Reading(2001 * MS), Reading(2201 * MS)).unwrap();
        assert_eq!(age.as_ticks(), 201 * MS + 201_000);
        // An answer that is only slow contradicts nothing.
        clock.note(exchange(2300 * MS, 2500 * MS, 2700 * MS));
        assert_eq!(clock.ahead_at_most(Reading(2000 * MS)), i128::from(MS));
    }

    #[test]
    fn a_stamp_of_the_future_is_none() {
        let clock = PeerClock::new(exchange(0, 0, 0));
        assert_eq!(clock.age_at_most(Reading(5 * MS), Reading(4 * MS)), None);
    }

    proptest! {
        /// Delays, drift and offset are any; the bound holds.
        #[test]
        fn the_bound_holds(
            offset in 0_u64..1_000_000_000_000, // their clock at our zero
            ppm in -900_i64..900,
            exchanges in proptest::collection::vec((0_u64..5_000, 0_u64..500, 0_u64..500), 1..20),
            sent in 0_u64..60_000,
            took in 0_u64..60_000,
        ) {
            let theirs = |ours: u64| {
                let gained = i128::from(ours) * i128::from(ppm) / 1_000_000;
                u64::try_from(i128::from(ours) + i128::from(offset) + gained + 1_000_000_000_000).unwrap()
            };
            let mut at = 0;
            let mut clock: Option<PeerClock> = None;
            for (pause, there, back) in exchanges {
                let asked = at + pause * MS;
                let (answered, received) = (asked + there * MS, asked + (there + back) * MS);
                at = received;
                let exchange = exchange(asked, theirs(answered), received);
                match &mut clock {
                    Some(clock) => clock.note(exchange),
                    None => clock = Some(PeerClock::new(exchange)),
                }
            }
            let clock = clock.unwrap();
            let sent = at + sent * MS;
            let now = sent + took * MS;
            let age = clock.age_at_most(Reading(theirs(sent)), Reading(now)).unwrap();
            prop_assert!(age.as_ticks() >= took * MS);
            prop_assert!(age.as_ticks() - took * MS <= clock.uncertainty(Reading(now)).as_ticks());
        }
    }
}
