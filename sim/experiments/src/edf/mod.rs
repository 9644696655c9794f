//! The breakdown utilisation of earliest deadline first through the identifier mapping, of fixed
//! priorities, and of ideal earliest deadline first.
//!
//! A random set of periodic messages is made to fill the bus more and more, by shortening all its periods
//! alike, until the first deadline is missed (Lehoczky, Sha, Ding 1989 define the breakdown utilisation
//! so). A deadline is met if the last bit of the frame has been sent by then. Each load is tried with all
//! messages released at once, and with random offsets.

mod ideal;
mod message_set;
mod outcome;
mod picture;
mod report;
mod simulation;

use crate::output::{self, Conclusion, Results, Sink};
use cosmic_commands::experiment::Edf as Options;
use cosmic_core::can::{BitRate, Payload};
use cosmic_core::time::{Duration, Instant};
use message_set::{MessageSet, Timing};
use outcome::Run;
use report::{Breakdown, Report, SetResult};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::num::NonZero;
use std::sync::atomic::{AtomicU64, Ordering};

/// Who is served first.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Policy {
    /// The earliest deadline in each node, and by the priority field among nodes, with this Δt_p.
    Mapped { step: Duration },
    /// Fixed priorities: the shorter the relative deadline, the more urgent.
    DeadlineMonotonic,
    /// The earliest deadline of all nodes.
    Ideal,
}

/// In the order of the report.
const POLICIES: [Policy; 4] = [
    Policy::Ideal,
    Policy::Mapped { step: BitRate::MAX.longest_frame(Payload::MAX_LEN) },
    Policy::DeadlineMonotonic,
    Policy::Mapped { step: Duration::from_millis(1) },
];

/// Does what `experiment edf` is to do.
pub(crate) fn run(options: &Options) -> anyhow::Result<Conclusion> {
    let results = Results::open(options.json.as_deref())?;
    let svg = Sink::open(options.svg.as_deref(), "name another file with --svg")?;
    let report = Report::new(options, measure(options)?);
    results.show(&report)?;
    if let Some(svg) = svg {
        svg.write(&picture::draw(&report))?;
    }
    Ok(report.verdict())
}

/// Measures all sets, on all processors of the host.
fn measure(options: &Options) -> anyhow::Result<Vec<SetResult>> {
    let progress = output::progress(options.sets, "message sets");
    let next = AtomicU64::new(0);
    let work = || {
        let mut results = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= options.sets {
                return Ok(results);
            }
            results.push(measure_set(options, options.seed.wrapping_add(number))?);
            progress.inc(1);
        }
    };
    let workers = std::thread::available_parallelism().map_or(1, NonZero::get);
    let results: anyhow::Result<Vec<Vec<SetResult>>> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let joined = workers.into_iter().map(|worker| worker.join());
        joined.map(|worker| worker.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    progress.finish_and_clear();
    let mut results = results?.concat();
    results.sort_by_key(|result| result.seed);
    Ok(results)
}

fn measure_set(options: &Options, seed: u64) -> anyhow::Result<SetResult> {
    let set = MessageSet::draw(&options.shape, seed)?;
    let end = Instant::from_epoch(Duration::from_ticks((options.seconds * 1e9) as u64));
    let breakdown = POLICIES.map(|policy| breakdown(&set, policy, end));
    Ok(SetResult { seed, messages: set.messages.len(), breakdown })
}

/// The largest load before the first deadline is missed, as the load grows in small steps.
///
/// To save time the steps are large until the first miss, and small from the large step before it on. A full
/// bus is the end, too, though a miss may take longer than a run.
fn breakdown(set: &MessageSet, policy: Policy, end: Instant) -> Breakdown {
    let run_at = |step: u32| (f64::from(step) * STEP, at_load(set, policy, f64::from(step) * STEP, end));
    let holds = |(_, run): &(f64, Run)| run.all_met && run.utilisation <= 1.0;
    let first = if holds(&run_at(FIRST)) { FIRST } else { 0 };
    let ended = (first..=LAST).step_by(COARSE as usize).skip(1).find(|step| !holds(&run_at(*step)));
    let from = ended.map_or(LAST, |ended| ended - COARSE).max(1);
    let last = (from..=ended.unwrap_or(LAST)).map(run_at).take_while(holds).last();
    last.map_or(Breakdown::default(), |(load, run)| Breakdown { load, on_the_wire: run.utilisation })
}

/// A run with all messages released at once, then one with random offsets.
fn at_load(set: &MessageSet, policy: Policy, load: f64, end: Instant) -> Run {
    let timings = set.timings(load);
    let synchronous = Releases::new(timings.iter().map(|_| Instant::EPOCH));
    let first = run_once(set, policy, load, synchronous, end);
    if !first.all_met {
        return first;
    }
    let offsets = Releases::new(timings.iter().map(|timing| Instant::from_epoch(timing.offset)));
    let second = run_once(set, policy, load, offsets, end);
    Run { utilisation: (first.utilisation + second.utilisation) / 2.0, ..second }
}

fn run_once(set: &MessageSet, policy: Policy, load: f64, releases: Releases, end: Instant) -> Run {
    match policy {
        Policy::Ideal => ideal::run(set, load, releases, end),
        policy => simulation::Simulation::new(set, policy, load).run(releases, end),
    }
}

/// When the messages are released.
struct Releases {
    /// The next release of each message: when, which message, the how manieth.
    next: BinaryHeap<Reverse<(Instant, usize, u64)>>,
}

impl Releases {
    fn new(first: impl Iterator<Item = Instant>) -> Self {
        Self { next: first.enumerate().map(|(message, at)| Reverse((at, message, 0))).collect() }
    }

    fn next_at(&self) -> Instant {
        self.next.peek().map_or(Instant::FAR_FUTURE, |Reverse((at, ..))| *at)
    }

    /// The next release that is due: of which message, the how manieth, and when.
    fn pop(&mut self, now: Instant, timings: &[Timing]) -> Option<(usize, u64, Instant)> {
        let mut first = self.next.peek_mut()?;
        let Reverse((at, message, count)) = *first;
        if at > now {
            return None;
        }
        *first = Reverse((at + timings[message].period, message, count + 1));
        Some((message, count, at))
    }
}

/// Loads are multiples of this.
const STEP: f64 = 0.0025;
/// The load that is tried first, 70 %, in steps.
const FIRST: u32 = 280;
/// The largest load, 102 % of frames of mean length, in steps.
const LAST: u32 = 408;
/// Steps in a large step: 2 %.
const COARSE: u32 = 8;
