//! What comes again and again on a bus, and what else takes its time.

use super::calendar_load::CalendarLoad;
use super::errors::ErrorModel;

/// Frames that come again and again. Spans are in nanoseconds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Stream {
    /// C: the longest time that the frame takes, inter-frame space included.
    pub transmission: u64,
    /// T: the least distance of two nominal instants.
    pub period: u64,
    /// J: how late after its nominal instant the frame may be queued.
    pub jitter: u64,
}

impl Stream {
    /// How many frames can be queued in a window of length `span`, both ends included up to `bit`.
    pub(super) fn arrivals(&self, span: u64, bit: u64) -> u64 {
        span.saturating_add(self.jitter).saturating_add(bit).div_ceil(self.period)
    }

    /// The share of time that it takes.
    pub fn utilisation(&self) -> f64 {
        self.transmission as f64 / self.period as f64
    }
}

/// What holds for all frames on a bus. Spans are in nanoseconds.
#[derive(Clone, Debug)]
pub struct Bus {
    /// The time of one bit.
    pub bit: u64,
    /// E: from the detection of an error until the next frame can start, at worst.
    pub recovery: u64,
    /// How many faults there may be.
    pub errors: ErrorModel,
    /// The hard real-time frames.
    pub calendar: CalendarLoad,
}

impl Bus {
    /// What faults in a window of length `span` cost, if each destroys a frame of at most `longest`.
    pub(super) fn error_overhead(&self, span: u64, longest: u64) -> u64 {
        self.errors.faults_within(span).saturating_mul(self.recovery + longest)
    }

    /// What faults and hard real-time frames cost in the long run, as a share of time.
    pub(super) fn background(&self, longest: u64) -> f64 {
        self.errors.rate() * (self.recovery + longest) as f64 + self.calendar.utilisation()
    }
}

/// Solves `x = f(x)` for the least solution from `start` up, where `f` never falls as `x` grows. `None`
/// if it exceeds `limit`, or `steps` are used up.
pub(super) fn fixed_point(start: u64, limit: u64, steps: &mut u64, f: impl Fn(u64) -> u64) -> Option<u64> {
    let mut x = start;
    loop {
        let next = f(x).max(start);
        if next <= x {
            return Some(x);
        }
        *steps = steps.checked_sub(1)?;
        if next > limit {
            return None;
        }
        x = next;
    }
}

/// No response is longer than this (about 26 days): what exceeds it is unbounded.
pub(super) const UNBOUNDED: u64 = u64::MAX >> 13;
