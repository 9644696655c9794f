//! Soft real-time: earliest deadline first, through priorities that stand for Δt_p of deadline each.
//!
//! A frame with deadline d has at time t the priority `1 + floor((d - t) / Δt_p)`, 1 at least and 249 at
//! most; it is loaded again when that changes, at the latest `reload` afterwards. The longest response of
//! a channel i is bounded as follows.
//!
//! **Theorem.** Let frame f of channel i be published at instant a of a busy period that begins at 0, and
//! let `X = a + D_i + Δt_p + reload`. As long as f is in the band of 1..=248, a frame that wins against it
//! or stands before it in its node's queue has a deadline before X, is hard real-time, a sync frame or a
//! foreign frame above the band; call these the work of X. Let the busy period be the maximal interval
//! before the sending of f in which work of X is always pending. Then one frame that is no work of X has
//! begun before it at most (B), and until the sending of f begins at s only work of X and faults use the
//! bus. Of channel j at most `min(ceil((s + J_j) / T_j), ceil((X - D_j + J_j) / T_j))` frames are published
//! in the busy period with a deadline before X. So s is at most the least solution of
//!
//! ```text
//! s = B + Σ_j min(...) C_j - C_i + sync and foreign frames in s + calendar(s) + E(s + C_i)
//! ```
//!
//! and f has been sent `s + C_i - a` after its publication. Since the right side changes only where a
//! frame's deadline passes X, the a = 0 and the points just behind these changes suffice.
//!
//! In the band 249 (deadlines more than 248 Δt_p away) the order is not that of deadlines. Two bounds hold
//! there, and the smaller counts: the busy period of all soft frames together, in whatever order; and, if
//! every channel meets its deadlines, `D_i - 248 Δt_p` plus the time to send all that can be pending then.
//!
//! Conditions: a node loads its next frame within the inter-frame space, and re-loads a frame with its new
//! priority between two arbitrations. Where the first does not hold ([`SoftBus::slow_refill`]), a frame of
//! lower priority may slip in behind every frame, which is added.

use super::bus::{Bus, Stream, UNBOUNDED, fixed_point};

/// A soft real-time channel of one publisher.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SoftStream {
    /// C, T, J; the jitter is that of publication.
    pub stream: Stream,
    /// D: from publication, in nanoseconds.
    pub deadline: u64,
}

/// What soft real-time frames meet on the bus.
#[derive(Clone, Debug)]
pub struct SoftBus<'a> {
    /// The bus with its calendar.
    pub bus: &'a Bus,
    /// Frames that go before all soft ones: sync, foreign ones of high priority.
    pub above: &'a [Stream],
    /// B: the longest frame that may just have started.
    pub blocking: u64,
    /// The longest frame that a fault may destroy.
    pub longest: u64,
    /// Δt_p.
    pub priority_step: u64,
    /// How late a frame may be loaded again after its priority has changed.
    pub reload: u64,
    /// Nodes may not manage to load their next frame within the inter-frame space.
    pub slow_refill: bool,
}

