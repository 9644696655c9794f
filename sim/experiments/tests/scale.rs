//! `experiment scale`, as a user calls it. How fast it is, is no matter of a test.

use serde_json::Value;
use std::process::{Command, Output};

fn experiment(arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiment"));
    command.arg("scale").args(arguments.split_whitespace()).output().unwrap()
}

#[test]
fn a_hundred_nodes_saturate_the_bus_in_all_classes() {
    for services in ["clock", "all"] {
        let output = experiment(&format!("--seconds 2 --services {services} --json -"));
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let results: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(results["bus_load"].as_f64().unwrap() > 0.99, "{results}");
        let frames = &results["frames_per_virtual_second"];
        // Ten slots every ten milliseconds; none is missed. A frame may end in the next second.
        assert!((frames["hard"].as_f64().unwrap() - 1_000.0).abs() <= 1.0, "{results}");
        assert!(frames["soft"].as_f64().unwrap() > 4_900.0, "{results}");
        assert!(frames["non_real_time"].as_f64().unwrap() > 500.0, "{results}");
        // Three subscribers for each soft event, ten for each hard one.
        assert!(results["events_per_virtual_second"].as_f64().unwrap() > 24_000.0, "{results}");
    }
}

#[test]
fn the_least_speed_decides_the_exit_code() {
    assert!(experiment("--nodes 10 --seconds 1 --at-least 0.000001").status.success());
    let output = experiment("--nodes 10 --seconds 1 --at-least 1e12");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8(output.stderr).unwrap().contains("are fewer than 1000000000000"));
}

#[test]
fn the_file_is_tried_before_the_work() {
    let output = experiment("--nodes 10 --seconds 1 --json /nowhere/at/all");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8(output.stderr).unwrap().starts_with("error: /nowhere/at/all: cannot be"));
    assert!(output.stdout.is_empty());
}

#[test]
fn wrong_arguments_are_refused_with_a_remedy() {
    for (arguments, remedy) in [
        ("--nodes 9", "from 10 to 127"),
        ("--nodes 128", "from 10 to 127"),
        ("--seconds 0", "from 1 to 100000"),
        ("--services none", "clock, all"),
    ] {
        let output = experiment(arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments}: {message}");
        assert!(message.contains(remedy), "{arguments}: {message}");
    }
}
