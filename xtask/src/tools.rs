//! Tries what `cosmic-plan export` writes with programs of others: a C compiler, Python with cantools, Wireshark.

use std::process::Command;

use anyhow::Result;

use crate::cargo_test::cargo_test;
use crate::linux;
use crate::run::{self, step};
use crate::setup::{self, Tool};
use crate::tally::Tally;
use crate::venv;
use crate::workspace::Workspace;

/// Installs the programs where it may, and runs the tests of all that is generated from contents. A program that is
/// missing is then a failure; `cargo test` alone says that it did not try it.
pub(crate) fn test(workspace: &Workspace) -> Result<Tally> {
    prepare(workspace)?;
    let mut command = workspace.cargo();
    // No package is named, so that it is the one that was built with all tests of the host.
    command.args(["test", "--test", "contents"]).env(INSIST, "1");
    let mut tally = step("trying what is exported with the programs of others", || cargo_test(&mut command))?;
    tally.add(records(workspace));
    Ok(tally)
}

/// What `cosmic record` writes, in Wireshark, with the dissector of the cluster.
fn records(workspace: &Workspace) -> Result<Tally> {
    let dissector = workspace.target_dir().join("tools/rover.lua");
    // Built with the tests of what it exports.
    let mut export = Command::new(workspace.target_dir().join("debug/cosmic-plan"));
    export.arg("export").arg(workspace.root().join("cosmic-plan/examples/rover.toml"));
    export.args(["--format", "lua", "--out"]).arg(&dissector);
    step("making the dissector of the rover", || run::run(&mut export))?;
    let mut command = linux::one_test(workspace, "wireshark");
    command.env("COSMIC_DISSECTOR", &dissector);
    step("trying records with Wireshark", || cargo_test(&mut command))
}

/// Finds or installs the programs.
///
/// # Errors
/// What is missing and cannot be installed here, and what to type.
pub(crate) fn prepare(workspace: &Workspace) -> Result<()> {
    setup::install_tools(&[Tool::Compiler, Tool::Tshark])?;
    venv::prepare(&workspace.target_dir().join("tools"), &PACKAGES).map(|_| ())
}

/// Tells the tests to insist on the programs.
const INSIST: &str = "COSMIC_TOOLS";

/// Python's packages.
const PACKAGES: [&str; 2] = ["cantools==45.1.0", "python-can==4.6.1"];