impl SoftBus<'_> {
    /// Bounds on the responses (from publication until sent), one for each channel; `None`: there is none.
    pub fn responses(&self, channels: &[SoftStream]) -> Vec<Option<SoftBound>> {
        let Some(busy) = self.busy_period(channels) else { return vec![None; channels.len()] };
        let horizon = BAND.saturating_mul(self.priority_step);
        let whole =
            SoftBound { response: busy, rule: Rule::BusyPeriod, start: busy, published: 0, limit: u64::MAX };
        let bounds: Vec<SoftBound> = channels
            .iter()
            .map(|channel| {
                let in_order = channel.deadline < horizon;
                let by_deadline = if in_order { self.in_order(channels, channel, busy) } else { None };
                by_deadline.filter(|bound| bound.response < busy).unwrap_or(whole)
            })
            .collect();
        // What is pending at the edge of the band is bounded only if nothing is late: assume it, and see
        // whether it comes out. The first frame to be late would contradict it.
        let beyond = self.backlog(channels, horizon).filter(|backlog| *backlog <= horizon);
        let improved: Vec<SoftBound> = channels
            .iter()
            .zip(&bounds)
            .map(|(channel, bound)| match beyond {
                Some(backlog) if channel.deadline >= horizon => {
                    let response = channel.deadline - horizon + backlog;
                    let edge = SoftBound { response, rule: Rule::EdgeOfBand, start: backlog, ..whole };
                    if response < bound.response { edge } else { *bound }
                }
                _ => *bound,
            })
            .collect();
        let meets = |(channel, bound): (&SoftStream, &SoftBound)| bound.response <= channel.deadline;
        let chosen = if channels.iter().zip(&improved).all(meets) { improved } else { bounds };
        chosen.into_iter().map(Some).collect()
    }

    /// What a bound of the theorem, or the busy period, consists of, by name.
    pub fn terms(&self, channels: &[SoftStream], of: usize, bound: &SoftBound) -> Vec<(&'static str, u64)> {
        let own = channels[of].stream.transmission;
        let taken = if bound.rule == Rule::DeadlineOrder { own } else { 0 };
        let mut terms = vec![
            ("one frame that has just started", self.blocking),
            (
                "soft frames with earlier deadlines",
                self.soft_work(channels, bound.start, bound.limit) - taken,
            ),
            ("sync and foreign frames", self.above_within(bound.start)),
            ("hard real-time frames", self.bus.calendar.within(bound.start.saturating_add(self.bus.bit))),
            ("faults", self.bus.error_overhead(bound.start.saturating_add(taken), self.longest)),
        ];
        if bound.rule == Rule::DeadlineOrder {
            terms.push(("the frame itself", own));
        }
        terms
    }

    fn step(&self) -> u64 {
        self.priority_step + self.reload
    }

    fn above_within(&self, span: u64) -> u64 {
        self.above.iter().fold(0_u64, |sum, stream| {
            sum.saturating_add(stream.arrivals(span, self.bus.bit).saturating_mul(stream.transmission))
        })
    }

    /// What is there besides the channels, until `start`, for a frame that takes `own` from there on.
    fn others(&self, start: u64, own: u64) -> u64 {
        self.above_within(start)
            .saturating_add(self.bus.calendar.within(start.saturating_add(self.bus.bit)))
            .saturating_add(self.bus.error_overhead(start.saturating_add(own), self.longest))
    }

    /// The soft frames that are published until `start` with deadlines before `limit`.
    fn soft_work(&self, channels: &[SoftStream], start: u64, limit: u64) -> u64 {
        channels.iter().fold(0_u64, |sum, channel| {
            let published = channel.stream.arrivals(start, self.bus.bit);
            let before = match limit.checked_sub(channel.deadline) {
                Some(room) if room > 0 => channel.stream.arrivals(room, 0),
                _ => 0,
            };
            sum.saturating_add(self.work(published.min(before), channel.stream.transmission))
        })
    }

    fn work(&self, frames: u64, transmission: u64) -> u64 {
        let slipped_in = if self.slow_refill { self.blocking } else { 0 };
        frames.saturating_mul(transmission + slipped_in)
    }

    /// The longest interval in which soft frames are pending, in whatever order they are sent.
    fn busy_period(&self, channels: &[SoftStream]) -> Option<u64> {
        let slipped_in = if self.slow_refill { self.blocking } else { 0 };
        let share = |s: &Stream| (s.transmission + slipped_in) as f64 / s.period as f64;
        let soft: f64 = channels.iter().map(|channel| share(&channel.stream)).sum();
        let above: f64 = self.above.iter().map(Stream::utilisation).sum();
        if soft + above + self.bus.background(self.longest) > 1.0 + 1e-9 {
            return None;
        }
        fixed_point(self.blocking, UNBOUNDED, &mut { STEPS }, |t| {
            let soft = self.soft_work(channels, t, u64::MAX);
            self.blocking.saturating_add(soft).saturating_add(self.others(t, 0))
        })
    }

    /// The time to send all that can be pending, or comes, with deadlines in the band: from its edge on.
    fn backlog(&self, channels: &[SoftStream], horizon: u64) -> Option<u64> {
        let window = horizon + self.step();
        let pending = channels.iter().fold(0_u64, |sum, channel| {
            let frames = channel.stream.arrivals(window, 0);
            sum.saturating_add(self.work(frames, channel.stream.transmission))
        });
        let front = self.blocking.saturating_add(pending);
        fixed_point(front, UNBOUNDED, &mut { STEPS }, |t| front.saturating_add(self.others(t, 0)))
    }

    /// The bound of the theorem.
    fn in_order(&self, channels: &[SoftStream], channel: &SoftStream, busy: u64) -> Option<SoftBound> {
        let own = channel.stream.transmission;
        let first = channel.deadline + self.step();
        let mut worst =
            SoftBound { response: 0, rule: Rule::DeadlineOrder, start: 0, published: 0, limit: first };
        let mut start = 0;
        let mut steps = STEPS;
        for (low, high) in self.candidates(channels, first, busy) {
            start = fixed_point(start, UNBOUNDED, &mut steps, |s| {
                let work = self.soft_work(channels, s, high).saturating_sub(own);
                self.blocking.saturating_add(work).saturating_add(self.others(s, own))
            })?;
            let published = low - first;
            let response = (start + own).saturating_sub(published);
            if response > worst.response {
                worst = SoftBound { response, start, published, limit: high, ..worst };
            }
        }
        Some(worst)
    }

    /// The values of X to look at, as ranges: the work of the upper end is counted for all of a range. There
    /// is one value in each, unless there are too many.
    fn candidates(&self, channels: &[SoftStream], first: u64, busy: u64) -> Vec<(u64, u64)> {
        let last = first.saturating_add(busy);
        let mut points = vec![first];
        let mut all = true;
        for other in channels {
            // Just behind X = D + k T - J another frame of the channel has its deadline before X.
            let Stream { period, jitter, .. } = other.stream;
            let from = (first + jitter).saturating_sub(other.deadline).div_ceil(period);
            let to = (last + jitter).saturating_sub(other.deadline) / period;
            let stride = ((to.saturating_sub(from)) / MOST_POINTS).max(1);
            let mut k = from;
            while k <= to {
                let point = (other.deadline + k * period).saturating_sub(jitter) + 1;
                if point > first && point <= last {
                    points.push(point);
                }
                k += stride;
            }
            all &= stride == 1;
        }
        points.sort_unstable();
        points.dedup();
        if all && points.len() <= MOST_POINTS as usize {
            return points.into_iter().map(|x| (x, x)).collect();
        }
        // The next range's first point is this one's end: nothing between is forgotten.
        let chunk = points.len().div_ceil(MOST_POINTS as usize);
        let starts: Vec<u64> = points.iter().copied().step_by(chunk).collect();
        let ends = starts[1..].iter().copied().chain([last]);
        starts.iter().copied().zip(ends).collect()
    }
}

/// A bound on the response of a soft real-time channel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SoftBound {
    /// From publication until sent, in nanoseconds.
    pub response: u64,
    /// Which rule gives it.
    pub rule: Rule,
    /// When the sending begins at the latest, in the busy period that is worst.
    pub start: u64,
    /// When the frame is published in that busy period.
    pub published: u64,
    /// X: frames with a deadline before it may go first.
    pub limit: u64,
}

/// How a soft real-time bound was found.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Rule {
    /// By the order of deadlines: the theorem.
    DeadlineOrder,
    /// All soft frames together, in whatever order.
    BusyPeriod,
    /// By what can be pending when the deadline comes within the band of priorities.
    EdgeOfBand,
}

/// Priorities in which the order is that of deadlines.
const BAND: u64 = 248;
const STEPS: u64 = 400_000;
const MOST_POINTS: u64 = 2_000;
