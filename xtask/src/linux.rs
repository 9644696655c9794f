//! The crates under `linux/`, whose dependencies no other crate needs.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use crate::cargo_test::cargo_test;
use crate::run::{self, step};
use crate::setup::{self, Tool};
use crate::tally::Tally;
use crate::venv;
use crate::workspace::Workspace;

const PACKAGES: &[&str] = &[
    "--package=cosmic-cli",
    "--package=cosmic-gateway",
    "--package=cosmic-gateway-bench",
    "--package=cosmic-linux",
    "--package=cosmic-log",
    "--package=cosmic-monitor",
    "--package=cosmic-page",
    "--package=cosmic-session",
    "--package=cosmic-ups",
    "--package=cosmic-serve",
    "--package=cosmic-wan",
    "--package=cosmic-wan-demo",
];

/// What of them is documented: all but the binary that is named as its library. With the examples come the features
/// that clippy looked with; without them cargo would check zenoh and all below once more.
const DOCUMENTED: [&str; 6] =
    ["--lib", "--examples", "--bin=cosmic", "--bin=gateway-bench", "--bin=serve-emulated", "--bin=wan-demo"];

/// Runs their tests, those with python-can and a C compiler included, and those in a browser if there is
/// one or it may be installed.
pub(crate) fn test(workspace: &Workspace) -> Result<Tally> {
    setup::install_tools(&[Tool::Compiler])?;
    let python = venv::prepare(&workspace.target_dir().join("python-can"), &PYTHON_CAN)?;
    let mut command = workspace.cargo();
    command.args(["test", "--no-fail-fast"]).args(PACKAGES);
    command.args(["--", "--include-ignored"]).env("COSMIC_PYTHON", python);
    insist_on_browser(&mut command);
    step("testing what runs on Linux", || cargo_test(&mut command))
}

/// A missing browser is a failure of these tests, where one can be had.
fn insist_on_browser(command: &mut Command) {
    match setup::install_tools(&[Tool::Browser]) {
        Ok(()) => {
            command.env(BROWSER, "1");
        }
        Err(why) => eprintln!("the live page is not tried in a browser: {why:#}"),
    }
}

/// Builds programs of theirs as their tests are built, so that zenoh is not built once more for these.
pub(crate) fn build(workspace: &Workspace, programs: &[&str]) -> Result<()> {
    let mut command = workspace.cargo();
    command.arg("build").args(PACKAGES).arg("--tests");
    for program in programs {
        command.args(["--bin", program]);
    }
    step("building what runs on Linux, and its tests", || run::run(&mut command))
}

/// The command that runs one of their tests, built as `test` builds all.
pub(crate) fn one_test(workspace: &Workspace, name: &str) -> Command {
    let mut command = workspace.cargo();
    command.arg("test").args(PACKAGES).args(["--test", name]);
    command
}

/// The page of the demo that crosses gateways, in a browser: of these images, with this server of segments.
pub(crate) fn test_page_of_wan(
    workspace: &Workspace,
    cluster: &Path,
    images: &Path,
    server: &Path,
) -> Result<Tally> {
    let mut command = one_test(workspace, "page");
    command
        .env("COSMIC_WAN_CLUSTER", cluster)
        .env("COSMIC_WAN_IMAGES", images)
        .env("COSMIC_WAN_SERVER", server);
    insist_on_browser(&mut command);
    step("watching events cross, in a browser", || cargo_test(&mut command))
}

/// Clippy and documentation.
pub(crate) fn check(workspace: &Workspace) -> Result<Tally> {
    let mut clippy = workspace.cargo();
    clippy.args(["clippy", "--all-targets"]).args(PACKAGES).args(["--", "--deny", "warnings"]);
    step("clippy on what runs on Linux", || run::run(&mut clippy))?;
    // It is no default target.
    let mut of_machine = workspace.cargo();
    of_machine.arg("clippy").args(PACKAGES).args(["--test", "socketcan_vm", "--", "--deny", "warnings"]);
    step("clippy on the tests of SocketCAN", || run::run(&mut of_machine))?;
    let mut documentation = workspace.cargo();
    documentation.args(["doc", "--no-deps"]).args(PACKAGES).args(DOCUMENTED);
    documentation.env("RUSTDOCFLAGS", "--deny warnings");
    step("documentation of what runs on Linux", || run::run(&mut documentation))?;
    Ok(Tally::default())
}

/// With it a node exchanges frames, as with a client that others wrote.
const PYTHON_CAN: [&str; 2] = ["python-can==4.6.1", "pyserial==3.5"];
/// Tells the tests of the page to insist on a browser.
const BROWSER: &str = "COSMIC_BROWSER";
