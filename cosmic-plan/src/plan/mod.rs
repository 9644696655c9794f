//! Calendar synthesis: where each hard real-time slot stands.
//!
//! Every hard real-time channel needs one slot for each of its publishers. A slot's window is fixed by
//! its frame length and omission degree ([`Segment::slot_times`](cosmic_core::calendar::Segment::slot_times)); what is sought is its phase, such
//! that no windows of any occurrences overlap. That problem (strictly periodic, non-pre-emptive) is
//! NP-hard, so three methods follow each other: quick placement, which nearly always succeeds; a complete
//! search, which finds a calendar whenever one exists or proves that none does; and, for channels that
//! allow jitter, placement of every occurrence by itself. What was found is then spread out, so that the
//! free time comes in even portions.

mod circle;
pub mod conflict;
mod effort;
mod exact;
pub mod found;
mod greedy;
mod layout;
pub mod relax;
pub mod request;
mod spread;

use crate::cluster::{Cluster, PlannedClass};
use conflict::Conflict;
use cosmic_core::time::Duration;
pub use effort::Effort;
pub use found::{Method, Plan, PlannedSlot};
use layout::Layout;

/// Why there is no plan.
#[derive(Clone, PartialEq, Debug)]
pub enum NoPlan {
    /// No calendar exists: a few constraints that contradict each other.
    Impossible(Conflict),
    /// None was found in the steps allowed, nor a proof that none exists.
    GaveUp {
        /// How many slots there are to place.
        slots: usize,
        /// The share of time that they would reserve.
        reserved: f64,
    },
}

/// Finds a calendar for the hard real-time channels.
///
/// # Errors
/// There is none, and why; or none was found in the steps allowed.
pub fn plan(cluster: &Cluster, effort: &Effort<'_>) -> Result<Plan, NoPlan> {
    let layout = Layout::of(cluster);
    if layout.request.items.is_empty() {
        let cycle = Duration::from_millis(10);
        return Ok(Plan { segment: cluster.segment, cycle, slots: Vec::new(), method: Method::Empty });
    }
    // Half for finding one, a quarter for the reasons if there is none; the rest is for ways out.
    let whole = effort.left();
    let strict = match effort.within(whole / 2, |part| search(&layout.request, part)) {
        exact::Answer::Placed(positions) => return Ok(finish(cluster, &layout, positions)),
        other => other,
    };
    // With jitter to use, the contradiction must be one of single occurrences.
    let (last, answer) = match effort.within(whole / 2, |part| place_occurrences(cluster, &layout, part)) {
        None => (layout, strict),
        Some((split, exact::Answer::Placed(positions))) => {
            return Ok(split.plan(cluster, &positions, Method::Occurrences));
        }
        Some(other) => other,
    };
    let request = &last.request;
    match answer {
        exact::Answer::Impossible => {
            let conflict = effort.within(whole / 4, |part| conflict::find(cluster, &last, part));
            Err(NoPlan::Impossible(conflict))
        }
        _ => Err(NoPlan::GaveUp { slots: request.items.len(), reserved: request.utilisation() }),
    }
}

/// Returns whether there is a calendar. As [`plan`], without the reason if there is none.
pub fn is_plannable(cluster: &Cluster, effort: &Effort<'_>) -> bool {
    let layout = Layout::of(cluster);
    if !effort.spend(STEPS_OF_A_CHANNEL * cluster.channels.len() as u64) {
        return false;
    }
    if matches!(search(&layout.request, effort), exact::Answer::Placed(_)) {
        return true;
    }
    matches!(place_occurrences(cluster, &layout, effort), Some((_, exact::Answer::Placed(_))))
}

/// Places every occurrence by itself, with an eighth of the jitter that is allowed if that suffices, else with
/// a quarter, half or all of it. `None` if no channel allows any; else the answer, with all of it if none is
/// found.
fn place_occurrences(
    cluster: &Cluster,
    layout: &Layout,
    effort: &Effort<'_>,
) -> Option<(Layout, exact::Answer)> {
    let mut last = None;
    for part in [8, 4, 2, 1] {
        let split = layout.by_occurrence(cluster, part)?;
        // Less than all of the jitter is for comfort; most of the time is for what decides.
        let most = if part == 1 { effort.left() } else { effort.left() / 8 };
        let answer = match conflict::obvious(&split.request) {
            Some(_) => exact::Answer::Impossible,
            None => effort.within(most, |part| run_exact(&split.request, part)),
        };
        let placed = matches!(answer, exact::Answer::Placed(_));
        last = Some((split, answer));
        if placed {
            break;
        }
    }
    last
}

