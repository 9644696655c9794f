//! Runs an experiment: on the simulated bus, or with the gateway.

use std::ffi::OsString;
use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};
use clap::Args;
use cosmic_commands::experiment::Arguments;
use cosmic_commands::gateway;

use crate::run::{self, step};
use crate::workspace::Workspace;

/// What an experiment is called with.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Options {
    /// Name and options of the experiment: `cargo xtask experiment --help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<String>,
}

/// Builds and runs it. Its exit code is ours.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<ExitCode> {
    let (read, package, program, arguments) = match options.arguments.split_first() {
        // A program of its own: only it needs zenoh.
        Some((first, rest)) if first == GATEWAY => {
            (gateway::Options::read(rest).map(|_| ()), "cosmic-gateway-bench", "gateway-bench", rest)
        }
        _ => {
            let all = &*options.arguments;
            let read = Arguments::read(all.iter().map(OsString::from)).map(|_| ());
            (read, "cosmic-experiments", "experiment", all)
        }
    };
    // Before anything is built.
    if let Err(refusal) = read {
        refusal.print().context("writing to the terminal")?;
        return Ok(ExitCode::from(u8::try_from(refusal.exit_code()).unwrap_or(1)));
    }
    let mut build = workspace.cargo();
    build.args(["build", "--release", "--package", package, "--bin", program]);
    step("building the experiments", || run::run(&mut build))?;
    // Not by `cargo run`, which would move it to the root of the repository: the files that it is to
    // write are named from where the user is.
    let mut experiments = Command::new(workspace.program("release", program));
    run::code(experiments.args(arguments)).map(ExitCode::from)
}

const GATEWAY: &str = "gateway";

#[cfg(test)]
mod tests {
    use super::*;

    /// This workspace has nothing that could be built.
    #[test]
    fn wrong_options_are_refused_before_anything_is_built() {
        let workspace = Workspace::at("/nowhere/at/all");
        let given = |line: &str| Options { arguments: line.split_whitespace().map(str::to_owned).collect() };
        for line in [
            "",
            "edd",
            "edf --sets -1",
            "edf --seconds nan",
            "clock --seconds 1e-9",
            "scale --load 3",
            "gateway --rate 0",
        ] {
            assert_eq!(task(&workspace, &given(line)).unwrap(), ExitCode::from(2), "{line}");
        }
        for line in ["edf --help", "gateway --help"] {
            assert_eq!(task(&workspace, &given(line)).unwrap(), ExitCode::SUCCESS, "{line}");
        }
    }
}
