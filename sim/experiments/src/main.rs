//! Experiments on the bit-accurate bus, each with the core's own code: `experiment --help`.
//!
//! An experiment prints a figure and the conditions under which it was measured. Everything follows from
//! the seed, but for the speed of the host. `docs/experiments.md` explains them and shows the results.

mod admission;
mod clock;
mod edf;
mod nodes;
mod output;
mod random;
mod scale;

use cosmic_commands::experiment::{Arguments, Experiment};
use std::env;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = Arguments::read(env::args_os().skip(1)).unwrap_or_else(|error| error.exit());
    let result = match &arguments.experiment {
        Experiment::Edf(options) => edf::run(options),
        Experiment::Clock(options) => clock::run(options),
        Experiment::Scale(options) => scale::run(options),
        Experiment::Admission(options) => admission::run(options),
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
