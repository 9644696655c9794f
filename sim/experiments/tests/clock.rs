//! `experiment clock`, as a user calls it.

use serde_json::Value;
use std::process::{Command, Output};

fn experiment(arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiment"));
    command.arg("clock").args(arguments.split_whitespace()).output().unwrap()
}

/// What was seen at each load; the bound must never have been exceeded.
fn loads(arguments: &str) -> Vec<Value> {
    let output = experiment(&format!("{arguments} --json -"));
    assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    let loads = results["loads"].as_array().unwrap().clone();
    assert!(loads.iter().all(|load| load["exceeded"] == 0), "{results}");
    loads
}

#[test]
fn the_bound_is_never_exceeded_and_under_3_microseconds() {
    for seed in 1..=3 {
        let loads = loads(&format!("--seconds 30 --seed {seed}"));
        let bus_loads: Vec<f64> = loads.iter().map(|load| load["bus_load"].as_f64().unwrap()).collect();
        assert!(bus_loads[0] < 0.01 && bus_loads[1] > 0.45 && bus_loads[2] > 0.92, "{bus_loads:?}");
        for load in loads {
            let bound = load["bound_nanoseconds"]["greatest"].as_u64().unwrap();
            assert!(bound < 3_000, "{load}");
            // A bound that nothing ever comes near would be a poor one.
            let distance = load["distance_nanoseconds"]["greatest"].as_u64().unwrap();
            assert!(distance > bound / 3, "{load}");
            assert!(load["synchronised_after"].as_f64().unwrap() < 2.0, "{load}");
            assert!(load["samples"].as_u64().unwrap() > 100_000, "{load}");
        }
    }
}

#[test]
fn it_holds_for_other_drifts_and_periods_too() {
    for arguments in ["--drift 100", "--drift 0", "--period 20 --drift 100", "--period 500"] {
        loads(&format!("--seconds 25 --nodes 20 --load 80 {arguments}"));
    }
}

#[test]
fn wrong_arguments_are_refused_with_a_remedy() {
    for (arguments, code, remedy) in [
        ("--drift 201", 2, "from 0 to 200"),
        ("--drift -1", 2, "from 0 to 200"),
        ("--period 1000 --seconds 5 --json /nowhere/at/all", 1, "/nowhere/at/all: cannot be written"),
        ("--load 0,99", 2, "from 0 to 98"),
        ("--nodes 1", 2, "from 2 to 100"),
        ("--period 1000 --seconds 5", 1, "choose more"),
    ] {
        let output = experiment(arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments}: {message}");
        assert!(message.contains(remedy), "{arguments}: {message}");
    }
}
