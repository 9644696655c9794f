//! How many faults may hit the bus.

use cosmic_core::time::Duration;

/// A bound on the faults in any interval. A fault destroys the frame on the wire, which is sent again.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum ErrorModel {
    /// None.
    #[default]
    None,
    /// `burst` at once, then one every `interval` (Tindell and Burns 1994): in an interval `t` there are
    /// at most `burst + ceil(t / interval) - 1`.
    Burst {
        /// How many come at once.
        burst: u32,
        /// The distance of two after that.
        interval: Duration,
    },
    /// At most `count` in any half-open window of length `window`: in an interval `t` there are at most
    /// `count * ceil(t / window)`.
    Window {
        /// How many.
        count: u32,
        /// In how long.
        window: Duration,
    },
}

impl ErrorModel {
    /// F(t): the most faults in any interval of length `span`; none in an empty one. Saturates.
    pub fn faults_within(&self, span: u64) -> u64 {
        match *self {
            _ if span == 0 => 0,
            Self::None => 0,
            Self::Burst { burst, interval } => {
                u64::from(burst).saturating_add(span.div_ceil(interval.as_ticks().max(1)) - 1)
            }
            Self::Window { count, window } => {
                u64::from(count).saturating_mul(span.div_ceil(window.as_ticks().max(1)))
            }
        }
    }

    /// Faults in the long run, per nanosecond.
    pub fn rate(&self) -> f64 {
        match *self {
            Self::None => 0.0,
            Self::Burst { interval, .. } => 1.0 / interval.as_ticks().max(1) as f64,
            Self::Window { count, window } => f64::from(count) / window.as_ticks().max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_in_an_interval() {
        let burst = ErrorModel::Burst { burst: 2, interval: Duration::from_ticks(10) };
        assert_eq!([0, 1, 10, 11, 20, 21].map(|t| burst.faults_within(t)), [0, 2, 2, 3, 3, 4]);
        let window = ErrorModel::Window { count: 3, window: Duration::from_ticks(10) };
        assert_eq!([0, 1, 10, 11].map(|t| window.faults_within(t)), [0, 3, 3, 6]);
        assert_eq!(ErrorModel::None.faults_within(u64::MAX), 0);
    }
}
