//! Two segments that ran apart, each with a time of its own, are joined: one time rules, hard frames are silent rather than
//! wrong, and all take part again by themselves.

use cosmic_core::can::{Etag, Priority, TxNode};
use cosmic_core::protocol::NodeState;
use cosmic_emu::NodeConfig;
use cosmic_trials::{Trial, ms};

/// By which both halves have settled, in milliseconds.
const JOINED: u64 = 3_000;
/// When the other half is switched on: its time, and the phase of its slots, is another one.
const OTHER_STARTS: u64 = 1_234;
const SYNC_PERIOD: u64 = 25;
/// From joining until a node of the half that gives way publishes in its slots again: until it has heard the other time,
/// and six periods without synchronisation (`cosmic_core::sync`), and one period of the calendar.
const RECOVERED: u64 = (1 + 6 + 1) * SYNC_PERIOD + 10;

/// When hard frames ended, from a millisecond on, in nanoseconds.
fn hard(trial: &Trial, from: u64) -> Vec<u64> {
    let hard = trial.frames_at(from).filter(|(_, frame)| frame.id.priority() == Priority::HARD);
    hard.map(|(at, _)| at.as_ticks()).collect()
}

/// How far two instants are apart in the cycle of the calendar, in nanoseconds.
fn apart(one: u64, other: u64) -> u64 {
    let difference = one.abs_diff(other) % PERIOD;
    difference.min(PERIOD - difference)
}

const PERIOD: u64 = 10_000_000;
/// Twice the accuracy of clocks and the jitter of releases, by the plan.
const IN_ITS_SLOT: u64 = 2 * (50_000 + 20_000);

fn later(config: &mut NodeConfig) {
    config.start_at = ms(OTHER_STARTS) + config.start_at.duration_since_epoch();
    config.unique_id[0] = 0;
}

/// Who rules where the worker is, and where it is not.
fn join(with_worker: &'static str, other: &'static str) -> Trial {
    let mut trial = Trial::new(&[(other, 0), ("guest", 0)]);
    let mut half = Trial::with(&[(with_worker, 0), ("worker", 0)], later);
    trial.run_until(JOINED);
    half.run_until(JOINED);
    for half in [&trial, &half] {
        assert_eq!(half.oddities(), Vec::<String>::new());
    }
    let before = hard(&half, JOINED - 1_000);
    assert!((99..=101).contains(&before.len()), "{} beats before", before.len());
    trial.join(half);
    trial.run_until(JOINED + 3_000);
    assert_eq!(trial.oddities(), Vec::<String>::new());

    let after = hard(&trial, JOINED);
    let (old, new) = (before[0], *after.last().expect("it beats again"));
    let moves = other == "master";
    assert_eq!(
        apart(old, new) > IN_ITS_SLOT,
        moves,
        "the worker's slots are where the master's time has them"
    );
    assert!(
        after.iter().all(|at| apart(*at, old) <= IN_ITS_SLOT || apart(*at, new) <= IN_ITS_SLOT),
        "{after:?}"
    );
    all_are_well(&trial);
    trial
}

/// In the last second all nodes are operational, each slot is used, and the guest's events come.
fn all_are_well(trial: &Trial) {
    let end = JOINED + 3_000;
    let states: Vec<_> =
        trial.statuses(end - 1_100).map(|(_, status)| (status.tx_node, status.state)).collect();
    assert!(states.iter().all(|(_, state)| *state == NodeState::Operational), "{states:?}");
    let nodes: std::collections::BTreeSet<_> = states.iter().map(|(node, _)| *node).collect();
    assert_eq!(nodes.len(), 4, "{states:?}");
    let beats = hard(trial, end - 1_000).len();
    let counts = trial.frames(end - 1_000).filter(|(_, frame)| frame.id.etag() == Etag::BOUND_LAST).count();
    assert!((99..=101).contains(&beats) && (98..=102).contains(&counts), "{beats}, {counts}");
    let senders: std::collections::BTreeSet<_> = trial
        .frames(end - 1_000)
        .filter(|(_, frame)| frame.id.etag() == Etag::SYNC)
        .map(|(_, frame)| frame.id.tx_node())
        .collect();
    assert_eq!(senders, [TxNode::new(1).unwrap()].into(), "one time rules: the master's");
}

#[test]
fn a_half_that_gives_way_is_silent_until_it_has_the_other_time() {
    let trial = join("deputy", "master");
    let after = hard(&trial, JOINED);
    let new = *after.last().unwrap();
    let old: Vec<_> = after.iter().filter(|at| apart(**at, new) > IN_ITS_SLOT).collect();
    // Nobody can know before the first sync of the other has come.
    let joined = JOINED * 1_000_000;
    assert!(old.iter().all(|at| **at <= joined + (SYNC_PERIOD + 10) * 1_000_000), "{old:?}");
    let first = after.iter().find(|at| apart(**at, new) <= IN_ITS_SLOT).unwrap();
    let recovered = (first - joined) / 1_000_000;
    println!("{} hard frames in the old time, then none until {recovered} ms after joining", old.len());
    assert!(recovered <= RECOVERED, "{recovered} ms");
    assert!(trial.said("worker", "ClockOutOfBound", JOINED), "{:#?}", trial.log("worker", JOINED));
}

#[test]
fn a_half_whose_time_stays_is_not_disturbed() {
    let trial = join("master", "deputy");
    let after = hard(&trial, JOINED);
    assert!(
        after.windows(2).all(|two| apart(two[0], two[1]) <= IN_ITS_SLOT && two[1] - two[0] < 2 * PERIOD),
        "{after:?}"
    );
    assert!(
        !trial.log("worker", JOINED).iter().any(|(_, line)| line.starts_with("WARN")),
        "{:#?}",
        trial.log("worker", JOINED)
    );
}
