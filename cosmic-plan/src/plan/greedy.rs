//! Fast placement, one item after the other.
//!
//! Items are placed in an order of difficulty, each where it fits. If one does not fit it moves to the
//! front of the order and all starts again ("squeaky wheel"), in turns with different rules for the
//! choice among places. This finds calendars for thousands of slots in well under a second, but proves
//! nothing when it fails.

use super::circle::Circle;
use super::request::{Item, Request};
use std::collections::BTreeMap;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Rule {
    First,
    Best,
    Last,
}

/// Positions for all items, or `None` if every try that `proceed` allowed failed; it is told how many steps a try has
/// taken. Items with a spacing are not for this.
pub(super) fn place(request: &Request, proceed: &mut dyn FnMut(u64) -> bool) -> Option<Vec<i64>> {
    if request.items.iter().any(|item| item.spacing.is_some()) {
        return None;
    }
    let mut urgency: Vec<u32> = vec![0; request.items.len()];
    let tries = 40 + 4 * request.items.len().min(200);
    for attempt in 0..tries {
        let mut steps = 0;
        let rule = [Rule::First, Rule::Best, Rule::Last][attempt % 3];
        match place_in_order(request, &order(request, &urgency), rule, &mut steps) {
            Ok(positions) => return Some(positions),
            Err(failed) => urgency[failed] += 1 + attempt as u32,
        }
        if !proceed(steps) {
            return None;
        }
    }
    None
}

/// What each rule for the choice among places gives by itself: calendars to choose from.
pub(super) fn variants(request: &Request) -> Vec<Vec<i64>> {
    if request.items.iter().any(|item| item.spacing.is_some()) {
        return Vec::new();
    }
    let order = order(request, &vec![0; request.items.len()]);
    let rules = [Rule::First, Rule::Best, Rule::Last];
    rules.into_iter().filter_map(|rule| place_in_order(request, &order, rule, &mut 0).ok()).collect()
}

/// Most urgent first; then little freedom, short periods, long windows. What follows something else comes
/// right behind it.
fn order(request: &Request, urgency: &[u32]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..request.items.len()).collect();
    let freedom = |item: &Item| (item.latest - item.earliest).min(item.period - item.window);
    order.sort_by_key(|&at| {
        let item = &request.items[at];
        (std::cmp::Reverse(urgency[at]), freedom(item), item.period, -item.window)
    });
    for _ in 0..request.links.len() {
        for link in &request.links {
            let find = |what: usize| order.iter().position(|at| *at == what);
            if let (Some(first), Some(then)) = (find(link.first), find(link.then))
                && then < first
            {
                let item = order.remove(first);
                order.insert(then, item);
            }
        }
    }
    order
}

/// The positions, or the item for which there was no place.
fn place_in_order(
    request: &Request,
    order: &[usize],
    rule: Rule,
    steps: &mut u64,
) -> Result<Vec<i64>, usize> {
    let mut circles: BTreeMap<i64, Circle> =
        request.items.iter().map(|item| (item.period, Circle::new(item.period))).collect();
    let mut positions: Vec<Option<i64>> = vec![None; request.items.len()];
    for &at in order {
        let item = &request.items[at];
        let circle = &circles[&item.period];
        let places = linked_places(request, at, &positions, circle);
        let position = choose(&places, rule).ok_or(at)?;
        positions[at] = Some(position);
        for circle in circles.values_mut() {
            *steps += circle.take(position, item.window, item.period);
        }
        *steps += 20 * (1 + request.links.len()) as u64 + 2 * places.len() as u64;
    }
    Ok(positions.into_iter().flatten().collect())
}

/// Where an item fits, cut down to what its links to placed items allow.
pub(super) fn linked_places(
    request: &Request,
    at: usize,
    positions: &[Option<i64>],
    circle: &Circle,
) -> Vec<(i64, i64)> {
    let item = &request.items[at];
    let mut places = circle.places(item.window, item.earliest, item.latest);
    for link in &request.links {
        let (first, then) = (&request.items[link.first], &request.items[link.then]);
        let grid = first.period.min(then.period);
        let (low, high) = match (positions[link.first], positions[link.then]) {
            (Some(x), _) if link.then == at => (x + first.window, x + first.window + link.within),
            (_, Some(x)) if link.first == at => (x - first.window - link.within, x - first.window),
            _ => continue,
        };
        if high - low < grid - 1 {
            places = intersect(&places, low, high, grid);
        }
    }
    places
}

/// The parts of `places` that lie in `low..=high` modulo `grid`.
fn intersect(places: &[(i64, i64)], low: i64, high: i64, grid: i64) -> Vec<(i64, i64)> {
    let mut parts = Vec::new();
    for &(from, to) in places {
        let mut turn = (from - high).div_euclid(grid);
        while low + turn * grid <= to {
            let part = (from.max(low + turn * grid), to.min(high + turn * grid));
            if part.0 <= part.1 {
                parts.push(part);
            }
            turn += 1;
        }
    }
    parts
}

fn choose(places: &[(i64, i64)], rule: Rule) -> Option<i64> {
    match rule {
        Rule::First => places.first().map(|place| place.0),
        Rule::Best => places.iter().min_by_key(|place| place.1 - place.0).map(|place| place.0),
        // On a full microsecond if there is one: people read these numbers.
        Rule::Last => places.last().map(|place| (place.1 / 1000 * 1000).max(place.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::request::Link;

    #[test]
    fn placed_requests_are_accepted() {
        let item = |period, window| Item { period, window, earliest: 0, latest: period - 1, spacing: None };
        let request = Request {
            items: vec![item(20, 2), item(10, 2), item(40, 3), item(10, 1)],
            links: vec![Link { first: 0, then: 2, within: 4 }],
        };
        let positions = place(&request, &mut |_| true).expect("there is room");
        assert!(request.accepts(&positions), "{positions:?}");
    }

    #[test]
    fn parts_of_places() {
        assert_eq!(intersect(&[(0, 30)], 3, 5, 10), [(3, 5), (13, 15), (23, 25)]);
        assert_eq!(intersect(&[(4, 14)], 3, 5, 10), [(4, 5), (13, 14)]);
    }
}
