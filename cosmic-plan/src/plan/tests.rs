//! Requests that were made from positions, so that a calendar is known to exist.

use super::circle::Circle;
use super::request::{Item, Request};
use super::{Effort, exact, search};

use proptest::prelude::RngExt as _;
use proptest::test_runner::TestRng;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Fills a cycle with windows at random places, until `slots` occurrences are in it or nothing more fits.
fn planted(
    seed: u64,
    periods: &[i64],
    windows: std::ops::Range<i64>,
    slots: i64,
    bounded: bool,
    dense: bool,
) -> Request {
    let mut rng = rng(seed);
    let cycle = periods.iter().fold(1, |c, p| c / super::request::gcd(c, *p) * p);
    let mut circles: BTreeMap<i64, Circle> = periods.iter().map(|p| (*p, Circle::new(*p))).collect();
    let mut request = Request::default();
    let (mut used, mut failures) = (0, 0);
    while used < slots && failures < 200 {
        let period = periods[rng.random_range(0..periods.len())];
        let window = rng.random_range(windows.clone());
        let places = circles[&period].places(window, 0, period - 1);
        if places.is_empty() || used + cycle / period > slots {
            failures += 1;
            continue;
        }
        let (from, to) = places[rng.random_range(0..places.len())];
        let x = if dense {
            let x = from;
            let _ = to;
            x
        } else {
            rng.random_range(from..=to)
        };
        for circle in circles.values_mut() {
            circle.take(x, window, period);
        }
        let room = if bounded { rng.random_range(0..period / 4) } else { period };
        let (earliest, latest) = ((x - room).max(0), (x + room).min(period - 1));
        request.items.push(Item { period, window, earliest, latest, spacing: None });
        used += cycle / period;
    }
    request
}

fn rng(seed: u64) -> TestRng {
    use proptest::test_runner::RngAlgorithm;
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    TestRng::from_seed(RngAlgorithm::ChaCha, &bytes)
}

#[test]
fn bench() {
    for (name, periods, windows) in [
        ("harmonic", vec![5000, 10000, 20000, 40000], 300..1200),
        ("harmonic2", vec![10000, 20000, 40000], 500..3000),
        ("nonharm", vec![4000, 6000, 12000], 200..700),
        ("nonharm2", vec![10000, 15000, 25000], 300..1500),
        ("single", vec![40000], 300..1500),
    ] {
        for bounded in [false, true] {
            let mut times = Vec::new();
            let mut failed = 0;
            let mut util: f64 = 0.0;
            for seed in 0..30 {
                let request = planted(seed, &periods, windows.clone(), 50, bounded, true);
                util += request.utilisation() / 30.0;
                let t = Instant::now();
                let effort = Effort { limit: Duration::from_secs(5), watch: None };
                match search(&request, &effort) {
                    exact::Answer::Placed(x) => assert!(request.accepts(&x)),
                    _ => failed += 1,
                }
                times.push(t.elapsed().as_millis());
            }
            times.sort();
            println!(
                "{name} bounded {bounded}: util {util:.2} failed {failed} median {} max {}",
                times[15], times[29]
            );
        }
    }
}
