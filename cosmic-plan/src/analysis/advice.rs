//! What would help channels whose deadline is not proven.

use super::segment::{Assessment, assess};
use crate::cluster::{Cluster, PlannedClass, Recurrence};
use crate::plan::relax::{Relaxation, USUAL_RATES};
use crate::plan::{Effort, Plan, plan};
use crate::units::{show, show_rate};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;

/// One thing to change.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Change {
    Deadline { channel: usize, span: Duration },
    Period { channel: usize, span: Duration },
    Rate(BitRate),
}

impl Change {
    fn apply(self, cluster: &Cluster) -> Cluster {
        let mut changed = cluster.clone();
        match self {
            Self::Deadline { channel, span } => {
                let channel = &mut changed.channels[channel];
                channel.deadline = Some(span);
                channel.validity = channel.validity.map(|validity| validity.max(span));
            }
            Self::Period { channel, span } => return cluster.with_period(channel, span),
            Self::Rate(rate) => changed.segment.bit_rate = rate,
        }
        changed
    }

    fn describe(self, cluster: &Cluster) -> Relaxation {
        match self {
            Self::Deadline { channel, span } => {
                let channel = &cluster.channels[channel];
                let now = channel.deadline.map_or("none".to_owned(), show);
                let change = format!("{}: a deadline of {} instead of {now}", channel.name, show(span));
                Relaxation { change, cost: 1 }
            }
            Self::Period { channel, span } => {
                let channel = &cluster.channels[channel];
                let now = channel.recurrence.span();
                let what = match channel.recurrence {
                    Recurrence::Periodic(_) => "a period",
                    Recurrence::Sporadic(_) => "a min_interarrival",
                };
                let change = format!("{}: {what} of {} instead of {}", channel.name, show(span), show(now));
                let factor = span.as_ticks() / now.as_ticks().max(1);
                Relaxation { change, cost: 3 + u32::try_from(factor).unwrap_or(u32::MAX / 2) }
            }
            Self::Rate(rate) => {
                let now = cluster.segment.bit_rate;
                let change =
                    format!("segment: bit_rate = \"{}\" instead of {}", show_rate(rate), show_rate(now));
                Relaxation { change, cost: 10 + rate.bits_per_second() / now.bits_per_second() }
            }
        }
    }
}

/// Single changes after which everything holds, the cheapest first, as far as the steps reach. A longer deadline costs
/// 1, rarer events 3 and their factor, a higher bit rate 10 and its factor.
pub fn advice(cluster: &Cluster, assessment: &Assessment, effort: &Effort<'_>) -> Vec<Relaxation> {
    let mut found = Vec::new();
    for changes in candidates(cluster, assessment) {
        // Of one kind the least that helps.
        let helps = |change: &Change| holds(&change.apply(cluster), effort);
        found.extend(changes.into_iter().find(helps).map(|change| change.describe(cluster)));
    }
    found.sort_by_key(|relaxation| relaxation.cost);
    found
}

/// Changes to try, those of one kind together, the least first.
fn candidates(cluster: &Cluster, assessment: &Assessment) -> Vec<Vec<Change>> {
    let failing: Vec<_> = assessment.channels.iter().filter(|c| !c.proof.verdict.holds()).collect();
    let mut all = Vec::new();
    for proven in &failing {
        let channel = proven.channel;
        if let Some(bound) = proven.proof.bound {
            all.push(vec![Change::Deadline { channel, span: rounded_up(bound) }]);
        }
        // Slots so often that the wait for the next one leaves time enough.
        if let (Some(window), Some(deadline)) = (proven.proof.from_ready, proven.proof.deadline) {
            let clocks = 2 * cluster.segment.accuracy.as_ticks();
            let left = deadline.as_ticks().saturating_sub(window.as_ticks() + clocks) / 100_000 * 100_000;
            if left > 0 {
                all.push(vec![Change::Period { channel, span: Duration::from_ticks(left) }]);
            }
        }
    }
    // Who loads the bus most could come more rarely.
    let mut by_load: Vec<usize> = (0..cluster.channels.len()).collect();
    by_load.retain(|channel| !matches!(cluster.channels[*channel].class, PlannedClass::Hard { .. }));
    let span = |channel: usize| cluster.channels[channel].recurrence.span().as_ticks();
    let load = |channel: &usize| {
        (u64::from(cluster.channels[*channel].length) + 8) * 1_000_000_000 / span(*channel).max(1)
    };
    by_load.sort_by_key(|channel| std::cmp::Reverse(load(channel)));
    all.extend(by_load.into_iter().take(MOST_CHANNELS).map(|channel| {
        let longer = [3, 4, 6, 8, 12, 16].map(|halves| span(channel).saturating_mul(halves) / 2);
        longer.map(|span| Change::Period { channel, span: Duration::from_ticks(span) }).to_vec()
    }));
    let faster = USUAL_RATES.iter().filter_map(|bits| BitRate::new(*bits));
    all.push(faster.filter(|rate| *rate > cluster.segment.bit_rate).map(Change::Rate).collect());
    all
}

fn holds(cluster: &Cluster, effort: &Effort<'_>) -> bool {
    effort.report("looking for what would help");
    if !effort.spend(STEPS_OF_A_CHANNEL * cluster.channels.len() as u64) {
        return false;
    }
    let plan: Result<Plan, _> = effort.within(effort.left() / 8, |part| plan(cluster, part));
    plan.is_ok_and(|plan| assess(cluster, &plan).holds())
}

/// As people write spans: two digits.
fn rounded_up(span: Duration) -> Duration {
    let ticks = span.as_ticks().max(1);
    let unit = 10_u64.pow(ticks.ilog10().saturating_sub(1));
    Duration::from_ticks(ticks.div_ceil(unit) * unit)
}

/// So many channels are tried for rarer events.
const MOST_CHANNELS: usize = 8;

/// What the analysis takes for each channel, roughly.
const STEPS_OF_A_CHANNEL: u64 = 50_000;
