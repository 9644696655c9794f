//! A cluster that runs for long, on clocks that drift apart: each slot is used, nothing is told of, and no state grows.

use std::collections::BTreeMap;

use cosmic_core::can::{Etag, Priority};
use cosmic_core::protocol::NodeState;
use cosmic_emu::{ClockError, NodeConfig};
use cosmic_trials::Trial;

/// By which all is settled, in seconds.
const SETTLED: u64 = 2;
/// Looked at as a whole.
const SPAN: u64 = 10;
/// By which the cycles that a node is awake in a span differ from those of the first, of 10 000. What comes together with
/// what changes as the clocks drift: up to 1 110 were seen, for 30 s of each 500 s, in which the guest's clock drifts by a
/// period.
const WORK_DIFFERS: u64 = 1_500;
/// The same for the worker, which mostly follows the calendar: up to 60 were seen. If its interrupt goes the long way, as it
/// once did from the first turn of the timer on, it is 112 in the span of that turn.
const CALENDAR_DIFFERS: u64 = 80;

fn drifts(config: &mut NodeConfig) {
    let parts = match config.name.as_str() {
        "master" => 20,
        "worker" => -25,
        _ => 0,
    };
    config.clock_error = ClockError::parts_per_million(parts).unwrap();
}

fn runs_for(seconds: u64) {
    let nodes = [("master", 0), ("worker", 0), ("guest", 0)];
    let mut trial = Trial::with(&nodes, drifts);
    trial.run_until(1000 * SETTLED);
    trial.seen.clear();
    trial.trace.clear();
    let mut exceptions = BTreeMap::new();
    let mut awake = Awake::new(&trial);
    for span in 0..seconds / SPAN {
        let from = SETTLED + span * SPAN;
        trial.run_until(1000 * (from + SPAN));
        let of =
            |is_it: fn(&cosmic_core::can::Frame) -> bool| trial.frames(0).filter(|(_, it)| is_it(it)).count();
        let beats = of(|frame| frame.id.priority() == Priority::HARD);
        let counts = of(|frame| frame.id.etag() == Etag::BOUND_LAST);
        assert!(
            (998..=1002).contains(&beats) && (998..=1002).contains(&counts),
            "{from} s: {beats}, {counts}"
        );
        assert_eq!(trial.oddities(), Vec::<String>::new(), "{from} s");
        for (name, _) in &trial.nodes {
            assert_eq!(trial.resets(name), [], "{from} s: {name}");
            let warned: Vec<_> =
                trial.log(name, 0).into_iter().filter(|(_, line)| line.starts_with("WARN")).collect();
            assert_eq!(warned, [], "{from} s: {name}");
        }
        for (at, status) in trial.statuses(0) {
            assert_eq!(status.state, NodeState::Operational, "{at} ms: {status:?}");
            let before = *exceptions.entry(status.tx_node).or_insert(status.exceptions);
            assert_eq!(status.exceptions, before, "{at} ms: {status:?}");
            assert!(status.uptime.duration().as_secs().abs_diff(at / 1000) <= 1, "{at} ms: {status:?}");
        }
        awake.looks_at_span(&trial, from);
        trial.seen.clear();
        trial.trace.clear();
    }
    assert_eq!(exceptions.len(), 3);
}

/// The cycles that each node was awake, by which its work shows.
struct Awake {
    /// Up to the last span.
    before: Vec<u64>,
    /// In the first span.
    first: Option<Vec<u64>>,
}

impl Awake {
    fn new(trial: &Trial) -> Self {
        Self { before: Self::until_now(trial), first: None }
    }

    fn until_now(trial: &Trial) -> Vec<u64> {
        trial.nodes.iter().map(|(_, node)| trial.cluster.awake(*node)).collect()
    }

    /// Each span takes as much work as the first, to within these bounds.
    fn looks_at_span(&mut self, trial: &Trial, from: u64) {
        let now = Self::until_now(trial);
        let span: Vec<_> = now.iter().zip(&self.before).map(|(now, before)| now - before).collect();
        let first = self.first.get_or_insert_with(|| span.clone());
        for ((name, _), (span, first)) in trial.nodes.iter().zip(span.iter().zip(first)) {
            let differs = 10_000 * span.abs_diff(*first) / *first;
            let bound = if *name == "worker" { CALENDAR_DIFFERS } else { WORK_DIFFERS };
            assert!(differs <= bound, "{from} s: {name} was awake {span} cycles, first {first}");
        }
        self.before = now;
    }
}

#[test]
fn twenty_seconds() {
    runs_for(20);
}

/// Local time is counted by a timer of 32 bits at 4 MHz, which starts anew after 17.9 minutes.
#[test]
#[ignore = "takes minutes: cargo test --release -p cosmic-trials --test long -- --ignored"]
fn the_timer_starts_anew() {
    runs_for(18 * 60);
}

#[test]
#[ignore = "takes many minutes: cargo test --release -p cosmic-trials --test long -- --ignored"]
fn an_hour() {
    runs_for(3600);
}
