//! What a node must know to take part in clock synchronisation.

use crate::can::BitRate;
use crate::protocol::Rank;
use crate::time::{Duration, Rate, RateChange};

/// Settings of [`ClockSync`](super::ClockSync). All but the rank are the same in all nodes of a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SyncConfig {
    /// This node's place in the succession of masters; `None`: it never becomes master.
    pub rank: Option<Rank>,
    /// The span between two sync frames.
    pub period: Duration,
    /// How far the difference of two time-stamps of one frame, the sender's and a receiver's, may be from
    /// the true difference of their clocks.
    ///
    /// For stamps that are late by 0..=d on both sides, and quantised by q, this is d + q, and what the frame
    /// needs along the cable: [`SyncConfig::stamp_error_for`] adds them up.
    pub stamp_error: Duration,
    /// How long before the sender of a frame its receivers stamp it: one bit.
    ///
    /// A receiver accepts a frame in the last but one bit of its end (ISO 11898-1), one bit before the sender
    /// is done. The stamps of received frames are corrected by this here, and nowhere else. Zero where a
    /// driver stamps the end itself. The services of a node take it from the calendar.
    pub bit_time: Duration,
    /// How far any oscillator is from its nominal frequency.
    pub max_drift: Rate,
    /// How fast the frequencies of two oscillators may drift apart: twice that of one.
    pub max_rate_change: RateChange,
    /// [`Calendar::digest`](crate::calendar::Calendar::digest), or 0 for a node without calendar.
    pub calendar_digest: u32,
}

/// Why settings are refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SyncConfigError {
    /// The period is outside [`SyncConfig::SHORTEST_PERIOD`]..=[`SyncConfig::LONGEST_PERIOD`].
    Period,
    /// The time-stamp error, or a bit, is over a hundredth of the period: choose a longer period.
    StampError,
    /// A rank for a [`ClockSync`](super::ClockSync) that is no candidate: it never becomes master.
    Rank,
    /// The drift is negative, or so large that rates leave the range of [`Rate`]. 100 parts in 10⁶ are
    /// accepted; with a smaller time-stamp error or rate change, more.
    Drift,
}

impl SyncConfig {
    /// The shortest period.
    pub const SHORTEST_PERIOD: Duration = Duration::from_millis(5);
    /// The longest period.
    pub const LONGEST_PERIOD: Duration = Duration::from_secs(10);

    /// Usual values: a sync frame every 100 ms, time-stamps of 1.25 µs (an interrupt within 1 µs and a
    /// timer of 4 MHz), crystals of ±100 parts in 10⁶ that change by 1 in 10⁶ per second. No rank, no
    /// calendar.
    pub const DEFAULT: Self = Self {
        rank: None,
        period: Duration::from_millis(100),
        stamp_error: Duration::from_ticks(1_250),
        bit_time: Duration::from_ticks(0),
        max_drift: Rate::from_parts_per_billion(100_000),
        max_rate_change: RateChange::from_parts_per_billion(2_000),
        calendar_digest: 0,
    };

    /// The bound on the error of time-stamps that are taken `latency` after the interrupt at the latest, the
    /// resolution of the timer included.
    ///
    /// A frame reaches the receivers later than its sender, by its way along the cable, which the bit timing
    /// must hold there and back in the part of a bit before the sample point: one way, three eighths of a
    /// bit at most, with the time quantum by which a receiver meets its edges.
    pub const fn stamp_error_for(bit_rate: BitRate, latency: Duration) -> Duration {
        Duration::from_ticks(latency.as_ticks().saturating_add(bit_rate.bits(3).as_ticks() / 8))
    }

    /// Checks the settings; in a constant, at compile time.
    ///
    /// # Errors
    /// The first setting that is refused.
    #[expect(clippy::arithmetic_side_effects, reason = "drifts are at most [`Rate::LIMIT`], 23 bits")]
    pub const fn check(&self) -> Result<(), SyncConfigError> {
        let period = self.period.as_ticks();
        if period < Self::SHORTEST_PERIOD.as_ticks() || period > Self::LONGEST_PERIOD.as_ticks() {
            return Err(SyncConfigError::Period);
        }
        if self.stamp_error.as_ticks() > period / 100 || self.bit_time.as_ticks() > period / 100 {
            return Err(SyncConfigError::StampError);
        }
        let widest = 4 * self.max_drift.fraction() as i64 + self.takeover_rate_error() as i64;
        if self.max_drift.fraction() < 0 || widest > Rate::LIMIT.fraction() as i64 {
            return Err(SyncConfigError::Drift);
        }
        Ok(())
    }

    /// The rate of a master's time scale against any node's local time is within ± this.
    ///
    /// A master that has taken over keeps the rate of its predecessor, within two drifts of its own; its
    /// own and the other node's oscillator make it four.
    #[expect(clippy::arithmetic_side_effects, reason = "a drift is at most [`Rate::LIMIT`], 23 bits")]
    pub(super) const fn rate_limit(&self) -> i32 {
        4 * self.max_drift.fraction()
    }

