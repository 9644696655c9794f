//! Why no calendar exists: a small set of constraints that contradict each other.

use super::layout::Layout;
use super::request::{Item, Request, gcd};
use super::{Effort, exact, greedy};
use crate::cluster::Cluster;
use crate::units::show;
use cosmic_core::time::Duration;
use std::collections::BTreeMap;

/// Constraints that no calendar keeps together, and how to get out of it.
#[derive(Clone, PartialEq, Debug)]
pub struct Conflict {
    /// The constraints, each in words.
    pub constraints: Vec<String>,
    /// The channels whose slots clash: positions in [`Cluster::channels`].
    pub channels: Vec<usize>,
    /// Without any one of the constraints the rest could be kept: nothing is said in vain. `false` if time
    /// ran out before that was known.
    pub minimal: bool,
    /// Why, in one sentence.
    pub reason: String,
}

/// A constraint that could be dropped.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Constraint {
    Window(usize),
    Bounds(usize),
    Link(usize),
}

/// A contradiction that needs no search: its reason and the items in it. O(n log n) in the items, and a look at every
/// pair of different periods.
pub(super) fn obvious(request: &Request) -> Option<(String, Vec<usize>)> {
    let span = |ticks: i64| show(Duration::from_ticks(ticks.unsigned_abs()));
    for (at, item) in request.items.iter().enumerate() {
        if item.window > item.period {
            let reason = format!(
                "a window of {} does not fit into a period of {}",
                span(item.window),
                span(item.period)
            );
            return Some((reason, vec![at]));
        }
        if item.earliest > item.latest {
            return Some(("the wishes for the position of one slot leave no position".to_owned(), vec![at]));
        }
    }
    // Before pairs: a sum is quick, and says more of a bus that is full many times over.
    if let Some(items) = overload(request) {
        return Some(("the windows need more than all of the time".to_owned(), items));
    }
    let (first, second) = too_long_together(request)?;
    let (a, b) = (&request.items[first], &request.items[second]);
    let reason = format!(
        "windows of {} and {} do not fit side by side into {}, within which they meet (periods {} and {})",
        span(a.window),
        span(b.window),
        span(gcd(a.period, b.period)),
        span(a.period),
        span(b.period)
    );
    Some((reason, vec![first.min(second), first.max(second)]))
}

/// Two items whose windows are longer than the time within which they meet. Of the items with one period only the
/// two longest can be among such.
fn too_long_together(request: &Request) -> Option<(usize, usize)> {
    let mut by_period: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
    for at in 0..request.items.len() {
        by_period.entry(request.items[at].period).or_default().push(at);
    }
    let mut longest: Vec<usize> = Vec::new();
    for items in by_period.values_mut() {
        items.sort_by_key(|at| std::cmp::Reverse(request.items[*at].window));
        if let [first, second, ..] = items[..]
            && request.items[first].window + request.items[second].window > request.items[first].period
        {
            return Some((first, second));
        }
        longest.extend(items.first());
    }
    for (at, &first) in longest.iter().enumerate() {
        for &second in &longest[..at] {
            let (a, b) = (&request.items[first], &request.items[second]);
            if a.window + b.window > gcd(a.period, b.period) {
                return Some((first, second));
            }
        }
    }
    None
}

/// Items whose windows need more than all of the time: as few as possible, the largest first.
fn overload(request: &Request) -> Option<Vec<usize>> {
    let share = |item: &Item| item.window as f64 / item.period as f64;
    // Rounding must not call a full bus an overload.
    if request.utilisation() <= 1.0 + 1e-9 {
        return None;
    }
    let mut items: Vec<usize> = (0..request.items.len()).collect();
    items.sort_by(|a, b| share(&request.items[*b]).total_cmp(&share(&request.items[*a])));
    let mut sum = 0.0;
    let enough = items.iter().position(|at| {
        sum += share(&request.items[*at]);
        sum > 1.0 + 1e-9
    })?;
    items.truncate(enough + 1);
    Some(items)
}

/// A small set of constraints that contradict each other, of a request that is known to be impossible.
pub(super) fn find(cluster: &Cluster, layout: &Layout, effort: &Effort<'_>) -> Conflict {
    if let Some((reason, items)) = obvious(&layout.request) {
        let mut kept: Vec<Constraint> = items.iter().map(|at| Constraint::Window(*at)).collect();
        let bounded = reason.starts_with("the wishes");
        if bounded {
            kept.extend(items.iter().map(|at| Constraint::Bounds(*at)));
        }
        return describe(cluster, layout, &kept, reason, true);
    }
    let request = &layout.request;
    let mut kept: Vec<Constraint> = (0..request.links.len()).map(Constraint::Link).collect();
    kept.extend((0..request.items.len()).filter(|at| is_bounded(layout, *at)).map(Constraint::Bounds));
    let mut windows: Vec<usize> = (0..request.items.len()).collect();
    // Slots that take little are dropped first, so that a few large ones remain.
    windows.sort_by_key(|at| request.items[*at].window * 1000 / request.items[*at].period);
    kept.extend(windows.into_iter().map(Constraint::Window));
    // Single occurrences are no constraints that their user could drop one by one.
    let mut minimal = request.items.iter().all(|item| item.spacing.is_none());
    let mut at = 0;
    while at < kept.len() {
        if !effort.spend(100 * kept.len() as u64) {
            minimal = false;
            break;
        }
        let mut without = kept.clone();
        let dropped = without.remove(at);
        if let Constraint::Window(item) = dropped {
            // A slot goes with the wishes for it.
            without.retain(|c| !concerns(request, *c, item));
        }
        match is_impossible(&reduced(layout, &without), effort) {
            Some(true) => {
                // What was found to be needed before stays so: fewer constraints clash less.
                at = kept[..at].iter().filter(|constraint| without.contains(constraint)).count();
                kept = without;
            }
            Some(false) => at += 1,
            None => {
                minimal = false;
                at += 1;
            }
        }
        effort.report("there is no calendar; looking for the smallest contradiction");
    }
    let reason = "no order of these slots keeps their windows apart".to_owned();
    describe(cluster, layout, &kept, reason, minimal)
}

