//! What the plan of a segment reserves: constants of `cosmic-plan`, and the functions of time that follow from them.
//!
//! All spans are in nanoseconds here, as in the analysis; sums saturate, so that what is out of range is refused.

use crate::can::{BitRate, ERROR_RECOVERY_BITS, LONGEST_FRAME_BITS};
use crate::time::Duration;
use crate::uid::Subject;

/// Frames that come again and again.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Load {
    /// C: how long one takes at worst, with the space behind it.
    pub transmission: Duration,
    /// T: the least distance of two nominal instants; not zero.
    pub interval: Duration,
    /// J: how far before its nominal instant a frame may come; jitter, and what a burst takes.
    pub tolerance: Duration,
}

impl Load {
    /// How many come in a window of this length, in nanoseconds.
    pub(super) const fn within(&self, span: u64) -> u64 {
        let interval = self.interval.as_ticks();
        let interval = if interval == 0 { 1 } else { interval };
        span.saturating_add(self.tolerance.as_ticks()).div_ceil(interval)
    }

    /// The time that `count` of them take.
    pub(super) const fn times(&self, count: u64) -> u64 {
        count.saturating_mul(self.transmission.as_ticks())
    }

    /// A line above [`within`](Self::within) in a window of this length, as time.
    pub(super) fn line(&self, span: u64) -> u64 {
        let span = span.saturating_add(self.tolerance.as_ticks());
        let full = self.times(span).div_ceil(self.interval.as_ticks().max(1));
        full.saturating_add(self.transmission.as_ticks())
    }

    /// The share of time, in units of 2^-32, rounded up.
    pub(super) fn share(&self) -> u64 {
        self.transmission.as_ticks().saturating_mul(WHOLE).div_ceil(self.interval.as_ticks().max(1))
    }
}

/// A soft real-time channel of one publisher.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SoftLoad {
    /// Its frames.
    pub load: Load,
    /// D: from publication until sent.
    pub deadline: Duration,
    /// The channel.
    pub subject: Subject,
}

/// How much hard real-time frames take in any window of a length.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CalendarDemand<'a> {
    /// The cycle of the calendar.
    pub cycle: Duration,
    /// What they take in a cycle.
    pub total: Duration,
    /// By how much two ready instants can come closer.
    pub slack: Duration,
    /// From which length of a window on, how much in it: both rise.
    pub steps: &'a [(Duration, Duration)],
}

impl CalendarDemand<'_> {
    /// No calendar.
    pub const NONE: Self = Self {
        cycle: Duration::from_ticks(0),
        total: Duration::from_ticks(0),
        slack: Duration::from_ticks(0),
        steps: &[],
    };

    /// O(log steps).
    fn within(&self, span: u64) -> u64 {
        let span = span.saturating_add(self.slack.as_ticks());
        let cycle = self.cycle.as_ticks();
        let (Some(cycles), Some(rest)) = (span.checked_div(cycle), span.checked_rem(cycle)) else { return 0 };
        let step = self.steps.partition_point(|(length, _)| length.as_ticks() <= rest);
        let rest =
            step.checked_sub(1).and_then(|at| self.steps.get(at)).map_or(0, |(_, load)| load.as_ticks());
        cycles.saturating_mul(self.total.as_ticks()).saturating_add(rest)
    }

    fn as_load(&self) -> Option<Load> {
        let tolerance = self.slack;
        (!self.cycle.is_zero()).then_some(Load { transmission: self.total, interval: self.cycle, tolerance })
    }
}

/// How many faults the bounds of the plan tolerate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Faults {
    /// None.
    None,
    /// So many at once, then one every interval.
    Burst(u32, Duration),
    /// At most so many in any window of this length.
    Window(u32, Duration),
}

impl Faults {
    /// In a window that is not empty: so many to begin with, and so many more after each span.
    fn line(self) -> Option<(u64, u64, u64)> {
        let of = |span: Duration| span.as_ticks().max(1);
        match self {
            Self::None => None,
            Self::Burst(count, span) => Some(((count as u64).saturating_sub(1), 1, of(span))),
            Self::Window(count, span) => Some((0, count as u64, of(span))),
        }
    }

    fn within(self, span: u64) -> u64 {
        match self.line() {
            Some((first, each, every)) if span > 0 => {
                first.saturating_add(each.saturating_mul(span.div_ceil(every)))
            }
            _ => 0,
        }
    }
}

