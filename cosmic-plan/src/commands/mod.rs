//! The command line.

mod build;
mod check;
mod new;
mod support;

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Plans the calendar of a COSMIC segment and proves the timing of everything on it.
///
/// Exit code 0: all holds. 1: something does not hold (no calendar, or a bound beyond its deadline).
/// 2: the input or the command line is wrong.
#[derive(Parser, Debug)]
#[command(version)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Writes a commented example that passes.
    New {
        /// The file to write; it must not exist.
        #[arg(default_value = "cluster.toml")]
        file: PathBuf,
    },
    /// Says whether everything on the segment holds.
    Check {
        /// The cluster file.
        file: PathBuf,
        /// For machines.
        #[arg(long)]
        json: bool,
    },
    /// Writes what the firmware and other tools need: calendar.rs, report.json, report.txt, timeline.svg
    /// and segment.dbc.
    Build {
        /// The cluster file.
        file: PathBuf,
        /// The folder to write into; it is made if it does not exist.
        #[arg(long, default_value = "plan-out")]
        out: PathBuf,
        /// For machines: which files were written.
        #[arg(long)]
        json: bool,
    },
    /// Prints the JSON schema of cluster files, for editors.
    Schema,
}

/// Runs a command.
pub(crate) fn run(arguments: Arguments) -> ExitCode {
    let result = match arguments.command {
        Command::New { file } => new::run(&file),
        Command::Check { file, json } => check::run(&file, json),
        Command::Build { file, out, json } => build::run(&file, &out, json),
        Command::Schema => {
            support::print_json(&cosmic_plan::cluster::format::schema());
            Ok(ExitCode::SUCCESS)
        }
    };
    result.unwrap_or_else(|failure| failure.report())
}
