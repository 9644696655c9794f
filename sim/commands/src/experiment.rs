//! The options of the experiments.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum};
use serde::Serialize;

use crate::number::within;

/// Measure what COSMIC promises, on a simulated CAN bus.
///
/// Exit code: 0 if the promise holds, 1 if it does not or the experiment could not be done, 2 for wrong
/// arguments.
#[derive(Parser)]
#[command(name = "experiment", max_term_width = 100, after_help = OTHERS)]
pub struct Arguments {
    #[command(subcommand)]
    /// Which, and how.
    pub experiment: Experiment,
}

const OTHERS: &str = "\
`cargo xtask experiment gateway` measures the gateway, with a program of its own: see its --help.";

impl Arguments {
    /// Reads what a user wrote behind `cargo xtask experiment`, before anything is built.
    ///
    /// # Errors
    /// What clap says, or the help that was asked for.
    pub fn read(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        // A number below zero is no option, so that its bounds are named.
        let number = |argument: clap::Arg| {
            let takes_values = argument.get_action().takes_values();
            argument.allow_negative_numbers(takes_values)
        };
        let numbers = |it: clap::Command| it.mut_args(number);
        let words = [OsString::from("experiment")].into_iter().chain(arguments);
        let mut command = Self::command().mut_subcommands(numbers);
        let read = Self::from_arg_matches(&command.try_get_matches_from_mut(words)?)?;
        if let Experiment::Edf(Edf { shape, .. }) = &read.experiment
            && shape.shortest_period > shape.longest_period
        {
            let text = "--shortest-period is longer than --longest-period";
            return Err(command.error(ErrorKind::ValueValidation, text));
        }
        Ok(read)
    }
}

/// An experiment.
#[derive(Subcommand)]
pub enum Experiment {
    /// How far the bus can be loaded until the first deadline is missed: EDF against fixed priorities.
    Edf(Edf),
    /// How far clocks are from the master, and whether they know it.
    Clock(Clock),
    /// How fast a large cluster on a saturated bus is simulated.
    Scale(Scale),
    /// How long admission at run time takes, whether what is admitted is ever late, and what is refused needlessly.
    Admission(Admission),
}

/// What `experiment edf` is told.
#[derive(Args, Serialize)]
pub struct Edf {
    /// How many random message sets.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = within(1..=100_000_u64))]
    pub sets: u64,
    /// The seed of the first set; each further set has the next.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    #[expect(missing_docs, reason = "clap would take it for the documentation of the command")]
    pub shape: Shape,
    /// Virtual seconds of each run, of which there are two at each load.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = within(0.01..=1_000.0))]
    pub seconds: f64,
    /// Write the results to a file, or to standard output if it is `-`.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub json: Option<PathBuf>,
    /// Draw the share of schedulable sets over the utilisation into a file.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub svg: Option<PathBuf>,
}

/// What the sets have in common.
#[derive(Args, Clone, Debug, Serialize)]
pub struct Shape {
    /// Nodes on the bus.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = within(1..=100_u8))]
    pub nodes: u8,
    /// The shortest period, in milliseconds. Periods are drawn log-uniformly.
    #[arg(long, value_name = "MS", default_value_t = 5.0, value_parser = within(1.0..=10_000.0))]
    pub shortest_period: f64,
    /// The longest period, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 100.0, value_parser = within(1.0..=10_000.0))]
    pub longest_period: f64,
    /// Bytes in a frame.
    #[arg(long, value_enum, default_value_t = Lengths::Full)]
    pub lengths: Lengths,
    /// Relative deadlines.
    #[arg(long, value_enum, default_value_t = Deadlines::Period)]
    pub deadlines: Deadlines,
}

/// How long frames are.
#[derive(ValueEnum, Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lengths {
    /// Eight bytes.
    Full,
    /// One to eight bytes, drawn for each message.
    Mixed,
}

/// Deadlines of messages.
#[derive(ValueEnum, Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Deadlines {
    /// Equal to the period.
    Period,
    /// Half a period to a whole one, drawn for each message.
    Drawn,
}

/// What `experiment clock` is told.
#[derive(Args, Clone, Serialize)]
pub struct Clock {
    /// Virtual seconds at each load.
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = within(5..=100_000_u64))]
    pub seconds: u64,
    /// The largest deviation of an oscillator, in parts per million. The master has it upwards, the second
    /// node downwards, the others are drawn in between.
    #[arg(long, value_name = "PPM", default_value_t = 50, value_parser = within(0..=200_u16))]
    pub drift: u16,
    /// The span between two sync frames, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = within(5..=1_000_u64))]
    pub period: u64,
    /// Nodes on the bus.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = within(2..=100_u8))]
    pub nodes: u8,
    /// Load of the bus by other frames, in percent; several are tried one after the other.
    #[arg(long, value_name = "PERCENT", value_delimiter = ',', default_value = "0,50,95")]
    #[arg(value_parser = within(0..=98_u8))]
    pub load: Vec<u8>,
    /// The seed of drifts, delays and traffic.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Write the results to a file, or to standard output if it is `-`.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub json: Option<PathBuf>,
}
/// What `experiment scale` is told.
#[derive(Args, Serialize)]
pub struct Scale {
    /// Nodes on the bus.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = within(10..=127_u8))]
    pub nodes: u8,
    /// Virtual seconds that are measured, after two in which the clocks synchronise.
    #[arg(long, value_name = "S", default_value_t = 20, value_parser = within(1..=100_000_u64))]
    pub seconds: u64,
    /// Services that every node takes part in.
    #[arg(long, value_enum, default_value_t = Extent::All)]
    pub services: Extent,
    /// The seed of drifts and delays.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Fail if fewer virtual seconds are simulated in a second of processor time.
    #[arg(long, value_name = "RATIO")]
    pub at_least: Option<f64>,
    /// Write the results to a file, or to standard output if it is `-`.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub json: Option<PathBuf>,
}

/// What `experiment admission` is told.
#[derive(Args, Serialize)]
pub struct Admission {
    /// How many random sequences of announcements and withdrawals, each on a segment of its own.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = within(1..=1_000_000_u64))]
    pub sequences: u64,
    /// The seed of the first sequence; each further one has the next.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Let nodes publish without asking, to see what admission is for. The experiment fails then.
    #[arg(long)]
    pub unasked: bool,
    /// Write the results to a file, or to standard output if it is `-`.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub json: Option<PathBuf>,
}

/// Which services run.
#[derive(ValueEnum, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Extent {
    /// Clock synchronisation.
    Clock,
    /// Clock synchronisation, node identity, interest, node status; ids and etags are fixed.
    All,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Result<Arguments, clap::Error> {
        Arguments::read(line.split_whitespace().map(OsString::from))
    }

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn what_is_out_of_bounds_is_refused_with_its_bounds() {
        for (line, bounds) in [
            ("edf --seconds 1e-9", "must be from 0.01 to 1000\n"),
            ("edf --seconds -1", "must be from 0.01 to 1000\n"),
            ("edf --sets 0", "must be from 1 to 100000\n"),
            ("edf --shortest-period nan", "must be from 1 to 10000\n"),
            ("edf --shortest-period 50 --longest-period 20", "longer than --longest-period"),
            ("clock --load 99", "must be from 0 to 98\n"),
            ("scale --nodes -3", "must be from 10 to 127\n"),
        ] {
            let message = read(line).err().unwrap().to_string();
            assert!(message.contains(bounds), "{line}: {message}");
        }
        assert!(read("edf --sets 3 --json -").is_ok() && read("scale").is_ok());
        assert!(read("admission --unasked").is_ok());
    }
}
