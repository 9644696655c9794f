//! Experiments on the bit-accurate bus, each with the core's own code: `experiment --help`.
//!
//! An experiment prints a figure and the conditions under which it was measured. Everything follows from
//! the seed, but for the speed of the host. `docs/experiments.md` explains them and shows the results.

mod clock;
mod edf;
mod nodes;
mod output;
mod random;
mod scale;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use std::process::ExitCode;

/// Measure what COSMIC promises, on a simulated CAN bus.
///
/// Exit code: 0 if the promise holds, 1 if it does not or the experiment could not be done, 2 for wrong
/// arguments.
#[derive(Parser)]
#[command(name = "experiment", max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    experiment: Experiment,
}

impl Arguments {
    /// From the command line; what is wrong with it ends the program. A number below zero is no option, so that
    /// its bounds are named.
    fn read() -> Self {
        let numbers = |it: clap::Command| it.mut_args(|argument| argument.allow_negative_numbers(true));
        let matches = Self::command().mut_subcommands(numbers).get_matches();
        Self::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
    }
}

#[derive(Subcommand)]
enum Experiment {
    /// How far the bus can be loaded until the first deadline is missed: EDF against fixed priorities.
    Edf(edf::Options),
    /// How far clocks are from the master, and whether they know it.
    Clock(clock::Options),
    /// How fast a large cluster on a saturated bus is simulated.
    Scale(scale::Options),
}

fn main() -> ExitCode {
    let result = match &Arguments::read().experiment {
        Experiment::Edf(options) => edf::run(options),
        Experiment::Clock(options) => clock::run(options),
        Experiment::Scale(options) => scale::run(options),
    };
    match result {
        Ok(output::Conclusion::Holds) => ExitCode::SUCCESS,
        Ok(output::Conclusion::Fails(reason)) => {
            eprintln!("failed: {reason}");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }
}
