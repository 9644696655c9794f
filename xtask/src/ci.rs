//! Everything that must hold before a change goes in.
//!
//! The steps share their build products: flags and profiles are the same in all of them, and the emulated
//! cluster with what its tests need is compiled in one profile only.

use std::process::{Command, ExitCode};

use anyhow::{Result, bail};

use crate::bench;
use crate::bit_rates;
use crate::board::Board;
use crate::demo;
use crate::fuzz;
use crate::images;
use crate::linux;
use crate::panics;
use crate::plan;
use crate::python;
use crate::qemu;
use crate::run::{self, step};
use crate::setup;
use crate::size;
use crate::suite;
use crate::tally::Tally;
use crate::target::TargetWay;
use crate::tools;
use crate::walk;
use crate::workshop;
use crate::workspace::Workspace;

/// Carries out all steps, also after one has failed. The last line is `N passed, N failed`: tests of all
/// kinds and the demo, and one more failure for each other step that failed.
pub(crate) fn task(workspace: &Workspace) -> Result<ExitCode> {
    let way = setup::prepare(&setup::EVERYTHING)?;
    let mut tally = Tally::default();
    tally.add(check("formatting", workspace.cargo().args(["fmt", "--all", "--check"])));
    tally.add(clippy(workspace, &way));
    tally.add(documentation(workspace, &way));
    tally.add(suite::host(workspace));
    tally.add(linux::check(workspace));
    tally.add(linux::test(workspace));
    tally.add(tools::test(workspace));
    tally.add(python::check(workspace));
    tally.add(python::test(workspace));
    tally.add(fuzz::smoke(workspace));
    tally.add(no_warnings(workspace, &way));
    tally.add(sizes(workspace, &way));
    tally.add(qemu::test(workspace, &way));
    // The limits are counts of one compiler's code; another one's may differ by a few instructions.
    if way == TargetWay::Rustup {
        tally.add(bench::check(workspace, &way));
    }
    tally.add(suite::emulated(workspace, &way));
    tally.add(walk::test(workspace));
    tally.add(short_demo(workspace));
    tally.add(demo::short_wan(workspace));
    tally.add(bit_rates::test(workspace));
    Ok(tally.conclude())
}

/// A step that passes or fails, and is no test.
fn check(name: &str, command: &mut Command) -> Result<Tally> {
    step(name, || run::run(command))?;
    Ok(Tally::default())
}

fn clippy(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let mut host = workspace.cargo();
    host.args(["clippy", "--all-targets", "--", "--deny", "warnings"]);
    let mut emulator = workspace.cargo();
    emulator.args(["clippy", "--release", "--all-targets"]);
    emulator.args(demo::EMULATED_TESTS).args(["--package", "cosmic-trials"]);
    emulator.args(["--", "--deny", "warnings"]);
    let mut tally = Tally::default();
    tally.add(check("clippy on the host", &mut host));
    tally.add(check("clippy on the emulated cluster", &mut emulator));
    // Debian has no clippy for its compiler; there the compiler's own warnings must do.
    if *way == TargetWay::Rustup {
        for package in ["firmware", images::SMALL, images::TRIALS, qemu::PACKAGE] {
            let mut target = way.cargo(workspace, "clippy");
            target.args(["--package", "boards", "--package", package, "--", "--deny", "warnings"]);
            tally.add(check(&format!("clippy on {package}"), &mut target));
        }
    }
    Ok(tally)
}

fn documentation(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let mut host = workspace.cargo();
    host.args(["doc", "--no-deps"]).env("RUSTDOCFLAGS", "--deny warnings");
    let mut tally = Tally::default();
    tally.add(check("building the documentation", &mut host));
    if *way == TargetWay::Rustup {
        let mut target = way.cargo(workspace, "doc");
        target.args(["--no-deps", "--package", "boards", "--package", "firmware"]);
        target.env("RUSTDOCFLAGS", "--deny warnings");
        tally.add(check("building the documentation of the firmware", &mut target));
    }
    Ok(tally)
}

/// Warnings about code for the target are errors here.
fn no_warnings(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let mut warnings = images::of_example(workspace, way)?.warnings;
    for package in [images::TRIALS, qemu::PACKAGE] {
        warnings += images::build(way.cargo(workspace, "build"), package, images::PROFILE, &[])?.warnings;
    }
    warnings += images::small(workspace, way, &[])?.warnings;
    // The vehicle on the boards that do not run the image for none in particular; the trials have one of each, too.
    let example = plan::find(plan::example(workspace))?;
    for board in [Board::NucleoF446re, Board::FeatherF405] {
        warnings += images::kept(workspace, way, &example, Some(board), &["sensor".to_owned()])?.1.warnings;
    }
    if warnings > 0 {
        bail!("{warnings} warnings about code for the target; see above");
    }
    Ok(Tally::default())
}

fn sizes(workspace: &Workspace, way: &TargetWay) -> Result<Tally> {
    let images = images::measured(workspace, way)?;
    let sizes = size::measure_all(&images)?;
    print!("{}", size::table(&sizes));
    panics::check(&images::searched(workspace, way)?, false)?;
    // The baseline is of one compiler's code; another one's may differ by some per cent.
    if *way == TargetWay::Rustup {
        size::check(workspace, &sizes)?;
    }
    Ok(Tally::default())
}

/// A demo of a few virtual seconds, under load and with errors, and the workshop. They check themselves.
fn short_demo(workspace: &Workspace) -> Result<Tally> {
    let directory = workspace.target_dir().join("demo-of-ci");
    let mut arguments: Vec<String> = DEMO.map(str::to_owned).into();
    arguments.extend(["--out".to_owned(), directory.display().to_string()]);
    let code = demo::run(workspace, &arguments)?;
    let mut tally = Tally::one(code == 0);
    tally.add(workshop::run(workspace).map(|code| Tally::one(code == 0)));
    Ok(tally)
}

const DEMO: [&str; 8] = ["--seconds", "2", "--seed", "1", "--load", "95", "--errors", "0.001"];
