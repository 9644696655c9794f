//! The gateway as a program: `cosmic gateway`, and `cosmic-gateway`, the same for machines without tools.

use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;

use tracing_subscriber::EnvFilter;

use crate::config::Config;
use crate::service::{self, ServiceError};

/// What it is called with.
#[derive(clap::Args, Clone, Debug)]
pub struct Options {
    /// The configuration.
    config: PathBuf,
    /// Only reads the configuration, and says what is wrong with it.
    #[arg(long)]
    check: bool,
}

/// Runs a gateway to its end, in a runtime of its own. It logs to standard error. `name` is that of the program.
pub fn run(options: &Options, name: &str) -> ExitCode {
    log();
    let config = match Config::read(&options.config) {
        Ok(config) => config,
        Err(problems) => {
            eprintln!("{problems}");
            return ExitCode::from(WRONG);
        }
    };
    if options.check {
        let (segments, channels) = (config.segments.len(), config.channels.len());
        println!("{}: {segments} segments, {channels} channels", options.config.display());
        return ExitCode::SUCCESS;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let ended = match runtime {
        Ok(runtime) => runtime.block_on(service::run(&config)),
        Err(error) => Err(ServiceError::new(format!("no threads: {error}"))),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{name}: {error}");
            ExitCode::from(CANNOT)
        }
    }
}

fn log() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info,zenoh=warn"));
    let format = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    format.with_target(false).with_ansi(std::io::stderr().is_terminal()).init();
}

/// The configuration is wrong.
const WRONG: u8 = 2;
/// A segment or the network cannot be taken part in, or no longer.
const CANNOT: u8 = 3;