/// A planned non real-time or foreign frame with a deadline: it has the deadline if the admitted channels take no more
/// than this in a window of this length.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Guarded {
    /// From when it is ready until it must be on the wire.
    pub span: Duration,
    /// What is free of that, besides what is planned.
    pub room: Duration,
}

/// What the plan of a segment reserves.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Reservations<'a> {
    /// The bit rate.
    pub bit_rate: BitRate,
    /// Δt_p.
    pub priority_step: Duration,
    /// How late a frame may be loaded again after its priority has changed.
    pub reload: Duration,
    /// A frame of lower priority may slip in behind each.
    pub slow_refill: bool,
    /// The faults that are tolerated.
    pub faults: Faults,
    /// The calendar.
    pub calendar: CalendarDemand<'a>,
    /// Frames that go before all soft real-time ones.
    pub above: &'a [Load],
    /// The planned soft real-time channels.
    pub soft: &'a [SoftLoad],
    /// Less urgent frames with deadlines.
    pub guarded: &'a [Guarded],
}

impl Reservations<'static> {
    /// Nothing is planned, and no faults are tolerated.
    pub const fn nothing(bit_rate: BitRate, priority_step: Duration, reload: Duration) -> Self {
        Self {
            bit_rate,
            priority_step,
            reload,
            slow_refill: false,
            faults: Faults::None,
            calendar: CalendarDemand::NONE,
            above: &[],
            soft: &[],
            guarded: &[],
        }
    }
}

impl Reservations<'_> {
    /// B: the longest frame that may just have started.
    pub(super) const fn blocking(&self) -> u64 {
        self.bit_rate.bits(LONGEST_FRAME_BITS).as_ticks()
    }

    pub(super) const fn bit(&self) -> u64 {
        self.bit_rate.bit_time().as_ticks()
    }

    /// Δ: deadlines that are so much later may still go first.
    pub(super) const fn step(&self) -> u64 {
        self.priority_step.as_ticks().saturating_add(self.reload.as_ticks())
    }

    /// From this deadline on the order is not that of deadlines.
    pub(super) const fn horizon(&self) -> u64 {
        self.priority_step.as_ticks().saturating_mul(BAND)
    }

    fn fault(&self) -> u64 {
        self.bit_rate.bits(ERROR_RECOVERY_BITS).as_ticks().saturating_add(self.blocking())
    }

    /// What a frame of a soft channel may take, with one that slips in behind it.
    pub(super) fn with_slip(&self, load: Load) -> Load {
        let slip = if self.slow_refill { self.blocking() } else { 0 };
        let transmission = Duration::from_ticks(load.transmission.as_ticks().saturating_add(slip));
        Load { transmission, ..load }
    }

    /// What is on the bus besides soft channels, in a window of this length.
    pub(super) fn others(&self, span: u64) -> u64 {
        let with_bit = span.saturating_add(self.bit());
        let above =
            self.above.iter().map(|load| load.times(load.within(with_bit))).fold(0, u64::saturating_add);
        above
            .saturating_add(self.calendar.within(with_bit))
            .saturating_add(self.faults.within(span).saturating_mul(self.fault()))
    }

    /// A line above [`others`](Self::others).
    pub(super) fn others_line(&self, span: u64) -> u64 {
        let with_bit = span.saturating_add(self.bit());
        let lines = self.above.iter().copied().chain(self.calendar.as_load()).map(|load| load.line(with_bit));
        let faults = self.faults.line().map_or(0, |(first, each, every)| {
            let load = self.fault().saturating_mul(each);
            let full = load.saturating_mul(span).div_ceil(every.max(1));
            full.saturating_add(load).saturating_add(first.saturating_mul(self.fault()))
        });
        lines.fold(faults, u64::saturating_add)
    }

    /// Its slope, in units of 2^-32, rounded up.
    pub(super) fn others_share(&self) -> u64 {
        let shares = self.above.iter().copied().chain(self.calendar.as_load()).map(|load| load.share());
        let faults = self.faults.line().map_or(0, |(_, each, every)| {
            self.fault().saturating_mul(each).saturating_mul(WHOLE).div_ceil(every.max(1))
        });
        shares.fold(faults, u64::saturating_add)
    }
}

/// A share of time of 1.
pub(super) const WHOLE: u64 = 1 << 32;

/// Priorities in which the order is that of deadlines.
const BAND: u64 = 248;