    /// The rate correction that a master may keep from the time when it was a follower, either way.
    #[expect(clippy::arithmetic_side_effects, reason = "a drift is at most [`Rate::LIMIT`], 23 bits")]
    pub(super) const fn master_rate_limit(&self) -> i32 {
        2 * self.max_drift.fraction()
    }

    /// A master continues a time scale if it knows its rate this well until the end of the handover.
    /// Four periods of observation suffice.
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "periods and errors of stamps fit 34 bits, which `check` says; rates have 31"
    )]
    pub(super) const fn takeover_rate_error(&self) -> i32 {
        // A period of zero is refused elsewhere.
        let observed = match ((2 * self.stamp_error.as_ticks()) << 32).checked_div(4 * self.period.as_ticks())
        {
            Some(fraction) => fraction as i32,
            None => Rate::LIMIT.fraction(),
        };
        observed + self.max_rate_change.over(self.periods(8 + 5 + Self::HOLDOVER_PERIODS + 1))
    }

    /// A master that is silent for this long is lost.
    pub(super) const fn loss_time_out(&self) -> Duration {
        self.periods(3)
    }

    /// A candidate without synchronised clock waits this long before it starts a time scale of its own. By
    /// then every candidate that could have continued the old one has done so, and no node follows it.
    pub(super) const fn cold_start_time_out(&self) -> Duration {
        self.periods(8)
    }

    /// How much longer than the first one this candidate waits: an eighth of a period for each rank.
    #[expect(clippy::arithmetic_side_effects, reason = "an eighth of a period for each of few ranks")]
    pub(super) const fn rank_delay(&self, rank: Rank) -> Duration {
        Duration::from_ticks(self.period.as_ticks() / 8 * rank.get() as u64)
    }

    /// A clock is valid for this long after a synchronisation. Longer than the time-out of the last
    /// candidate.
    pub(super) const fn holdover(&self) -> Duration {
        self.periods(Self::HOLDOVER_PERIODS)
    }

    /// So long after its start a master's time scale is the only one: a node that heard the old master three
    /// periods after this one has run out by now, with a period to spare.
    pub(super) const fn handover(&self) -> Duration {
        self.periods(Self::HOLDOVER_PERIODS + 1)
    }

    /// After a master has yielded, a node that has not heard the new one may take over from it as long as
    /// it is synchronised, and names it as its predecessor until the end of the handover. A period is to
    /// spare.
    pub(super) const fn given_up(&self) -> Duration {
        self.periods(Self::HOLDOVER_PERIODS + (Self::HOLDOVER_PERIODS + 1) + 1)
    }

    /// So many periods; a few.
    #[expect(clippy::arithmetic_side_effects, reason = "a period fits 34 bits, which `check` says")]
    pub(super) const fn periods(&self, count: u64) -> Duration {
        Duration::from_ticks(self.period.as_ticks() * count)
    }

    const HOLDOVER_PERIODS: u64 = 6;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_values_are_accepted() {
        const { assert!(SyncConfig::DEFAULT.check().is_ok()) };
        // 6.25 parts in 10^6 from four periods, 4.0 from 2 s at 2 in 10^6 per second.
        let takeover = f64::from(SyncConfig::DEFAULT.takeover_rate_error()) / 4_294.967_296;
        assert!((10.2..10.4).contains(&takeover), "{takeover}");
    }

    #[test]
    fn each_wrong_setting_is_named() {
        let good = SyncConfig::DEFAULT;
        let wrong = [
            (SyncConfig { period: Duration::from_ticks(0), ..good }, SyncConfigError::Period),
            (SyncConfig { period: Duration::MAX, ..good }, SyncConfigError::Period),
            (SyncConfig { stamp_error: Duration::MAX, ..good }, SyncConfigError::StampError),
            (SyncConfig { bit_time: Duration::MAX, ..good }, SyncConfigError::StampError),
            (SyncConfig { max_drift: Rate::LIMIT, ..good }, SyncConfigError::Drift),
            (SyncConfig { max_drift: Rate::from_fraction(-1), ..good }, SyncConfigError::Drift),
            (SyncConfig { max_rate_change: RateChange::LIMIT, ..good }, SyncConfigError::Drift),
        ];
        for (config, error) in wrong {
            assert_eq!(config.check(), Err(error));
        }
    }

    #[test]
    fn the_last_candidate_acts_within_the_holdover() {
        let config = SyncConfig::DEFAULT;
        let last = config.loss_time_out() + config.rank_delay(Rank::LAST);
        assert!(last < config.holdover() && config.holdover() < config.cold_start_time_out());
    }
}
