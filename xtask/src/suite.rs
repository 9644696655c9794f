//! Runs the tests and counts them.

use std::path::Path;
use std::process::{self, ExitCode};
use std::{env, fs};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};

use crate::apps;
use crate::bit_rates;
use crate::cargo_test::cargo_test;
use crate::demo;
use crate::fuzz;
use crate::guide;
use crate::images::{self, PROFILE};
use crate::linux;
use crate::new::{self, Example};
use crate::plan;
use crate::python;
use crate::qemu;
use crate::run::{self, step};
use crate::setup::{self, Tool};
use crate::socketcan;
use crate::tally::Tally;
use crate::target::{TRIPLE, TargetWay};
use crate::tools;
use crate::walk;
use crate::workspace::Workspace;

/// Which tests to run.
#[derive(Args)]
pub(crate) struct Options {
    /// Only these; all but `socketcan` if none is named.
    #[arg(value_enum)]
    parts: Vec<Part>,
}

/// Tests that run in one place.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Part {
    /// On this machine: what needs neither the Arm target nor an emulator
    Host,
    /// The node on Linux, the gateway, and the `cosmic` command.
    Linux,
    /// The demo of the gateway, for some seconds.
    Wan,
    /// What the planner exports, with a C compiler, Python, cantools and Wireshark.
    Tools,
    /// The Python package: built, installed, tested.
    Python,
    /// The fuzz targets of the core, for a moment each.
    Fuzz,
    /// The firmware in the emulated cluster.
    Emulated,
    /// The core and RTIC in QEMU.
    Qemu,
    /// A rover of six nodes, outside this repository: from its description to firmware, judge, Wireshark and Python.
    Walk,
    /// The firmware in the emulated cluster at 50, 125, 250 and 500 kbit/s.
    BitRates,
    /// The link over SocketCAN, in a virtual machine with Debian's kernel. Not among all.
    Socketcan,
}

/// Runs the tests that are asked for.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<ExitCode> {
    let all: Vec<Part> =
        Part::value_variants().iter().copied().filter(|part| *part != Part::Socketcan).collect();
    let parts = if options.parts.is_empty() { &all } else { &options.parts };
    let mut tally = Tally::default();
    if parts.contains(&Part::Host) {
        tally.add(host(workspace));
    }
    if parts.contains(&Part::Linux) {
        tally.add(linux::test(workspace));
    }
    if parts.contains(&Part::Wan) {
        tally.add(demo::short_wan(workspace));
    }
    if parts.contains(&Part::Tools) {
        tally.add(tools::test(workspace));
    }
    if parts.contains(&Part::Python) {
        tally.add(python::test(workspace));
    }
    if parts.contains(&Part::Fuzz) {
        tally.add(fuzz::smoke(workspace));
    }
    if parts.contains(&Part::Emulated) {
        let way = setup::prepare(&setup::COMPARISON)?;
        tally.add(emulated(workspace, &way));
    }
    if parts.contains(&Part::Qemu) {
        let way = setup::prepare(&[Tool::Qemu])?;
        tally.add(qemu::test(workspace, &way));
    }
    if parts.contains(&Part::Walk) {
        tally.add(walk::test(workspace));
    }
    if parts.contains(&Part::BitRates) {
        tally.add(bit_rates::test(workspace));
    }
    if parts.contains(&Part::Socketcan) {
        tally.add(socketcan::test(workspace));
    }
    Ok(tally.conclude())
}

/// The tests of what runs on the host, and of the parts of `boards` that touch no hardware.
pub(crate) fn host(workspace: &Workspace) -> Result<Tally> {
    let mut default_members = workspace.cargo();
    default_members.args(["test", "--no-fail-fast"]);
    let mut boards = workspace.cargo();
    boards.args(["test", "--no-fail-fast", "--package", "boards"]);
    step("testing on the host", || {
        let mut tally = cargo_test(&mut default_members)?;
        tally.add(cargo_test(&mut boards));
        Ok(tally)
    })
}

