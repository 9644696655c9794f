//! Runs the workshop's images on the emulated cluster, judges what happened, and shows it. `cargo xtask demo` starts it
//! behind the demo.
//!
//! Exit code 0: all as promised. 1: not. 2: it could not be run.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use cosmic_demo::cluster;
use cosmic_demo::workshop::{self, Summary};

/// Run a cluster that configures itself, and judge it
#[derive(Parser)]
#[command(name = "workshop")]
struct Options {
    /// The description of the cluster
    #[arg(long, value_name = "FILE")]
    cluster: PathBuf,
    /// Its images, each with the name of its node
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
}

fn main() -> ExitCode {
    match demonstrate(&Options::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(NOT_AS_PROMISED),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(NOT_RUN)
        }
    }
}

fn demonstrate(options: &Options) -> Result<bool, Box<dyn core::error::Error>> {
    let description = cluster::description(&options.cluster)?;
    let summary = Summary::of(&description, &workshop::run(&description, &options.images)?);
    print!("{summary}");
    Ok(summary.passed())
}

const NOT_AS_PROMISED: u8 = 1;
const NOT_RUN: u8 = 2;
