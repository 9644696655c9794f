//! The daemon. Whoever has the command `cosmic` has it as `cosmic gateway`.

use std::process::ExitCode;

use clap::Parser;
use cosmic_gateway::program;

/// Joins segments of CAN over IP, with deadlines kept.
///
/// The configuration says which segments, which channels, and how the others are reached: docs/gateway.md has an example.
/// It logs to standard error (RUST_LOG says how much), and ends in order on SIGTERM and SIGINT.
///
/// Exit code: 0 ended in order; 2 the configuration is wrong; 3 it cannot run, or not go on.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(flatten)]
    all: program::Options,
}

fn main() -> ExitCode {
    program::run(&Arguments::parse().all, "cosmic-gateway")
}