/// The tests of the emulated cluster and of the demo, which run the images, and the trials, whose images misbehave.
///
/// In the profile of the demo, for speed; in one call of cargo, so that all run one emulator.
pub(crate) fn emulated(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let mut command = emulated_tests(workspace, way)?;
    // These images stand beside those of the firmware.
    step("building the images of the trials", || {
        images::build(way.cargo(workspace, "build"), images::TRIALS, images::PROFILE, &[])
    })?;
    command.args(["--package", "cosmic-trials"]);
    command.env(WORKSHOP_IMAGES, images::of_workshop(workspace, way)?);
    let mut tally = step("testing the firmware in the emulated cluster", || cargo_test(&mut command))?;
    tally.add(step("testing a new repository, made outside this one", || new_repository(workspace, way)));
    tally.add(step("testing a workshop that configures itself, outside this repository", || {
        workshop(workspace, way)
    }));
    Ok(tally)
}

/// What the images cost: one of these tests, with its figures shown.
pub(crate) fn costs(workspace: &Workspace) -> Result<Tally> {
    let way = setup::prepare(&setup::COMPARISON)?;
    let mut command = emulated_tests(workspace, &way)?;
    command.args(["--test", "cost", "--", "--nocapture", "--test-threads=1"]);
    step("measuring the images in the emulated cluster", || cargo_test(&mut command))
}

/// A call of cargo that tests the emulated cluster and the demo, with the images, which it builds.
fn emulated_tests(workspace: &Workspace, way: &TargetWay) -> Result<process::Command> {
    let built = images::of_example(workspace, way)?;
    let small = images::small(workspace, way, &[])?;
    let mut command = workspace.cargo();
    command.args(["test", "--no-fail-fast", "--release"]).args(demo::EMULATED_TESTS);
    command.env(IMAGES, built.directory().context("the firmware has no images")?);
    command.env(SMALL_IMAGES, small.directory().context("there are no small images")?);
    Ok(command)
}

/// Makes a repository as a user would, in a folder outside this one, builds it, and runs its own test. It shares
/// the folder of build products, so that the crates that both use are built once.
fn new_repository(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let folder = env::temp_dir().join(format!("cosmic-robot-{}", process::id()));
    let tally =
        new::make(workspace, Example::Robot, &folder).and_then(|()| build_and_test(workspace, way, &folder));
    // What a test leaves behind is no failure.
    let _ = fs::remove_dir_all(&folder);
    tally
}

/// Makes the workshop as a user would, builds it, and runs its own test.
fn workshop(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let folder = env::temp_dir().join(format!("cosmic-workshop-{}", process::id()));
    let made = new::make(workspace, Example::Workshop, &folder);
    let tally = made.and_then(|()| {
        run::run(&mut images_of(workspace, way, &folder, "workshop"))?;
        own_test(workspace, way, &folder)
    });
    // What a test leaves behind is no failure.
    let _ = fs::remove_dir_all(&folder);
    tally
}

fn build_and_test(workspace: &Workspace, way: &TargetWay, folder: &Path) -> Result<Tally> {
    let tutorial = workspace.root().join("docs/tutorial.md");
    let tutorial =
        fs::read_to_string(&tutorial).with_context(|| format!("reading {}", tutorial.display()))?;
    let mut tally = as_printed(workspace, way, folder, &tutorial)?;
    tally.add(judged(workspace, way, folder));
    tally.add(wrong_plan(workspace, way, folder));
    let guide = guide::text(workspace)?;
    guide::follow(&guide, folder)?;
    tally.add(as_printed(workspace, way, folder, &guide));
    Ok(tally)
}

/// Builds the images of the repository, runs its own test, and then its program, which says what a document promises.
fn as_printed(workspace: &Workspace, way: &TargetWay, folder: &Path, document: &str) -> Result<Tally> {
    run::run(&mut images_of(workspace, way, folder, "robot"))?;
    let images = way.target_dir(workspace).join(TRIPLE).join(PROFILE);
    let mut tally = own_test(workspace, way, folder)?;
    let mut program = workspace.cargo();
    program.current_dir(folder).args(["run", "--release"]);
    program.env("CARGO_TARGET_DIR", workspace.target_dir()).env(IMAGES, images);
    tally.add(says(&mut program, document));
    Ok(tally)
}

