//! The command line.

mod analyse;
mod build;
mod compare;
mod export;
mod report;
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
        /// For machines: the whole report as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Writes what the firmware and other tools need: calendar.rs, report.json, report.txt, timeline.svg, and all that
    /// `export` writes.
    Build {
        /// The cluster file.
        file: PathBuf,
        /// The folder to write into; it is made if it does not exist.
        #[arg(long, default_value = "plan-out")]
        out: PathBuf,
        /// For machines: the report, and which files were written.
        #[arg(long)]
        json: bool,
    },
    /// Prints the calendar, every bound, the load of the bus and how far channels could grow.
    Report {
        /// The cluster file.
        file: PathBuf,
        /// For machines.
        #[arg(long)]
        json: bool,
    },
    /// Draws the calendar as SVG.
    Render {
        /// The cluster file.
        file: PathBuf,
        /// The file to write.
        #[arg(long, default_value = "timeline.svg")]
        out: PathBuf,
    },
    /// Writes what other tools and languages need: a DBC file, a C header, a Python module, a dissector for Wireshark,
    /// and a page of HTML.
    Export {
        /// The cluster file.
        file: PathBuf,
        /// Only this.
        #[arg(long, value_enum)]
        format: Option<export::Format>,
        /// The folder to write into; with --format, the file.
        #[arg(long)]
        out: Option<PathBuf>,
    },
    /// Says why a channel's slot stands where it stands, and which terms make up its bound.
    Explain {
        /// The cluster file.
        file: PathBuf,
        /// The name of the channel.
        channel: String,
        /// For machines.
        #[arg(long)]
        json: bool,
    },
    /// Says what changed for whom between two cluster files.
    Diff {
        /// The cluster file before.
        before: PathBuf,
        /// The cluster file after.
        after: PathBuf,
        /// For machines.
        #[arg(long)]
        json: bool,
    },
    /// Computes worst-case response times of a plain set of messages (TOML or JSON).
    #[command(after_long_help = FORMAT)]
    Analyse {
        /// The set of messages.
        file: PathBuf,
        /// For machines: for each message the exact and the sufficient response time, blocking, jitter and
        /// verdict, in microseconds.
        #[arg(long)]
        json: bool,
    },
    /// Prints the JSON schema of cluster files, for editors.
    Schema,
}

const FORMAT: &str = r#"The set, in TOML; JSON has the same fields ({"bit_rate": .., "message": [{..}, ..]}):

  bit_rate = 125_000          # bits per second, or "125 kbit/s"
  time_unit = "ms"            # optional: then spans may be bare numbers; else write "2.5 ms"

  [errors]                    # optional; either of
  burst = 2                   #   so many faults at once, then one every interval
  interval = 10
  # count = 3                 #   at most so many faults in any window
  # window = 10

  [[message]]
  name = "A"                  # optional
  id = 0x10                   # without ids, the order of the file is that of priority
  extended = false            # optional; ids above 0x7FF are extended anyway
  length = 8                  # bytes of data; or:
  transmission_time = 1       # C itself, instead of length
  period = 2.5                # or least distance
  deadline = 2.5              # optional: the period
  jitter = 0                  # optional: 0

Exit code 0: every message meets its deadline (exact test). 1: some do not. 2: the file is wrong."#;

/// Runs a command.
pub(crate) fn run(arguments: Arguments) -> ExitCode {
    let result = match arguments.command {
        Command::New { file } => build::new(&file),
        Command::Check { file, json } => report::check(&file, json),
        Command::Build { file, out, json } => build::build(&file, &out, json),
        Command::Report { file, json } => report::report(&file, json),
        Command::Render { file, out } => build::render(&file, &out),
        Command::Export { file, format, out } => export::export(&file, format, out.as_deref()),
        Command::Explain { file, channel, json } => compare::explain(&file, &channel, json),
        Command::Diff { before, after, json } => compare::diff(&before, &after, json),
        Command::Analyse { file, json } => analyse::run(&file, json),
        Command::Schema => {
            support::print_json(&cosmic_plan::cluster::format::schema());
            Ok(ExitCode::SUCCESS)
        }
    };
    result.unwrap_or_else(|failure| failure.report())
}
