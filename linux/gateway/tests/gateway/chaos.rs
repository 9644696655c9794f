//! Chaos, drawn from a seed: gateways die and come back, the broker with its table or without, ways stall, slow down and
//! are cut, a stranger on IP babbles and its clock steps. The gateways of both segments, and a node of each, have the
//! same UID, as if by mistake. Whatever comes, on the far bus nothing comes twice, nothing is stale, no channel exceeds
//! its rate; and what did not come was counted.
//!
//! The steps follow from the seed; what happens between them is the machine's, for zenoh knows no time but the real one.
//! `COSMIC_SEED=n` repeats one, `COSMIC_RUNS=n` runs the seeds 1 to n, four at a time.

mod judge;
mod world;

use std::time::Duration as Span;

use rand_core::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use world::{Station, World};

/// What happens.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Step {
    Cut(Span),
    Stall(Span),
    /// There and back.
    Slow(Span, Span),
    /// For so long it is gone. `forgets`: the table of its broker is gone too.
    Kill {
        station: Station,
        pause: Span,
        forgets: bool,
    },
    Babble,
    /// By so many milliseconds.
    ClockSteps(i64),
}

fn draw(random: &mut Pcg64Mcg) -> Step {
    let mut below = |limit: u64| random.next_u64() % limit;
    let mut span = |from: u64, to: u64| Span::from_millis(from + below(to - from));
    match span(0, 9).as_millis() {
        0 | 1 => Step::Cut(span(200, 2500)),
        // Shorter than zenoh takes to give a connection up.
        2 => Step::Stall(span(800, 1500)),
        3 => Step::Slow(span(0, 60), span(0, 60)),
        4..=6 => {
            let station = [Station::First, Station::Second, Station::East][span(0, 3).as_millis() as usize];
            Step::Kill { station, pause: span(50, 1200), forgets: span(0, 2).is_zero() }
        }
        7 => Step::Babble,
        _ => Step::ClockSteps(span(0, 20_000).as_millis() as i64 - 10_000),
    }
}

async fn run(seed: u64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let steps: Vec<_> = (0..STEPS).map(|_| draw(&mut random)).collect();
    eprintln!("COSMIC_SEED={seed} repeats this: {steps:?}");
    let mut world = World::start().await;
    for step in steps {
        world.take(step).await;
        world.calm().await;
    }
    // A stranger in any case.
    world.take(Step::Babble).await;
    let outcome = world.end().await;
    outcome.judge(seed);
}

#[test]
fn nothing_twice_nothing_stale_no_flood_nothing_lost_unsaid() {
    let number = |name| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seeds: Vec<_> = match (number("COSMIC_SEED"), number("COSMIC_RUNS")) {
        (Some(seed), _) => vec![seed],
        (None, runs) => (1..=runs.unwrap_or(DEFAULT_RUNS)).collect(),
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(4).enable_all().build().unwrap();
    for batch in seeds.chunks(4) {
        runtime.block_on(async {
            let runs: Vec<_> = batch.iter().map(|seed| (*seed, tokio::spawn(run(*seed)))).collect();
            for (seed, run) in runs {
                assert!(run.await.is_ok(), "COSMIC_SEED={seed} repeats this");
            }
        });
    }
}

const STEPS: usize = 5;
const DEFAULT_RUNS: u64 = 4;
