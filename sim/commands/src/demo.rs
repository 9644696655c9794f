//! The options of the demo.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::Parser;

use crate::number::within;

/// Run the nodes of a cluster and a background load on an emulated CAN bus, and judge what each event channel did
#[derive(Parser, Clone, PartialEq, Debug)]
#[command(
    name = "demo",
    bin_name = "cargo xtask demo",
    override_usage = "cargo xtask demo [OPTIONS]\n       cargo xtask run [OPTIONS] <ELF>...",
    max_term_width = 100,
    after_help = NOTES
)]
pub struct Options {
    /// Virtual seconds to run; the clocks need about half a second to agree
    #[arg(long, value_name = "S", default_value = "5", value_parser = seconds, allow_negative_numbers = true)]
    pub seconds: Duration,

    /// Where all chance comes from: one seed, one run
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = within(0..=u64::MAX), allow_negative_numbers = true)]
    pub seed: u64,

    /// Load of the bus as a whole, background load included
    #[arg(long, value_name = "PERCENT", default_value = "60", value_parser = within(0.0..=100.0))]
    #[arg(allow_negative_numbers = true)]
    pub load: f64,

    /// Chance that a frame on the wire is destroyed, 0 to 1
    #[arg(long, value_name = "RATE", default_value = "0.001", value_parser = within(0.0..=1.0))]
    #[arg(allow_negative_numbers = true)]
    pub errors: f64,

    /// Destroy N attempts in a row in one HRT slot; it is made for one
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = within(0..=1_000_000_u32), allow_negative_numbers = true)]
    pub burst: u32,

    /// Also write the report as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Where to write bus.svg and candump.log
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    pub out: PathBuf,

    /// Also write a trace for ui.perfetto.dev: tasks, bus, slots, the way of each event
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,

    /// The description of the cluster [default: the vehicle of the example, or cluster.toml in the DIR of --apps]
    #[arg(long, value_name = "FILE")]
    pub cluster: Option<PathBuf>,

    /// Build the applications of this repository instead of the example's; see docs/write-your-own-node.md
    #[arg(long, value_name = "DIR", conflicts_with = "images")]
    pub apps: Option<PathBuf>,

    /// Run images that are built already, each with the name of its node, and build nothing
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,

    /// Run these images, and build nothing: ELF files with the names of their nodes, or NODE=FILE
    #[arg(value_name = "ELF", conflicts_with_all = ["images", "apps"])]
    pub elf_files: Vec<Elf>,
}

/// An image and the node that it is of.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Elf {
    /// The name of the node.
    pub node: String,
    /// The image.
    pub file: PathBuf,
}

impl FromStr for Elf {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const NAMELESS: &str = "write the path of a file with the name of its node, or NODE=FILE";
        if let Some((node, file)) = text.split_once('=').filter(|(node, _)| !node.contains('/')) {
            let is_whole = !node.is_empty() && !file.is_empty();
            return is_whole.then(|| Self { node: node.into(), file: file.into() }).ok_or(NAMELESS);
        }
        let file = PathBuf::from(text);
        // What a file is called, up to its ending, if it has one: `arm.elf`.
        let node = file.file_stem().and_then(|name| name.to_str()).ok_or(NAMELESS)?;
        Ok(Self { node: node.into(), file })
    }
}

impl Options {
    /// Reads what a user wrote behind `cargo xtask demo`, before anything is built.
    ///
    /// # Errors
    /// What clap says, or the help that was asked for.
    pub fn read(arguments: &[String]) -> Result<Self, clap::Error> {
        Self::try_parse_from(["demo"].into_iter().chain(arguments.iter().map(String::as_str)))
    }
}

/// The shortest run: before, not every node has started its timer.
const SHORTEST: Duration = Duration::from_millis(100);
/// The longest run: after this, 32 bits of the timer that counts local time have passed through.
const LONGEST: Duration = Duration::from_secs(1000);

fn seconds(text: &str) -> Result<Duration, String> {
    let (shortest, longest) = (SHORTEST.as_secs_f64(), LONGEST.as_secs_f64());
    Ok(Duration::from_nanos((within(shortest..=longest)(text)? * 1e9) as u64))
}

const NOTES: &str = "\
The nodes are the images that are flashed. They start at different instants, and their crystals differ.
Into DIR go a picture of the bus (bus.svg) and its log (candump.log, for can-utils).
They are judged by the records of their observers (crate cosmic-records), whatever their contents.
Without --cluster, --apps, --images and ELF files, the workshop runs behind the vehicle: a cluster that
configures itself, judged by its bus and its logs. The options are of the vehicle.

Exit code 0: every hard real-time event within its fault hypothesis was delivered at its instant, and
             every other loss was reported by an exception; and the workshop did what it promises.
          1: not so; it says what.
          2: it could not be run.";

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        Options::command().debug_assert();
    }

    fn refusal(arguments: &[&str]) -> String {
        let arguments: Vec<_> = arguments.iter().map(|&word| word.to_owned()).collect();
        Options::read(&arguments).unwrap_err().to_string()
    }

    #[test]
    fn what_is_no_number_of_its_kind_is_refused_with_its_bounds() {
        for (option, wrong, bounds) in [
            ("--errors", &["2", "-1", "-0.5", "nan", "x", ""][..], "must be from 0 to 1\n"),
            ("--load", &["101", "-1", "inf", "x"], "must be from 0 to 100\n"),
            ("--seconds", &["0", "-1", "1e-9", "0.09", "1001", "nan", "x"], "must be from 0.1 to 1000\n"),
            ("--burst", &["-1", "1000001"], "must be from 0 to 1000000\n"),
            ("--seed", &["-1"], "must be from 0 to 18446744073709551615\n"),
        ] {
            for value in wrong {
                let message = refusal(&[option, value]);
                assert!(message.contains(bounds) && message.contains(option), "{option} {value}: {message}");
            }
        }
    }

    #[test]
    fn what_is_right_is_taken() {
        let right = ["--seconds", "0.5", "--errors", "1", "--load", "0", "--json", "report.json"];
        let words = ["demo", "--cluster", "here", "--images", "there"].into_iter().chain(right);
        let options = Options::try_parse_from(words).unwrap();
        assert_eq!(options.seconds, Duration::from_millis(500));
        assert_eq!((options.errors, options.load), (1.0, 0.0));
        assert!(Options::read(&right.map(str::to_owned)).is_ok());
        assert!(Options::read(&["--apps", "a", "--images", "b"].map(str::to_owned)).is_err());
    }

    #[test]
    fn images_are_named_by_their_nodes_or_like_them() {
        let read =
            |words: &[&str]| Options::read(&words.iter().map(|&word| word.to_owned()).collect::<Vec<_>>());
        let elf_files =
            read(&["--load", "80", "out/arm", "panel.elf", "hand=out/x=1/gripper"]).unwrap().elf_files;
        let elf = |node: &str, file: &str| Elf { node: node.into(), file: file.into() };
        assert_eq!(
            elf_files,
            [elf("arm", "out/arm"), elf("panel", "panel.elf"), elf("hand", "out/x=1/gripper")]
        );
        for wrong in
            [&["=arm"][..], &["arm="], &["/"], &["out/arm", "--images", "out"], &["arm", "--apps", "a"]]
        {
            assert!(read(wrong).is_err(), "{wrong:?}");
        }
    }
}
