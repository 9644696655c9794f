//! Counts what passed and what failed.

use std::process::ExitCode;

use anyhow::Result;

/// What some tests came to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Tally {
    /// Tests that passed.
    pub(crate) passed: usize,
    /// Tests that failed, and steps that could not be carried out.
    pub(crate) failed: usize,
}

impl Tally {
    /// Of one test.
    pub(crate) fn one(passed: bool) -> Self {
        Self { passed: usize::from(passed), failed: usize::from(!passed) }
    }

    /// Adds the outcome of a step; an error counts as one failure, and is shown.
    pub(crate) fn add(&mut self, outcome: Result<Self>) {
        match outcome {
            Ok(other) => {
                self.passed += other.passed;
                self.failed += other.failed;
            }
            Err(error) => {
                eprintln!("error: {error:#}");
                self.failed += 1;
            }
        }
    }

    /// The line that tools read, and the exit code.
    pub(crate) fn conclude(self) -> ExitCode {
        println!("{} passed, {} failed", self.passed, self.failed);
        if self.failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;

    #[test]
    fn steps_that_break_count_as_failed() {
        let mut tally = Tally { passed: 2, failed: 0 };
        tally.add(Ok(Tally { passed: 1, failed: 1 }));
        tally.add(Err(anyhow!("this message belongs to a test")));
        assert_eq!(tally, Tally { passed: 3, failed: 2 });
    }
}
