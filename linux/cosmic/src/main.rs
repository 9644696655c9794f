//! The `cosmic` command: watch, record and examine a COSMIC segment.
//!
//! What a segment's frames mean is the business of `cosmic-monitor`, how they come here that of `cosmic-linux`; this
//! program reads options, prints, draws and writes logs.
#![forbid(unsafe_code)]

mod arguments;
mod choice;
mod commands;
mod context;
mod distances;
mod failure;
#[cfg(feature = "ip")]
mod ip;
mod output;
mod source;
mod top;
mod words;

use std::process::ExitCode;

use clap::Parser as _;

use arguments::Arguments;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    #[cfg(feature = "ip")]
    if let arguments::Command::Gateway(gateway) = &arguments.command {
        return cosmic_gateway::program::run(gateway, "cosmic");
    }
    let mut builder = match arguments.common.link {
        // zenoh needs threads.
        Some(choice::Choice::Ip(_)) => tokio::runtime::Builder::new_multi_thread(),
        _ => tokio::runtime::Builder::new_current_thread(),
    };
    let runtime = match builder.enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            eprintln!("cosmic: no runtime: {error}; allow this program more open files");
            return ExitCode::from(3);
        }
    };
    let ended = runtime.block_on(commands::run(arguments));
    // What a link still waits for need not hold up the end.
    runtime.shutdown_background();
    ended.unwrap_or_else(failure::Failure::report)
}
