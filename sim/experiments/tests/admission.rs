//! `experiment admission`, as a user calls it. `COSMIC_RUNS=n` runs so many sequences.

use serde_json::Value;
use std::process::{Command, Output};

fn experiment(arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiment"));
    command.arg("admission").args(arguments.split_whitespace()).output().unwrap()
}

fn results(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)))
}

#[test]
fn over_a_thousand_sequences_nothing_admitted_is_late_and_nearly_all_that_fits_is_admitted() {
    let runs = std::env::var("COSMIC_RUNS").unwrap_or_else(|_| "1000".to_owned());
    let output = experiment(&format!("--sequences {runs} --json -"));
    let found = results(&output);
    assert!(output.status.success(), "{found}\n{}", String::from_utf8_lossy(&output.stderr));
    let count = |name: &str| found[name].as_u64().unwrap();
    for none in [
        "events_late",
        "events_refused",
        "lost_in_fail_overs",
        "admitted_against_the_exact_test",
        "unanswered",
    ] {
        assert_eq!(count(none), 0, "{none}: {found}");
    }
    let runs: u64 = runs.parse().unwrap();
    assert!(found["false_refusals"].as_f64().unwrap() < 0.1, "{found}");
    // There was something to be judged, and to be refused.
    assert!(count("events_sent") > 1_000 * runs && count("fail_overs") > runs / 10, "{found}");
    assert!(count("asked") > count("acceptable_to_the_exact_test") + runs / 2, "{found}");
}

/// The judge sees what is late.
#[test]
fn without_asking_events_are_late() {
    let output = experiment("--sequences 20 --unasked --json -");
    assert_eq!(output.status.code(), Some(1));
    assert!(results(&output)["events_late"].as_u64().unwrap() > 100, "{}", results(&output));
}

#[test]
fn results_are_repeated_by_the_seed_and_printed() {
    let line = "--sequences 3 --seed 17";
    let (one, other) = (experiment(line), experiment(line));
    assert!(one.status.success() && one.stdout == other.stdout);
    assert!(String::from_utf8(one.stdout).unwrap().starts_with("3 sequences from seed 17: "));
    let output = experiment("--sequences 0");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8(output.stderr).unwrap().contains("from 1 to 1000000"));
}
