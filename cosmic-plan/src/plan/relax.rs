//! The cheapest way out of an impossible set of channels.

use super::conflict::Conflict;
use super::{Effort, NoPlan, is_plannable, plan};
use crate::cluster::{Cluster, PlannedClass, Wishes};
use crate::units::{show, show_rate};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;

/// Changes after which a calendar exists.
#[derive(Clone, PartialEq, Debug)]
pub struct Relaxation {
    /// What to change, in words.
    pub change: String,
    /// How much is given up: smaller is cheaper. See [`relaxations`].
    pub cost: u32,
}

/// One thing to change.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Change {
    Wishes { channel: usize },
    Omissions { channel: usize, degree: u8 },
    Period { channel: usize, span: Duration },
    Rate(BitRate),
}

impl Change {
    fn apply(self, cluster: &Cluster) -> Cluster {
        match self {
            Self::Omissions { channel, degree } => cluster.with_omission_degree(channel, degree),
            Self::Period { channel, span } => cluster.with_period(channel, span),
            Self::Rate(rate) => {
                let mut changed = cluster.clone();
                changed.segment.bit_rate = rate;
                changed
            }
            Self::Wishes { channel } => {
                let mut changed = cluster.clone();
                changed.channels[channel].deadline = None;
                if let PlannedClass::Hard { wishes, .. } = &mut changed.channels[channel].class {
                    *wishes = Wishes::default();
                }
                changed
            }
        }
    }

    fn describe(self, cluster: &Cluster) -> String {
        match self {
            Self::Wishes { channel } => {
                let name = &cluster.channels[channel].name;
                format!("{name}: give up the wishes for its position (phase, earliest, deadline, after)")
            }
            Self::Omissions { channel, degree } => {
                let now = cluster.omission_degree(channel).unwrap_or(0);
                match cluster.pool_of(channel) {
                    Some(pool) => format!("pool P{pool}: faults = {degree} instead of {now}"),
                    None => {
                        let name = &cluster.channels[channel].name;
                        format!("{name}: omission_degree = {degree} instead of {now}")
                    }
                }
            }
            Self::Period { channel, span } => {
                let channel = &cluster.channels[channel];
                let now = show(channel.recurrence.span());
                format!("{}: a period of {} instead of {now}", channel.name, show(span))
            }
            Self::Rate(rate) => {
                let now = show_rate(cluster.segment.bit_rate);
                format!("segment: bit_rate = \"{}\" instead of {now}", show_rate(rate))
            }
        }
    }

    fn cost(self, cluster: &Cluster) -> u32 {
        match self {
            Self::Wishes { .. } => 1,
            Self::Omissions { channel, degree } => {
                2 * u32::from(cluster.omission_degree(channel).unwrap_or(0).saturating_sub(degree))
            }
            Self::Period { channel, span } => {
                let now = cluster.channels[channel].recurrence.span().as_ticks().max(1);
                3 + u32::try_from(span.as_ticks() / now).unwrap_or(u32::MAX / 2)
            }
            Self::Rate(rate) => 10 + rate.bits_per_second() / cluster.segment.bit_rate.bits_per_second(),
        }
    }
}

/// Single changes after which a calendar exists, the cheapest first, at most one of each kind for each
/// channel; if no single one helps, one set of changes that does together.
///
/// A wish given up costs 1, each omission less 2, a longer period 3 and its factor, a higher bit rate 10 and
/// its factor. Only channels of the conflict are changed: another change cannot help.
pub fn relaxations(cluster: &Cluster, conflict: &Conflict, effort: &Effort<'_>) -> Vec<Relaxation> {
    // Many variants are tried; each gets a part of the steps.
    let share = effort.left() / 24;
    let helps = |change: &Change| {
        effort.report("looking for ways out");
        effort.within(share, |part| is_plannable(&change.apply(cluster), part))
    };
    let mut found = Vec::new();
    for change in first_of_each_kind(cluster, conflict, &helps) {
        found.push(Relaxation { change: change.describe(cluster), cost: change.cost(cluster) });
    }
    if found.is_empty() {
        found.extend(together(cluster, conflict, effort));
    }
    found.sort_by_key(|relaxation| relaxation.cost);
    // Members of a pool change together.
    found.dedup_by(|a, b| a.change == b.change);
    found
}

