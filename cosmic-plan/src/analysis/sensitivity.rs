//! How far things could grow before something breaks.

use super::segment::assess;
use crate::cluster::{Cluster, PlannedClass};
use crate::plan::{Effort, plan};
use cosmic_core::time::Duration;

/// How far one channel could grow with all others as they are.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Growth {
    /// Position in [`Cluster::channels`].
    pub channel: usize,
    /// The shortest period, or least distance of events, with which everything still holds; `None` if it
    /// does not hold as it is. Hard real-time: of the halves, thirds, ... of the period.
    pub shortest_period: Option<Duration>,
    /// Hard real-time: the highest omission degree that still fits.
    pub highest_omission_degree: Option<u8>,
}

/// How far each channel could grow, one after the other, as far as the steps reach.
pub fn growth(cluster: &Cluster, effort: &Effort<'_>) -> Vec<Growth> {
    (0..cluster.channels.len())
        .take_while(|_| effort.left() > 0)
        .map(|channel| {
            effort.report("asking how far channels could grow");
            match cluster.channels[channel].class {
                PlannedClass::Hard { .. } => Growth {
                    channel,
                    shortest_period: shortest_hard_period(cluster, channel, effort),
                    highest_omission_degree: highest_omission_degree(cluster, channel, effort),
                },
                _ => Growth {
                    channel,
                    shortest_period: shortest_period(cluster, channel, effort),
                    highest_omission_degree: None,
                },
            }
        })
        .collect()
}

/// By what factor, in percent, all soft, non real-time and foreign frames could come more often; 100 if not
/// at all, `None` if something fails as it is.
pub fn common_growth(cluster: &Cluster, effort: &Effort<'_>) -> Option<u32> {
    let faster = |percent: u32| {
        let mut changed = cluster.clone();
        let scale =
            |span: Duration| Duration::from_ticks((span.as_ticks() * 100 / u64::from(percent)).max(1));
        for channel in &mut changed.channels {
            if !matches!(channel.class, PlannedClass::Hard { .. }) {
                channel.recurrence = channel.recurrence.with_span(scale(channel.recurrence.span()));
            }
        }
        for frame in &mut changed.foreign {
            frame.period = scale(frame.period);
        }
        changed
    };
    if cluster.channels.iter().all(|c| matches!(c.class, PlannedClass::Hard { .. }))
        && cluster.foreign.is_empty()
    {
        return holds(cluster, effort).then_some(100);
    }
    largest(100, 10_000, |percent| holds(&faster(percent), effort))
}

/// Does everything hold, and has everything a bound? (A channel without a deadline needs none to hold, but
/// without one its events would pile up.)
fn holds(cluster: &Cluster, effort: &Effort<'_>) -> bool {
    effort.spend(STEPS_OF_A_CHANNEL * cluster.channels.len() as u64);
    effort.within(TRIAL, |part| plan(cluster, part)).is_ok_and(|plan| {
        let assessment = assess(cluster, &plan);
        assessment.holds() && assessment.channels.iter().all(|channel| channel.proof.bound.is_some())
    })
}

fn shortest_period(cluster: &Cluster, channel: usize, effort: &Effort<'_>) -> Option<Duration> {
    let now = cluster.channels[channel].recurrence.span().as_ticks();
    let with = |period: u64| cluster.with_period(channel, Duration::from_ticks(period));
    // In steps of a thousandth of the period, so that few trials suffice.
    let step = (now / 1000).max(1);
    let fewer = largest(0, u32::try_from(now / step - 1).unwrap_or(0), |steps| {
        holds(&with(now - u64::from(steps) * step), effort)
    })?;
    Some(Duration::from_ticks(now - u64::from(fewer) * step))
}

fn shortest_hard_period(cluster: &Cluster, channel: usize, effort: &Effort<'_>) -> Option<Duration> {
    let now = cluster.channels[channel].recurrence.span().as_ticks();
    if !holds(cluster, effort) {
        return None;
    }
    let mut shortest = now;
    for part in (2..=20).filter(|part| now % part == 0) {
        if holds(&cluster.with_period(channel, Duration::from_ticks(now / part)), effort) {
            shortest = now / part;
        }
    }
    Some(Duration::from_ticks(shortest))
}

fn highest_omission_degree(cluster: &Cluster, channel: usize, effort: &Effort<'_>) -> Option<u8> {
    let now = cluster.omission_degree(channel)?;
    let degree = |value: u32| u8::try_from(value).unwrap_or(u8::MAX);
    let highest = largest(u32::from(now), 255, |value| {
        holds(&cluster.with_omission_degree(channel, degree(value)), effort)
    })?;
    Some(degree(highest))
}

/// The largest value from `low` to `high` that passes, if `low` does; what passes does so from `low` on.
fn largest(low: u32, high: u32, passes: impl Fn(u32) -> bool) -> Option<u32> {
    if !passes(low) {
        return None;
    }
    let (mut good, mut bad) = (low, high.max(low) + 1);
    while bad - good > 1 {
        let middle = good + (bad - good) / 2;
        if passes(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    Some(good)
}

/// Trials are many, and a calendar that is hard to find is no comfortable growth.
const TRIAL: u64 = 300_000_000;

/// What the analysis takes for each channel, roughly.
const STEPS_OF_A_CHANNEL: u64 = 50_000;
