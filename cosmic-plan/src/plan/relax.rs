//! The cheapest way out of an impossible set of channels.

use super::conflict::Conflict;
use super::{Effort, is_plannable};
use crate::cluster::{Class, Cluster, Wishes};
use crate::units::{show, show_rate};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;

/// One change that makes a calendar possible.
#[derive(Clone, PartialEq, Debug)]
pub struct Relaxation {
    /// What to change, in words.
    pub change: String,
    /// How much is given up: smaller is cheaper. See [`relaxations`].
    pub cost: u32,
}

/// Single changes after which a calendar exists, the cheapest first, at most one of each kind for each
/// channel. A wish given up costs 1, each omission less 2, a longer period 3 and up with its factor, the
/// next higher bit rate 10 and up. Only channels of the conflict are changed: another change cannot help.
pub fn relaxations(cluster: &Cluster, conflict: &Conflict, effort: &Effort<'_>) -> Vec<Relaxation> {
    // Many variants are tried; each gets a part of the time.
    let part = Effort { limit: effort.limit / 16, watch: effort.watch };
    let mut found = Vec::new();
    for &channel in &conflict.channels {
        found.extend(without_wishes(cluster, channel, &part));
        found.extend(fewer_omissions(cluster, channel, &part));
        found.extend(longer_period(cluster, channel, &part));
    }
    found.extend(faster_bus(cluster, &part));
    found.sort_by_key(|relaxation| relaxation.cost);
    // Members of a pool change together.
    found.dedup_by(|a, b| a.change == b.change);
    found
}

fn without_wishes(cluster: &Cluster, channel: usize, effort: &Effort<'_>) -> Option<Relaxation> {
    let mut changed = cluster.clone();
    let had_deadline = changed.channels[channel].deadline.take().is_some();
    let Class::Hard { wishes, .. } = &mut changed.channels[channel].class else { return None };
    if std::mem::take(wishes) == Wishes::default() && !had_deadline {
        return None;
    }
    let name = &cluster.channels[channel].name;
    let change = format!("{name}: give up the wishes for its position (phase, earliest, deadline, after)");
    is_plannable(&changed, effort).then_some(Relaxation { change, cost: 1 })
}

fn fewer_omissions(cluster: &Cluster, channel: usize, effort: &Effort<'_>) -> Option<Relaxation> {
    let now = cluster.omission_degree(channel)?;
    let fewer =
        (0..now).rev().find(|fewer| is_plannable(&cluster.with_omission_degree(channel, *fewer), effort))?;
    let name = &cluster.channels[channel].name;
    let change = match cluster.pool_of(channel) {
        Some(pool) => format!("pool P{pool}: faults = {fewer} instead of {now}"),
        None => format!("{name}: omission_degree = {fewer} instead of {now}"),
    };
    Some(Relaxation { change, cost: 2 * u32::from(now - fewer) })
}

/// A period that other channels have already keeps the calendar simple, so these are tried beside multiples.
fn longer_period(cluster: &Cluster, channel: usize, effort: &Effort<'_>) -> Option<Relaxation> {
    let now = cluster.channels[channel].recurrence.span().as_ticks();
    let others = super::hard_channels(cluster).map(|c| cluster.channels[c].recurrence.span().as_ticks());
    let mut periods: Vec<u64> = others.chain((2..=8).map(|factor| factor * now)).collect();
    periods.retain(|period| *period > now && *period <= 8 * now);
    periods.sort_unstable();
    periods.dedup();
    for period in periods {
        let longer = Duration::from_ticks(period);
        if is_plannable(&cluster.with_period(channel, longer), effort) {
            let name = &cluster.channels[channel].name;
            let change = format!(
                "{name}: a period of {} instead of {}",
                show(longer),
                show(Duration::from_ticks(now))
            );
            return Some(Relaxation { change, cost: 3 + u32::try_from(period / now).unwrap_or(u32::MAX) });
        }
    }
    None
}

fn faster_bus(cluster: &Cluster, effort: &Effort<'_>) -> Option<Relaxation> {
    let now = cluster.segment.bit_rate;
    let faster = USUAL_RATES.iter().filter_map(|bits| BitRate::new(*bits)).filter(|rate| *rate > now);
    for (steps, rate) in faster.enumerate() {
        let mut changed = cluster.clone();
        changed.segment.bit_rate = rate;
        if is_plannable(&changed, effort) {
            let change = format!("segment: bit_rate = \"{}\" instead of {}", show_rate(rate), show_rate(now));
            return Some(Relaxation { change, cost: 10 + steps as u32 });
        }
    }
    None
}

const USUAL_RATES: [u32; 8] = [20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
