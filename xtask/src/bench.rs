//! Measures what the middleware costs on a Cortex-M4F, and compares it with limits.
//!
//! `qemu-tests/src/bin/bench.rs` counts; `qemu-tests/bench-limits.json` holds the limits, for code that is built for speed and
//! for size.

use std::fs;
use std::process::ExitCode;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

use crate::images;
use crate::qemu;
use crate::run::step;
use crate::setup::{self, Tool};
use crate::suite;
use crate::tally::Tally;
use crate::target::TargetWay;
use crate::workspace::Workspace;

/// What is measured, and how it is shown.
#[derive(Args)]
pub(crate) struct Options {
    /// What the code is built for.
    #[arg(long, value_enum, default_value_t = Aim::Speed)]
    built_for: Aim,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Instead, measure in the emulated cluster how many cycles the images that are flashed take for a frame, for a release,
    /// for a cycle of the calendar, and for how much of the time they are awake on a full bus.
    #[arg(long, conflicts_with_all = ["json", "built_for"])]
    cycles: bool,
}

/// What code is built for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Aim {
    /// As the images of the example.
    Speed,
    /// As the images of `firmware/small`.
    Size,
}

impl Aim {
    fn profile(self) -> &'static str {
        match self {
            Self::Speed => images::PROFILE,
            Self::Size => images::PROFILE_OF_SMALL,
        }
    }
}

/// A measured value.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
struct Measurement {
    what: String,
    value: u32,
    unit: &'static str,
    /// The largest value that is allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<u32>,
    /// Whether all runs took the same number of instructions.
    exact: bool,
}

/// The limits of a line, as they stand in the file.
#[derive(Deserialize)]
struct Limits {
    what: String,
    speed: u32,
    size: u32,
}

impl Measurement {
    /// From a line that the program prints; `None` for other lines.
    fn parse(line: &str) -> Option<Self> {
        let (what, rest) = line.rsplit_once(": ")?;
        let (number, rest) = rest.split_once(' ')?;
        let value = number.parse().ok()?;
        let (unit, exact) = match rest {
            "bytes" => ("bytes", true),
            "instructions, exact true" => ("instructions", true),
            "instructions, exact false" => ("instructions", false),
            _ => return None,
        };
        Some(Self { what: what.to_owned(), value, unit, limit: None, exact })
    }

    fn holds(&self) -> bool {
        self.exact && self.limit.is_none_or(|limit| self.value <= limit)
    }
}

/// Measures and shows. The exit code says whether all limits hold.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<ExitCode> {
    if options.cycles {
        return Ok(suite::costs(workspace)?.conclude());
    }
    let way = setup::prepare(&[Tool::Qemu])?;
    let all = measure(workspace, &way, options.built_for)?;
    if options.json {
        println!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        print!("{}", table(&all));
    }
    Ok(if all.iter().all(Measurement::holds) { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Each limit is a check that passes or fails.
pub(crate) fn check(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let mut all = Vec::new();
    for aim in Aim::value_variants() {
        let measured = measure(workspace, way, *aim)?;
        println!("built for {aim:?}");
        print!("{}", table(&measured));
        all.extend(measured);
    }
    let limited = || all.iter().filter(|it| it.limit.is_some());
    let passed = limited().filter(|it| it.holds()).count();
    Ok(Tally { passed, failed: limited().count() - passed })
}

fn measure(workspace: &Workspace, way: &TargetWay, aim: Aim) -> Result<Vec<Measurement>> {
    let path = workspace.root().join(qemu::PACKAGE).join("bench-limits.json");
    let text = fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    let limits: Vec<Limits> =
        serde_json::from_str(&text).with_context(|| format!("{} holds no limits", path.display()))?;
    let built = step("building the measurement", || {
        images::build(way.cargo(workspace, "build"), qemu::PACKAGE, aim.profile(), &[PROGRAM.to_owned()])
    })?;
    let image = built.images.get(PROGRAM).context("the build gave no measurement")?;
    let printed = step("measuring in QEMU", || qemu::measure(image))?;
    let mut all: Vec<_> = printed.lines().filter_map(Measurement::parse).collect();
    for limit in limits {
        let of_limit = |it: &&mut Measurement| it.what == limit.what;
        let Some(measurement) = all.iter_mut().find(of_limit) else {
            bail!("{} has a limit for \"{}\", which is not measured", path.display(), limit.what);
        };
        measurement.limit = Some(match aim {
            Aim::Speed => limit.speed,
            Aim::Size => limit.size,
        });
    }
    Ok(all)
}

fn table(all: &[Measurement]) -> String {
    let width = all.iter().map(|it| it.what.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    for it in all {
        let limit = it.limit.map_or(String::new(), |limit| format!("  at most {limit:>3}"));
        let verdict = match (it.exact, it.holds()) {
            (false, _) => "  NOT EXACT",
            (true, false) => "  EXCEEDED",
            (true, true) => "",
        };
        text += &format!("{:width$}  {:>5} {:<12}{limit}{verdict}\n", it.what, it.value, it.unit);
    }
    text
}

/// The program that measures.
const PROGRAM: &str = "bench";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_become_measurements() {
        let publish = Measurement::parse("publish soft: 156 instructions, exact true").unwrap();
        assert_eq!(
            (publish.what.as_str(), publish.value, publish.unit),
            ("publish soft", 156, "instructions")
        );
        assert!(publish.holds());
        let uneven = Measurement::parse("x: 1 instructions, exact false").unwrap();
        assert!(!uneven.holds());
        let memory = Measurement::parse("RAM of a channel: 112 bytes").unwrap();
        assert_eq!((memory.value, memory.unit), (112, "bytes"));
        assert_eq!(Measurement::parse("measured"), None);
    }

    #[test]
    fn a_limit_is_the_largest_value_allowed() {
        let at = |value| Measurement {
            what: "x".to_owned(),
            value,
            unit: "instructions",
            limit: Some(39),
            exact: true,
        };
        assert!(at(39).holds() && !at(40).holds());
        assert!(table(&[at(40)]).ends_with("at most  39  EXCEEDED\n"));
    }
}
