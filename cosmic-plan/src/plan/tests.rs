//! The planner against brute force, and on requests that were made from positions, so that a calendar is
//! known to exist.

use super::circle::Circle;
use super::request::{Item, Link, Request, Spacing, gcd};
use super::{Effort, exact, greedy, search, spread};
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::collections::BTreeMap;

fn rng(seed: u64) -> TestRng {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    TestRng::from_seed(RngAlgorithm::ChaCha, &bytes)
}

/// How a planted request is made.
struct Plant<'a> {
    periods: &'a [i64],
    windows: std::ops::Range<i64>,
    slots: i64,
    /// Each item may move by less than a quarter of its period only.
    bounded: bool,
    /// Each window follows another without a gap where it can.
    dense: bool,
}

/// Fills a cycle with windows until so many occurrences are in it, or nothing more fits.
fn planted(seed: u64, plant: &Plant<'_>) -> Request {
    let mut rng = rng(seed);
    let cycle = plant.periods.iter().fold(1, |cycle, p| cycle / gcd(cycle, *p) * p);
    let mut circles: BTreeMap<i64, Circle> = plant.periods.iter().map(|p| (*p, Circle::new(*p))).collect();
    let mut request = Request::default();
    let (mut used, mut failures) = (0, 0);
    while used < plant.slots && failures < 200 {
        let period = plant.periods[rng.random_range(0..plant.periods.len())];
        let window = rng.random_range(plant.windows.clone());
        let places = circles[&period].places(window, 0, period - 1);
        if places.is_empty() || used + cycle / period > plant.slots {
            failures += 1;
            continue;
        }
        let (from, to) = places[rng.random_range(0..places.len())];
        let x = if plant.dense { from } else { rng.random_range(from..=to) };
        for circle in circles.values_mut() {
            circle.take(x, window, period);
        }
        let room = if plant.bounded { rng.random_range(0..period / 4) } else { period };
        let (earliest, latest) = ((x - room).max(0), (x + room).min(period - 1));
        request.items.push(Item { period, window, earliest, latest, spacing: None });
        used += cycle / period;
    }
    request
}

#[test]
fn what_was_planted_is_found() {
    let kinds: [(&[i64], std::ops::Range<i64>); 4] = [
        (&[5000, 10_000, 20_000, 40_000], 300..1200),
        (&[10_000, 20_000, 40_000], 500..3000),
        (&[4000, 6000, 12_000], 200..700),
        (&[10_000, 15_000, 25_000], 300..1500),
    ];
    for (periods, windows) in kinds {
        for (bounded, dense) in [(false, false), (false, true), (true, false), (true, true)] {
            for seed in 0..8 {
                let plant = Plant { periods, windows: windows.clone(), slots: 50, bounded, dense };
                let request = planted(seed, &plant);
                let effort = Effort::of(60_000_000_000);
                let exact::Answer::Placed(positions) = search(&request, &effort) else {
                    panic!("seed {seed}, periods {periods:?}, bounded {bounded}, dense {dense}: not found");
                };
                assert!(request.accepts(&positions));
                let spread = spread::spread(&request, &positions);
                assert!(request.accepts(&spread), "seed {seed}, periods {periods:?}: spreading broke a rule");
            }
        }
    }
}

/// Do any positions at all keep every rule? By trying all of them.
fn brute_force(request: &Request) -> bool {
    fn next(request: &Request, positions: &mut Vec<i64>) -> bool {
        let at = positions.len();
        if at == request.items.len() {
            return request.accepts(positions);
        }
        let item = request.items[at];
        (item.earliest..=item.latest).any(|x| {
            positions.push(x);
            // Items behind the first ones are not there yet, so only their own rules are asked.
            let partial = request.restricted(&(0..=at).collect::<Vec<_>>());
            let found = partial.accepts(positions) && next(request, positions);
            positions.pop();
            found
        })
    }
    next(request, &mut Vec::new())
}

fn small_request() -> impl Strategy<Value = Request> {
    let item = (prop::sample::select(vec![4_i64, 6, 8, 12]), 1_i64..4, 0_i64..6, 0_i64..12);
    let items = prop::collection::vec(item, 2..6);
    (items, prop::option::of((0_usize..2, 0_i64..4)), prop::option::of(1_i64..3)).prop_map(
        |(items, link, jitter)| {
            let mut items: Vec<Item> = items
                .into_iter()
                .map(|(period, window, earliest, room)| {
                    let earliest = earliest.min(period - 1);
                    let latest = (earliest + room).min(period - 1);
                    Item { period, window, earliest, latest, spacing: None }
                })
                .collect();
            let links = link
                .map(|(first, within)| Link { first, then: 1 - first, within })
                .filter(|_| items[0].period % items[1].period == 0 || items[1].period % items[0].period == 0);
            if let (Some(jitter), None) = (jitter, &links) {
                // The last two become two occurrences of one channel.
                let last = items.len() - 1;
                let (reference, offset) = (last - 1, 6);
                items[reference] = Item { period: 12, window: 1, earliest: 0, latest: 5, spacing: None };
                let spacing = Some(Spacing { reference, offset, jitter });
                items[last] = Item { earliest: 6, latest: 11, spacing, ..items[reference] };
            }
            Request { items, links: links.into_iter().collect() }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn the_complete_search_agrees_with_brute_force(request in small_request()) {
        match exact::solve(&request, &mut |_| true) {
            exact::Answer::Placed(positions) => prop_assert!(request.accepts(&positions), "{positions:?}"),
            exact::Answer::Impossible => prop_assert!(!brute_force(&request)),
            exact::Answer::Unknown => prop_assert!(false, "nobody stopped it"),
        }
    }

    #[test]
    fn quick_placement_breaks_no_rule(request in small_request()) {
        if let Some(positions) = greedy::place(&request, &mut |_| true) {
            prop_assert!(request.accepts(&positions), "{positions:?}");
        }
    }
}
