//! The options of the experiments with the gateway.

use std::path::PathBuf;

use clap::{Parser, ValueEnum};

use crate::number::within;

/// Measure what the gateway costs: latency beside zenoh and the link alone, throughput on one core, memory; and, if it is
/// named, how all that grows with segments and subjects
#[derive(Parser, Clone, PartialEq, Debug)]
#[command(
    name = "gateway-bench",
    bin_name = "cargo xtask experiment gateway",
    max_term_width = 100,
    after_help = NOTES
)]
pub struct Options {
    /// What to measure [default: latency throughput memory]
    #[arg(value_enum)]
    pub named: Vec<Part>,

    /// Latency: batches, of each kind in turn
    #[arg(long, value_name = "N", default_value = "20", value_parser = within(1..=10_000_usize), allow_negative_numbers = true)]
    pub batches: usize,

    /// Events of a batch; and of a size, for scale
    #[arg(long, value_name = "N", default_value = "250", value_parser = within(1..=1_000_000_usize), allow_negative_numbers = true)]
    pub events: usize,

    /// Throughput: events a second
    #[arg(long, value_name = "N", default_value = "10000", value_parser = within(4..=24_000_u32), allow_negative_numbers = true)]
    pub rate: u32,

    /// Throughput: for so many seconds. The default sends as many events as an hour of 1 000 a second
    #[arg(long, value_name = "S", default_value = "360", value_parser = within(5..=86_400_u64), allow_negative_numbers = true)]
    pub seconds: u64,

    /// Memory: subjects that come and go
    #[arg(long, value_name = "N", default_value = "2000", value_parser = within(100..=1_000_000_usize), allow_negative_numbers = true)]
    pub subjects_that_go: usize,

    /// Scale: segments, each with a gateway
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "2,10,30", value_parser = within(2..=250_usize))]
    pub segments: Vec<usize>,

    /// Scale: subjects on each segment
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "10,100", value_parser = within(1..=120_usize))]
    pub subjects: Vec<usize>,

    /// Also write the results as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Scale: also draw the curves
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
}

/// Something to measure.
#[derive(ValueEnum, Clone, Copy, PartialEq, Eq, Debug)]
pub enum Part {
    /// From wire to wire, and what two gateways add to zenoh and the link
    Latency,
    /// Events a second through gateways on one core each; what was lost; memory under load
    Throughput,
    /// What is left of subjects that went away
    Memory,
    /// Cost of an event, a declaration and a gateway against segments and subjects
    Scale,
}

impl Options {
    /// Reads what a user wrote behind `cargo xtask experiment gateway`, before anything is built.
    ///
    /// # Errors
    /// What clap says, or the help that was asked for.
    pub fn read(arguments: &[String]) -> Result<Self, clap::Error> {
        Self::try_parse_from(["gateway-bench"].into_iter().chain(arguments.iter().map(String::as_str)))
    }

    /// What to measure.
    pub fn parts(&self) -> Vec<Part> {
        let default = [Part::Latency, Part::Throughput, Part::Memory];
        if self.named.is_empty() { default.into() } else { self.named.clone() }
    }
}

const NOTES: &str = "\
All traffic stays on this machine. Processor time is what the kernel counts; latency depends on what else runs.

Exit code: 0 what is promised holds, 1 not, or it could not be measured, 2 wrong arguments.";

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn options_are_read_or_refused() {
        Options::command().debug_assert();
        let read =
            |list: &[&str]| Options::read(&list.iter().map(|&text| text.to_owned()).collect::<Vec<_>>());
        assert_eq!(read(&[]).unwrap().parts(), [Part::Latency, Part::Throughput, Part::Memory]);
        let scale = read(&["scale", "--segments", "2,100"]).unwrap();
        assert_eq!((scale.parts(), scale.segments), (vec![Part::Scale], vec![2, 100]));
        for wrong in [&["--rate", "0"], &["--subjects", "121"], &["--events", "-1"], &["speed", "scale"]] {
            assert!(read(wrong).is_err(), "{wrong:?}");
        }
    }
}
