//! Worst-case response times under fixed priorities without pre-emption.
//!
//! Davis, Burns, Bril, Lukkien 2007, *Controller Area Network (CAN) schedulability analysis: Refuted,
//! revisited and revised*. A frame m may have to wait for one frame of lower priority that has just
//! started (blocking B), for frames of higher priority, and for what faults destroy. The analysis of 1994
//! looked at the first instance only; but frames of higher priority that come while m is being sent push
//! work into the next period of m, so that a later instance can be worse. The exact test looks at every
//! instance in the priority level-m busy period; the sufficient test at one, with `max(B, C)` in front.
//!
//! Numbers: `w(q) = E(w + C) + B + q C + Σ ceil((w + J + τ) / T) C` over the frames of higher priority,
//! `R = max J + w(q) - q T + C`.

use super::bus::{Bus, Stream, UNBOUNDED, fixed_point};

/// The priority level of a frame: who is above and who is below.
#[derive(Clone, Copy, Debug)]
pub struct Level<'a> {
    /// The frames of higher priority.
    pub higher: &'a [Stream],
    /// B: the longest frame of lower priority.
    pub blocking: u64,
    /// The longest frame that a fault can destroy at this level: of the higher ones and the frame itself.
    pub longest: u64,
}

/// What the exact test says of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Exact {
    /// R: from the nominal instant until the frame has been sent; `None` if no bound exists or none was
    /// found in reasonable time.
    pub response: Option<u64>,
    /// How many instances there are in the busy period.
    pub instances: u64,
    /// The instance (from 0) whose response is the longest.
    pub worst_instance: u64,
}

impl Level<'_> {
    fn interference(&self, bus: &Bus, span: u64) -> u64 {
        let higher = self.higher.iter().fold(0_u64, |sum, stream| {
            sum.saturating_add(stream.arrivals(span, bus.bit).saturating_mul(stream.transmission))
        });
        higher.saturating_add(bus.calendar.within(span.saturating_add(bus.bit)))
    }

    fn utilisation(&self, frame: &Stream, bus: &Bus) -> f64 {
        let higher: f64 = self.higher.iter().map(Stream::utilisation).sum();
        higher + frame.utilisation() + bus.background(self.longest)
    }

    /// The exact test.
    pub fn exact(&self, frame: &Stream, bus: &Bus) -> Exact {
        const NONE: Exact = Exact { response: None, instances: 0, worst_instance: 0 };
        // A little above 1 may be rounding; the search for the busy period is bounded anyway.
        if self.utilisation(frame, bus) > 1.0 + 1e-9 {
            return NONE;
        }
        let mut steps = STEPS;
        let busy = fixed_point(self.blocking + frame.transmission, UNBOUNDED, &mut steps, |t| {
            self.blocking
                .saturating_add(bus.error_overhead(t, self.longest))
                .saturating_add(frame.arrivals(t, 0).saturating_mul(frame.transmission))
                .saturating_add(self.higher.iter().fold(0, |sum: u64, stream| {
                    sum.saturating_add(stream.arrivals(t, 0).saturating_mul(stream.transmission))
                }))
                .saturating_add(bus.calendar.within(t))
        });
        let Some(busy) = busy else { return NONE };
        let instances = frame.arrivals(busy, 0);
        let mut worst = Exact { response: Some(0), instances, worst_instance: 0 };
        let mut start = self.blocking;
        for instance in 0..instances {
            let own = instance.saturating_mul(frame.transmission);
            let waited = fixed_point(start, UNBOUNDED, &mut steps, |w| {
                self.blocking
                    .saturating_add(own)
                    .saturating_add(bus.error_overhead(w + frame.transmission, self.longest))
                    .saturating_add(self.interference(bus, w))
            });
            let Some(waited) = waited else { return Exact { response: None, ..worst } };
            let finished = frame.jitter + waited + frame.transmission;
            let response = finished.saturating_sub(instance.saturating_mul(frame.period));
            if Some(response) > worst.response {
                worst = Exact { response: Some(response), instances, worst_instance: instance };
            }
            start = waited + frame.transmission;
        }
        worst
    }

    /// The sufficient test: a bound if it is at most the period, else no statement (but the number still
    /// says how far off it is). `extra` is added to the blocking. `None`: it has no solution.
    pub fn sufficient(&self, frame: &Stream, bus: &Bus, extra: u64) -> Option<u64> {
        let mut steps = STEPS;
        let front = self.blocking.max(frame.transmission).saturating_add(extra);
        let waited = fixed_point(front, UNBOUNDED, &mut steps, |w| {
            front
                .saturating_add(bus.error_overhead(w + frame.transmission, self.longest))
                .saturating_add(self.interference(bus, w))
        })?;
        Some(frame.jitter + waited + frame.transmission)
    }
}

/// Steps of iteration for one frame, all instances together: far beyond what any real set takes.
const STEPS: u64 = 200_000;
