//! `cosmic-plan`: from a description of the cluster to a proven calendar.

use clap::Parser;
use std::process::ExitCode;

mod commands;

fn main() -> ExitCode {
    commands::run(commands::Arguments::parse())
}