/// As [`relaxations`], where the search gave up: for the channels that take most.
pub fn relaxations_of_the_largest(cluster: &Cluster, effort: &Effort<'_>) -> Vec<Relaxation> {
    let mut channels: Vec<usize> = super::hard_channels(cluster).collect();
    let share = |channel: &usize| {
        let description = &cluster.channels[*channel];
        let degree = cluster.omission_degree(*channel).unwrap_or(0);
        let length = u8::try_from(description.length).unwrap_or(u8::MAX);
        let window = cluster.segment.slot_times(length, degree).delivery.as_ticks();
        window as f64 / description.recurrence.span().as_ticks() as f64
    };
    channels.sort_by(|a, b| share(b).total_cmp(&share(a)));
    channels.truncate(LARGEST);
    let conflict = Conflict { constraints: Vec::new(), channels, minimal: false, reason: String::new() };
    relaxations(cluster, &conflict, effort)
}

/// Of each kind of change, and for each channel, the least one that helps.
fn first_of_each_kind(
    cluster: &Cluster,
    conflict: &Conflict,
    helps: &dyn Fn(&Change) -> bool,
) -> Vec<Change> {
    let mut found = Vec::new();
    for &channel in conflict.channels.iter().take(MOST_TRIED) {
        let wished = Change::Wishes { channel };
        if wished.apply(cluster) != *cluster && helps(&wished) {
            found.push(wished);
        }
        let now = cluster.omission_degree(channel).unwrap_or(0);
        found.extend((0..now).rev().map(|degree| Change::Omissions { channel, degree }).find(helps));
        let periods = longer_periods(cluster, channel);
        found.extend(periods.into_iter().map(|span| Change::Period { channel, span }).find(helps));
    }
    let faster = USUAL_RATES.iter().filter_map(|bits| BitRate::new(*bits));
    found.extend(faster.filter(|rate| *rate > cluster.segment.bit_rate).map(Change::Rate).find(helps));
    found
}

/// Periods that other channels have already keep the calendar simple, so these are tried beside multiples.
fn longer_periods(cluster: &Cluster, channel: usize) -> Vec<Duration> {
    let now = cluster.channels[channel].recurrence.span().as_ticks();
    let others = super::hard_channels(cluster).map(|c| cluster.channels[c].recurrence.span().as_ticks());
    let mut periods: Vec<u64> = others.chain((2..=8).map(|factor| factor * now)).collect();
    periods.retain(|period| *period > now && *period <= 8 * now);
    periods.sort_unstable();
    periods.dedup();
    periods.into_iter().map(Duration::from_ticks).collect()
}

/// Resolves one conflict after the other, each by the cheapest change that resolves it.
fn together(cluster: &Cluster, conflict: &Conflict, effort: &Effort<'_>) -> Option<Relaxation> {
    let mut changed = cluster.clone();
    let mut conflict = conflict.clone();
    let mut changes: Vec<Change> = Vec::new();
    for _ in 0..MOST_TOGETHER {
        let clashing = only(&changed, &conflict.channels);
        let share = effort.left() / 24;
        let helps =
            |change: &Change| effort.within(share, |part| is_plannable(&change.apply(&clashing), part));
        let candidates = first_of_each_kind(&changed, &conflict, &helps);
        let change = candidates.into_iter().min_by_key(|change| change.cost(&changed))?;
        changed = change.apply(&changed);
        changes.push(change);
        match effort.within(effort.left() / 4, |part| plan(&changed, part)) {
            Ok(_) => {
                drop_needless(cluster, &mut changes, effort);
                let words: Vec<String> = changes.iter().map(|change| change.describe(cluster)).collect();
                let cost = changes.iter().map(|change| change.cost(cluster)).sum();
                return Some(Relaxation { change: format!("together: {}", words.join("; ")), cost });
            }
            Err(NoPlan::Impossible(next)) => conflict = next,
            Err(NoPlan::GaveUp { .. }) => return None,
        }
    }
    None
}

/// A later change may have made an earlier one needless.
fn drop_needless(cluster: &Cluster, changes: &mut Vec<Change>, effort: &Effort<'_>) {
    let mut at = 0;
    while at < changes.len() && changes.len() > 1 {
        let others = changes.iter().enumerate().filter(|(k, _)| *k != at).map(|(_, change)| change);
        let changed = others.fold(cluster.clone(), |changed, change| change.apply(&changed));
        if effort.within(effort.left() / 8, |part| is_plannable(&changed, part)) {
            changes.remove(at);
        } else {
            at += 1;
        }
    }
}

/// The cluster with these hard real-time channels only.
fn only(cluster: &Cluster, channels: &[usize]) -> Cluster {
    let mut fewer = cluster.clone();
    for node in &mut fewer.nodes {
        node.publishes.retain(|channel| channels.contains(channel));
    }
    fewer
}

/// Of a conflict of many channels the largest are tried.
const MOST_TRIED: usize = 24;

const MOST_TOGETHER: usize = 8;
const LARGEST: usize = 6;
/// Bit rates that are in use.
pub(crate) const USUAL_RATES: [u32; 8] =
    [20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
