//! Runs `cargo test` and counts.

use std::process::Command;

use anyhow::Result;

use crate::run;
use crate::tally::Tally;

/// Runs `cargo test` and counts its results.
pub(crate) fn cargo_test(command: &mut Command) -> Result<Tally> {
    let mut tally = Tally::default();
    let status = run::lines(command, |line| {
        println!("{line}");
        if let Some((passed, failed)) = result_line(line) {
            tally.passed += passed;
            tally.failed += failed;
        }
    })?;
    // Tests that do not compile, or end by a signal, print no result.
    if !status.success() && tally.failed == 0 {
        tally.failed = 1;
    }
    Ok(tally)
}

/// The counts of a line such as `test result: ok. 7 passed; 0 failed; 0 ignored; ...`.
fn result_line(line: &str) -> Option<(usize, usize)> {
    let (_, counts) = line.strip_prefix("test result: ")?.split_once(". ")?;
    let mut counts = counts.split("; ");
    let passed = counts.next()?.strip_suffix(" passed")?.parse().ok()?;
    let failed = counts.next()?.strip_suffix(" failed")?.parse().ok()?;
    Some((passed, failed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_cargo_are_counted() {
        let good = "test result: ok. 7 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out";
        assert_eq!(result_line(good), Some((7, 0)));
        let bad = "test result: FAILED. 1 passed; 2 failed; 0 ignored; 0 measured";
        assert_eq!(result_line(bad), Some((1, 2)));
        assert_eq!(result_line("running 7 tests"), None);
        assert_eq!(result_line("test result: strange"), None);
    }

    #[test]
    fn a_failure_without_a_result_counts() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo 'test result: ok. 3 passed; 0 failed; 0 ignored'; exit 101"]);
        let tally = cargo_test(&mut command).unwrap();
        assert_eq!(tally, Tally { passed: 3, failed: 1 });
    }
}
