//! The daemon.

use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use cosmic_gateway::config::Config;
use cosmic_gateway::service::{self, ServiceError};
use tracing_subscriber::EnvFilter;

/// Joins segments of CAN over IP, with deadlines kept.
///
/// The configuration says which segments, which channels, and how the others are reached: docs/gateway.md has an example.
/// It logs to standard error (RUST_LOG says how much), and ends in order on SIGTERM and SIGINT.
///
/// Exit code: 0 ended in order; 1 it could not go on; 2 the configuration is wrong.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// The configuration.
    config: PathBuf,
    /// Only reads the configuration, and says what is wrong with it.
    #[arg(long)]
    check: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info,zenoh=warn"));
    let format = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    format.with_target(false).with_ansi(std::io::stderr().is_terminal()).init();
    let config = match Config::read(&arguments.config) {
        Ok(config) => config,
        Err(problems) => {
            eprintln!("{problems}");
            return ExitCode::from(2);
        }
    };
    if arguments.check {
        let (segments, channels) = (config.segments.len(), config.channels.len());
        println!("{}: {segments} segments, {channels} channels", arguments.config.display());
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
            eprintln!("cosmic-gateway: {error}");
            ExitCode::FAILURE
        }
    }
}
