//! Spreads slots, so that what is left for the other classes comes in even portions.
//!
//! How much time remains does not depend on where the slots stand; how long soft and non real-time frames
//! may have to wait for it does. Each slot in turn moves to the middle of the widest place that is free for
//! it. All rules keep holding.

use super::circle::Circle;
use super::greedy::linked_places;
use super::request::Request;

/// Better positions, from good ones. The work is bounded by the number of items alone, not by a clock: the
/// same cluster must always get the same calendar.
pub(super) fn spread(request: &Request, positions: &[i64]) -> Vec<i64> {
    let mut best = positions.to_vec();
    let count = best.len().max(1);
    // A move costs a look at all other items.
    let moves = (MOST_LOOKS / count).min(ROUNDS * count);
    for at in (0..count).cycle().take(moves) {
        if let Some(position) = better_place(request, at, &best) {
            best[at] = position;
        }
    }
    best
}

const ROUNDS: usize = 4;
const MOST_LOOKS: usize = 2_000_000;

fn better_place(request: &Request, at: usize, positions: &[i64]) -> Option<i64> {
    let item = &request.items[at];
    if item.spacing.is_some() || item.earliest == item.latest {
        return None;
    }
    let referred = |other: &super::request::Item| other.spacing.is_some_and(|s| s.reference == at);
    if request.items.iter().any(referred) {
        return None;
    }
    let mut circle = Circle::new(item.period);
    for (k, (other, position)) in request.items.iter().zip(positions).enumerate() {
        if k != at {
            circle.take(*position, other.window, other.period);
        }
    }
    let known: Vec<Option<i64>> = positions.iter().map(|x| Some(*x)).collect();
    if request.items.len() == 1 {
        return None;
    }
    let places = linked_places(request, at, &known, &circle);
    // A place across the end of the period comes in two parts; the larger one counts.
    let widest = places.iter().max_by_key(|place| place.1 - place.0)?;
    let here = places.iter().find(|place| (place.0..=place.1).contains(&positions[at]));
    let gain = here.is_none_or(|here| here.1 - here.0 <= widest.1 - widest.0);
    gain.then(|| round_middle(*widest))
}

/// The middle of a place, on a full 10 µs or 1 µs if there is one near: people read these numbers.
fn round_middle((from, to): (i64, i64)) -> i64 {
    let middle = from + (to - from) / 2;
    [10_000, 1_000].into_iter().map(|unit| middle / unit * unit).find(|x| *x >= from).unwrap_or(middle)
}

/// The longest stretch in which windows follow each other without a gap, per period of the request's
/// shortest common cycle: at most how long the bus is reserved at a time.
pub(super) fn longest_stretch(windows: &[(i64, i64)], cycle: i64) -> i64 {
    let mut circle = Circle::new(cycle);
    for &(from, window) in windows {
        circle.take(from, window, cycle);
    }
    let free = circle.free();
    let mut longest = if free.is_empty() { cycle } else { 0 };
    for pair in free.windows(2) {
        longest = longest.max(pair[1].0 - pair[0].1);
    }
    if let (Some(first), Some(last)) = (free.first(), free.last()) {
        longest = longest.max((first.0 + cycle - last.1).rem_euclid(cycle));
    }
    longest
}