fn is_bounded(layout: &Layout, at: usize) -> bool {
    let item = &layout.request.items[at];
    item.earliest > 0 || item.latest < layout.unwished[at]
}

fn concerns(request: &Request, constraint: Constraint, item: usize) -> bool {
    match constraint {
        Constraint::Window(at) | Constraint::Bounds(at) => at == item,
        Constraint::Link(at) => request.links[at].first == item || request.links[at].then == item,
    }
}

/// The request with only these constraints.
fn reduced(layout: &Layout, kept: &[Constraint]) -> Request {
    let request = &layout.request;
    let mut reduced = request.clone();
    for (at, item) in reduced.items.iter_mut().enumerate() {
        if !kept.contains(&Constraint::Bounds(at)) {
            (item.earliest, item.latest) = (0, layout.unwished[at]);
        }
    }
    let links = reduced.links.iter().enumerate();
    reduced.links =
        links.filter(|(at, _)| kept.contains(&Constraint::Link(*at))).map(|(_, link)| *link).collect();
    let items: Vec<usize> =
        (0..request.items.len()).filter(|at| kept.contains(&Constraint::Window(*at))).collect();
    reduced.restricted(&items)
}

fn is_impossible(request: &Request, effort: &Effort<'_>) -> Option<bool> {
    if obvious(request).is_some() {
        return Some(true);
    }
    let mut steps = 0;
    let first_try = greedy::place(request, &mut |taken| {
        steps += taken;
        false
    });
    if first_try.is_some() {
        return Some(false);
    }
    if !effort.spend(steps) {
        return None;
    }
    // Nothing that takes more than its share.
    let answer =
        effort.within(effort.left() / 4, |part| exact::solve(request, &mut |steps| part.spend(steps)));
    match answer {
        exact::Answer::Impossible => Some(true),
        exact::Answer::Placed(_) => Some(false),
        exact::Answer::Unknown => None,
    }
}

fn describe(
    cluster: &Cluster,
    layout: &Layout,
    kept: &[Constraint],
    reason: String,
    minimal: bool,
) -> Conflict {
    let request = &layout.request;
    let span = |ticks: i64| show(Duration::from_ticks(ticks.unsigned_abs()));
    let name = |at: usize| {
        let slots = layout.owners[at].slots.iter();
        let names: Vec<_> = slots
            .map(|(channel, node)| {
                format!("{} of {}", cluster.channels[*channel].name, cluster.nodes[*node].name)
            })
            .collect();
        names.join(" + ")
    };
    let words = |constraint: &Constraint| match *constraint {
        Constraint::Window(at) => {
            let item = &request.items[at];
            let period = layout.owners[at]
                .slots
                .first()
                .map(|(channel, _)| cluster.channels[*channel].recurrence.span());
            let period = period.map_or_else(|| span(item.period), show);
            format!("{}: a window of {} every {period}", name(at), span(item.window))
        }
        Constraint::Bounds(at) => {
            let item = &request.items[at];
            let bounds = match item {
                _ if request.items.iter().any(|item| item.spacing.is_some()) => {
                    "every occurrence within its period, its wishes and its jitter".to_owned()
                }
                _ if item.latest < 0 => "its deadline is shorter than its window".to_owned(),
                _ => format!("ready from {} to {} of each period", span(item.earliest), span(item.latest)),
            };
            format!("{}: {bounds}", name(at))
        }
        Constraint::Link(at) => {
            let link = &request.links[at];
            format!("{}: after {}, at most {} later", name(link.then), name(link.first), span(link.within))
        }
    };
    let mut channels: Vec<usize> = Vec::new();
    for constraint in kept {
        let items = match *constraint {
            Constraint::Window(at) | Constraint::Bounds(at) => vec![at],
            Constraint::Link(at) => vec![request.links[at].first, request.links[at].then],
        };
        for (channel, _) in items.iter().flat_map(|at| &layout.owners[*at].slots) {
            if !channels.contains(channel) {
                channels.push(*channel);
            }
        }
    }
    let mut constraints: Vec<String> = Vec::new();
    for constraint in kept.iter().map(words) {
        if !constraints.contains(&constraint) {
            constraints.push(constraint);
        }
    }
    Conflict { constraints, channels, minimal, reason }
}
