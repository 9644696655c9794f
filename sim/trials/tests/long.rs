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
        trial.seen.clear();
        trial.trace.clear();
    }
    assert_eq!(exceptions.len(), 3);
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
