//! The options of the demo of the gateway.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Parser;

use crate::number::within;

/// Run flashed images on two emulated CAN buses in real time, join the buses by two gateways over a way that is slow, cut
/// that way while commands are published, and say what became of them
#[derive(Parser, Clone, PartialEq, Debug)]
#[command(
    name = "wan-demo",
    bin_name = "cargo xtask demo --wan",
    override_usage = "cargo xtask demo --wan [OPTIONS]",
    max_term_width = 100,
    after_help = NOTES
)]
pub struct Options {
    /// For how many seconds the way between the gateways is cut
    #[arg(long, value_name = "S", default_value = "10", value_parser = within(1..=600_u64), allow_negative_numbers = true)]
    pub cut: u64,

    /// For how many seconds it is open before and after that
    #[arg(long, value_name = "S", default_value = "4", value_parser = within(0..=600_u64), allow_negative_numbers = true)]
    pub around: u64,

    /// How long that way takes in each direction, in milliseconds
    #[arg(long, value_name = "MS", default_value = "5", value_parser = within(0..=100_u64), allow_negative_numbers = true)]
    pub delay: u64,

    /// Round trips to measure on each path
    #[arg(long, value_name = "N", default_value = "200", value_parser = within(1..=10_000_u32), allow_negative_numbers = true)]
    pub rounds: u32,

    /// Join the gateways by the loopback interface, also where each could have a network namespace of its own
    #[arg(long)]
    pub loopback: bool,

    /// Serve a live page of both segments and of what crosses, at this address, and stay until Ctrl-C; joins the gateways by
    /// the loopback interface [default address: 127.0.0.1:8117]
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8117")]
    pub page: Option<SocketAddr>,

    /// Also write the report as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Where to write cut.svg
    #[arg(long, value_name = "DIR", default_value = "target/wan-demo")]
    pub out: PathBuf,

    /// The description of the vehicle's cluster [default: that of the example]
    #[arg(long, value_name = "FILE")]
    pub cluster: Option<PathBuf>,

    /// Run images that are built already, each with the name of its node, and build nothing
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,

    /// The program that serves emulated segments
    #[arg(long, value_name = "FILE", hide = true)]
    pub server: Option<PathBuf>,

    /// The program runs in a network namespace of its own
    #[arg(long, hide = true)]
    pub entered: bool,

    /// Be the gateway with this configuration
    #[arg(long, value_name = "FILE", hide = true, requires = "segment")]
    pub gateway: Option<PathBuf>,

    /// Of this segment
    #[arg(long, value_name = "NAME", hide = true, requires = "gateway")]
    pub segment: Option<String>,

    /// Somebody wants to be told of each event
    #[arg(long, hide = true, requires = "gateway")]
    pub watched: bool,
}

impl Options {
    /// Reads what a user wrote behind `cargo xtask demo --wan`, before anything is built.
    ///
    /// # Errors
    /// What clap says, or the help that was asked for.
    pub fn read(arguments: &[String]) -> Result<Self, clap::Error> {
        Self::try_parse_from(["wan-demo"].into_iter().chain(arguments.iter().map(String::as_str)))
    }
}

const NOTES: &str = "\
Sensor, brake and diagnostics run in the west, another brake in the east, at the speed of the wall clock.
The bus in the east gets temperatures and brake forces from the west; wheel speeds are hard real-time and do not cross.
Each gateway stands in a network namespace of its own, where the kernel allows that and `unshare` and `ip` are there, else
both on the loopback interface; no traffic leaves this machine.

Exit code: 0 all as promised, 1 not, 2 it could not be run.";

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn options_are_read_or_refused() {
        Options::command().debug_assert();
        let read =
            |list: &[&str]| Options::read(&list.iter().map(|&text| text.to_owned()).collect::<Vec<_>>());
        assert_eq!(read(&["--cut", "30"]).unwrap().cut, 30);
        assert_eq!(read(&["--page", "--cut", "3"]).unwrap().page.map(|page| page.port()), Some(8117));
        assert_eq!(read(&["--page", "127.0.0.1:0"]).unwrap().page.map(|page| page.port()), Some(0));
        for wrong in [
            &["--page", "here"],
            &["--cut", "0"],
            &["--delay", "-1"],
            &["--rounds", "many"],
            &["--colour", "no"],
        ] {
            assert!(read(wrong).is_err(), "{wrong:?}");
        }
    }
}