/// The test of the repository, on images that are built.
fn own_test(workspace: &Workspace, way: &TargetWay, folder: &Path) -> Result<Tally> {
    let mut test = workspace.cargo();
    test.current_dir(folder).args(["test", "--no-fail-fast", "--release"]);
    test.env("CARGO_TARGET_DIR", workspace.target_dir());
    test.env(IMAGES, way.target_dir(workspace).join(TRIPLE).join(PROFILE));
    cargo_test(&mut test)
}

fn images_of(workspace: &Workspace, way: &TargetWay, folder: &Path, package: &str) -> process::Command {
    let mut build = way.cargo(workspace, "build");
    build.current_dir(folder).args(["--package", package, "--profile", PROFILE]);
    build.env("CARGO_TARGET_DIR", way.target_dir(workspace));
    build
}

/// A mistake in the description ends the build, and cargo shows file, line, field and remedy.
fn wrong_plan(workspace: &Workspace, way: &TargetWay, folder: &Path) -> Result<Tally> {
    let path = folder.join(plan::OF_A_REPOSITORY);
    let right = fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
    let wrong = right.replacen("\nperiod = ", "\nperoid = ", 1);
    let line =
        wrong.lines().position(|line| line.starts_with("peroid")).context("no channel has a period")? + 1;
    fs::write(&path, &wrong).with_context(|| format!("writing {}", path.display()))?;
    let built = run::with_complaints(&mut images_of(workspace, way, folder, "robot"));
    fs::write(&path, right).with_context(|| format!("writing {}", path.display()))?;
    let (status, said) = built?;
    let place = format!("cluster.toml:{line}:");
    let expected = [place.as_str(), "joint_angle.peroid", "did you mean `period`?", "nothing was built"];
    let missing: Vec<_> = expected.iter().filter(|text| !said.contains(**text)).collect();
    if !missing.is_empty() {
        eprintln!("error: of a wrong cluster.toml the build does not say {missing:?}");
    }
    Ok(Tally::one(!status.success() && missing.is_empty()))
}

/// The demo runs the applications of the repository, and finds nothing wrong.
fn judged(workspace: &Workspace, way: &TargetWay, folder: &Path) -> Result<Tally> {
    let cluster = folder.join(plan::OF_A_REPOSITORY);
    let images = apps::build(way, folder, &cluster, Some(workspace.target_dir()))?.directory;
    let word = |path: &Path| path.display().to_string();
    let (cluster, images, out) = (word(&cluster), word(&images), word(&folder.join("judged")));
    let arguments =
        ["--cluster", &cluster, "--images", &images, "--out", &out, "--seconds", "2", "--load", "80"];
    let code = demo::run(workspace, &arguments.map(str::to_owned))?;
    Ok(Tally::one(code == 0))
}

/// The lines of log in a document are what the robot says, but for the instants: these follow from the instructions
/// of the images.
fn says(program: &mut process::Command, document: &str) -> Result<Tally> {
    let promised: Vec<&str> = document.lines().filter_map(said).collect();
    let mut missing = promised.clone();
    run::lines(program, |line| missing.retain(|promise| said(line) != Some(*promise)))?;
    for promise in &missing {
        eprintln!("error: the documentation prints `{promise}`, which the robot does not say");
    }
    Ok(Tally::one(!promised.is_empty() && missing.is_empty()))
}

/// What a node of the robot logs, without the instant.
fn said(line: &str) -> Option<&str> {
    let (at, text) = line.split_once(" µs ")?;
    (at.trim().parse::<u64>().is_ok() && text.contains(": INFO ")).then_some(text)
}

/// Tells the tests of the emulated cluster where the images are.
const IMAGES: &str = "COSMIC_IMAGES";
/// The same, for the cluster that configures itself.
const WORKSHOP_IMAGES: &str = "COSMIC_WORKSHOP_IMAGES";
/// The same, for the nodes whose size is a goal.
const SMALL_IMAGES: &str = "COSMIC_SMALL_IMAGES";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_node_says_is_its_log_line_without_the_instant() {
        let line = " 1508000 µs arm: INFO 100 set points";
        assert_eq!(said(line), Some("arm: INFO 100 set points"));
        assert_eq!(said("joint_angle  954 µs  arm: INFO"), None);
        assert_eq!(said("period 5 ms down to 220 µs"), None);
    }
}
