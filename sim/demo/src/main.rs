//! Runs the example firmware on the emulated cluster, judges what happened, and shows it.
//!
//! Exit code 0: all as promised. 1: not. 2: it could not be run.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use cosmic_bus::{Chance, VirtualInstant};
use cosmic_core::time::Duration;
use cosmic_demo::load::Share;
use cosmic_demo::output::{self, Pending};
use cosmic_demo::picture;
use cosmic_demo::progress::Progress;
use cosmic_demo::report::{Report, Settings};
use cosmic_demo::run::{self, Plan};
use cosmic_demo::table::{Style, Tables};
use cosmic_demo::verdict::Verdict;

/// Run three nodes and a background load on an emulated CAN bus, and judge what each event channel did
#[derive(Parser, Debug)]
#[command(
    name = "demo",
    bin_name = "cargo xtask demo",
    override_usage = "cargo xtask demo [OPTIONS]",
    max_term_width = 100,
    after_help = NOTES
)]
struct Arguments {
    /// Virtual seconds to run; the clocks need about half a second to agree
    #[arg(long, value_name = "S", default_value = "5", value_parser = seconds)]
    seconds: Duration,

    /// Where all chance comes from: one seed, one run
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// Load of the bus as a whole, background load included
    #[arg(long, value_name = "PERCENT", default_value = "60", value_parser = percent)]
    load: Share,

    /// Chance that a frame on the wire is destroyed, 0 to 1
    #[arg(long, value_name = "RATE", default_value = "0.001", value_parser = chance)]
    errors: Chance,

    /// Destroy N attempts in a row in one HRT slot; it is made for one
    #[arg(long, value_name = "N", default_value_t = 0)]
    burst: u32,

    /// Also write the report as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,

    /// Where to write bus.svg and candump.log
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,

    /// Where the firmware images are
    #[arg(long, value_name = "DIR", help_heading = "Given by cargo xtask")]
    images: PathBuf,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match demonstrate(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(NOT_AS_PROMISED),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(NOT_RUN)
        }
    }
}

/// Runs, prints, writes. Was everything as promised?
fn demonstrate(arguments: &Arguments) -> Result<bool, Box<dyn core::error::Error>> {
    output::directory(&arguments.out)?;
    let remedy = "name another directory with --out";
    let mut log = Pending::create(arguments.out.join("candump.log"), remedy)?;
    let mut image = Pending::create(arguments.out.join("bus.svg"), remedy)?;
    let remedy = "name another file with --json";
    let mut json = arguments.json.as_ref().map(|path| Pending::create(path, remedy)).transpose()?;

    let mut progress = Progress::new(VirtualInstant::from_ticks(0) + arguments.seconds);
    let journal = run::run(&arguments.plan(), &mut log, |now| progress.reached(now))?;
    eprintln!("demo: {}", progress.finish());
    let verdict = Verdict::of(&journal);
    let settings = arguments.settings();
    let report = Report::of(settings, &journal, &verdict);

    image.write_all(picture::draw(&settings, &journal, &verdict).as_bytes())?;
    if let Some(json) = &mut json {
        serde_json::to_writer_pretty(&mut *json, &report)?;
        writeln!(json)?;
    }
    let mut places = vec![("picture", image.finish()?), ("log of the bus", log.finish()?)];
    if let Some(json) = json {
        places.push(("report", json.finish()?));
    }
    let style = if io::stdout().is_terminal() { Style::Colours } else { Style::Plain };
    let mut out = io::stdout().lock();
    write!(out, "{}", Tables { report: &report, style })?;
    for (what, place) in places {
        writeln!(out, "{what}: {}", place.display())?;
    }
    Ok(report.passed)
}

impl Arguments {
    fn plan(&self) -> Plan {
        Plan {
            images: self.images.clone(),
            length: self.seconds,
            seed: self.seed,
            load: self.load,
            errors: self.errors,
            burst: self.burst,
        }
    }

    fn settings(&self) -> Settings {
        Settings {
            seconds: self.seconds.as_ticks() as f64 / 1e9,
            seed: self.seed,
            load_percent: self.load.as_percent(),
            error_rate: self.errors.get(),
            burst: self.burst,
        }
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let longest = run::LONGEST.as_secs();
    let value: f64 = text.parse().map_err(|_| "not a number of seconds".to_owned())?;
    if !(value > 0.0 && value <= longest as f64) {
        return Err(format!("must be over 0, and {longest} at most"));
    }
    Ok(Duration::from_ticks((value * 1e9) as u64))
}

fn percent(text: &str) -> Result<Share, String> {
    let share = text.parse().ok().and_then(Share::percent);
    share.ok_or_else(|| "must be a number from 0 to 100".to_owned())
}

fn chance(text: &str) -> Result<Chance, String> {
    let chance = text.parse().ok().and_then(Chance::new);
    chance.ok_or_else(|| "must be a number from 0 to 1".to_owned())
}

const NOTES: &str = "\
The nodes are the images that are flashed. They start at different instants, and their crystals differ.
Into DIR go a picture of the bus (bus.svg) and its log (candump.log, for can-utils).
`cargo xtask demo --cluster FILE` plans the cluster of FILE first, and builds the images for it.

Exit code 0: every hard real-time event within its fault hypothesis was delivered at its instant, and
             every other loss was reported by an exception.
          1: not so; it says what.
          2: it could not be run.";
const NOT_AS_PROMISED: u8 = 1;
const NOT_RUN: u8 = 2;

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn what_is_no_number_of_its_kind_is_refused() {
        assert!(seconds("0").is_err() && seconds("-1").is_err() && seconds("nan").is_err());
        assert!(seconds("1001").is_err() && seconds("x").is_err());
        assert_eq!(seconds("0.5"), Ok(Duration::from_millis(500)));
        assert!(percent("101").is_err() && percent("-1").is_err() && percent("nan").is_err());
        assert!(chance("1.5").is_err() && chance("").is_err());
    }
}
