//! `experiment edf`, as a user calls it.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn experiment(arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiment"));
    command.arg("edf").args(arguments.split_whitespace()).output().unwrap()
}

/// The results as JSON; the experiment must have succeeded.
fn results(arguments: &str) -> Value {
    let output = experiment(&format!("{arguments} --json -"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

const IDEAL: usize = 0;
const MAPPED: usize = 1;
const FIXED: usize = 2;
const COARSELY_MAPPED: usize = 3;

fn mean(results: &Value, policy: usize) -> f64 {
    results["policies"][policy]["mean"].as_f64().unwrap()
}

#[test]
fn the_mapping_breaks_above_95_percent_and_fixed_priorities_below_93() {
    let results = results("--sets 3 --seconds 0.5");
    assert_eq!(results["sets"].as_array().unwrap().len(), 3);
    assert!(mean(&results, MAPPED) > 0.95, "{results}");
    assert!(mean(&results, MAPPED) <= mean(&results, IDEAL) + 0.005, "{results}");
    let fixed = mean(&results, FIXED);
    assert!(fixed > 0.85 && fixed < 0.93, "{results}");
}

#[test]
fn a_coarse_mapping_loses_where_deadlines_are_short() {
    let tight = "--shortest-period 1 --longest-period 10 --lengths mixed --deadlines drawn";
    let results = results(&format!("{tight} --sets 6 --seconds 0.5"));
    assert!(mean(&results, MAPPED) > 0.95, "{results}");
    assert!(mean(&results, COARSELY_MAPPED) < mean(&results, MAPPED) - 0.01, "{results}");
    assert!(mean(&results, FIXED) < 0.90, "{results}");
}

/// On one node the queue is in order of deadlines, and the mapping takes no part in it. So the bus must carry
/// the very frames at the very instants that the oracle works out without a bus.
#[test]
fn one_node_is_ideal() {
    let results = results("--nodes 1 --sets 2 --seconds 0.5");
    for set in results["sets"].as_array().unwrap() {
        assert_eq!(set["breakdown"][MAPPED], set["breakdown"][IDEAL]);
    }
}

#[test]
fn the_seed_decides() {
    let run =
        |seed: u8| results(&format!("--sets 1 --seconds 0.1 --seed {seed}"))["sets"][0]["breakdown"].clone();
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
}

#[test]
fn the_picture_has_a_curve_for_each_policy() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("edf.svg");
    let output = experiment(&format!("--sets 1 --seconds 0.1 --svg {}", path.display()));
    assert!(output.status.success());
    assert!(String::from_utf8(output.stdout).unwrap().contains("fixed priorities"));
    let picture = std::fs::read_to_string(path).unwrap();
    assert_eq!(picture.matches("<polyline").count(), 4);
}

#[test]
fn files_are_tried_before_the_work() {
    // The work would fail, too.
    let work = "--shortest-period 900 --longest-period 1000";
    for option in ["--json", "--svg"] {
        let output = experiment(&format!("{work} {option} /nowhere/at/all"));
        assert_eq!(output.status.code(), Some(1));
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.starts_with("error: /nowhere/at/all: cannot be written"), "{message}");
        assert!(message.contains(&format!("another file with {option}")), "{message}");
    }
}

#[test]
fn wrong_arguments_are_refused_with_a_remedy() {
    for (arguments, code, remedy) in [
        ("--sets 0", 2, "from 1 to 100000"),
        ("--nodes 101", 2, "from 1 to 100"),
        ("--shortest-period 20 --longest-period 10", 2, "is longer than --longest-period"),
        ("--shortest-period NaN", 2, "must be from 1 to 10000"),
        ("--shortest-period 900 --longest-period 1000", 1, "choose a smaller --longest-period"),
        ("--seconds=-1", 2, "must be from 0.01 to 1000"),
        ("--seconds -1", 2, "must be from 0.01 to 1000"),
        ("--sets -1", 2, "from 1 to 100000"),
    ] {
        let output = experiment(arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments}");
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.contains(remedy), "{arguments}: {message}");
    }
}