/// The plan with these positions, spread out; or one with others, if soft and non real-time channels fare
/// better with them. The choice depends on nothing but the cluster.
fn finish(cluster: &Cluster, layout: &Layout, placed: Vec<i64>) -> Plan {
    let request = &layout.request;
    let method = if greedy_found(request, &placed) { Method::Placement } else { Method::Search };
    let spread_out = spread::spread(request, &placed);
    let first = if request.accepts(&spread_out) { spread_out } else { placed.clone() };
    let mut best = layout.plan(cluster, &first, method);
    if request.items.len() > MOST_TO_COMPARE {
        return best;
    }
    let mut least = strain(cluster, &best);
    let variants = greedy::variants(request);
    let spread_variants = variants.iter().map(|positions| spread::spread(request, positions));
    for positions in spread_variants.chain([placed]).chain(variants.iter().cloned()) {
        // Zero: nothing besides the calendar has a deadline.
        if least == 0.0 || !request.accepts(&positions) {
            continue;
        }
        let other = layout.plan(cluster, &positions, method);
        let strain = strain(cluster, &other);
        if strain < least {
            (best, least) = (other, strain);
        }
    }
    widened(cluster, layout, best, least)
}

/// A plan under which no bound is worse, and the smallest gap between two windows is as wide as was found: windows are
/// placed as if they were longer by the gap.
fn widened(cluster: &Cluster, layout: &Layout, mut best: Plan, least: f64) -> Plan {
    let method = best.method();
    let mut gap = best.narrowest_gap();
    let occurrences = best.occurrences().len().max(1) as u64;
    let free = best.cycle().as_ticks() as f64 * (1.0 - best.reserved());
    // No smallest gap is wider than the mean of all.
    let mut too_wide = (free.max(0.0) / occurrences as f64) as u64 + 1;
    for _ in 0..GAPS_TRIED {
        let wish = gap.as_ticks() + too_wide.saturating_sub(gap.as_ticks()) / 2;
        if wish <= gap.as_ticks() {
            break;
        }
        let mut left = STEPS_OF_A_GAP;
        let request = layout.request.with_gaps(i64::try_from(wish).unwrap_or(i64::MAX / 4));
        let placed = request.and_then(|request| {
            greedy::place(&request, &mut |steps: u64| {
                left = left.saturating_sub(steps);
                left > 0
            })
        });
        // On full 10 µs or 1 µs if that keeps the gap: people read these numbers.
        let rounded =
            |unit: i64| placed.iter().map(move |at| at.iter().map(|x| x / unit * unit).collect::<Vec<_>>());
        let candidates = [10_000, 1_000, 1].into_iter().flat_map(rounded);
        let found = candidates
            .filter(|positions| layout.request.accepts(positions))
            .map(|positions| layout.plan(cluster, &positions, method))
            .find(|plan| plan.narrowest_gap() > gap && strain(cluster, plan) <= least);
        match found {
            Some(plan) => (gap, best) = (plan.narrowest_gap(), plan),
            None => too_wide = wish,
        }
    }
    best
}

/// How near the worst bound comes to its deadline, as a share; beyond 1 it misses.
fn strain(cluster: &Cluster, plan: &Plan) -> f64 {
    let assessment = crate::analysis::segment::assess(cluster, plan);
    let event_triggered =
        |channel: usize| !matches!(cluster.channels[channel].class, PlannedClass::Hard { .. });
    let channels = assessment.channels.iter().filter(|c| event_triggered(c.channel)).map(|c| &c.proof);
    let shares = channels.chain(&assessment.foreign).filter_map(|proof| {
        let deadline = proof.deadline?.as_ticks() as f64;
        Some(proof.bound.map_or(f64::INFINITY, |bound| bound.as_ticks() as f64 / deadline))
    });
    shares.fold(0.0, f64::max)
}

fn greedy_found(request: &request::Request, positions: &[i64]) -> bool {
    greedy::place(request, &mut |_| false).as_deref() == Some(positions)
}

/// Quick placement, then the complete search.
fn search(request: &request::Request, effort: &Effort<'_>) -> exact::Answer {
    if conflict::obvious(request).is_some() {
        return exact::Answer::Impossible;
    }
    let small = exact::size(request) <= EXACT_SIZE;
    // Where the complete search can take over it soon should.
    let share = if small { 20 } else { 3 };
    let placed = effort.within(effort.left() / share, |part| {
        greedy::place(request, &mut |steps| {
            part.report("placing slots");
            part.spend(steps)
        })
    });
    match placed {
        Some(positions) => exact::Answer::Placed(positions),
        None if small => run_exact(request, effort),
        None => exact::Answer::Unknown,
    }
}

fn run_exact(request: &request::Request, effort: &Effort<'_>) -> exact::Answer {
    exact::solve(request, &mut |steps| {
        effort.report("searching all orders of slots");
        effort.spend(steps)
    })
}

/// How many hard real-time channels there are.
pub fn hard_channels(cluster: &Cluster) -> impl Iterator<Item = usize> + '_ {
    let hard = |at: &usize| matches!(cluster.channels[*at].class, PlannedClass::Hard { .. });
    (0..cluster.channels.len()).filter(hard)
}

/// So many widths of a gap are tried, and with so many steps each.
const GAPS_TRIED: usize = 16;
const STEPS_OF_A_GAP: u64 = 20_000_000;

/// What it takes to lay a cluster out, for each channel.
const STEPS_OF_A_CHANNEL: u64 = 500;

/// Slots up to which several calendars are compared.
const MOST_TO_COMPARE: usize = 120;

/// Truth values up to which the complete search is tried.
const EXACT_SIZE: i64 = 60_000;

#[cfg(test)]
mod tests;
