//! Runs the firmware on an emulated cluster.

use std::env::consts::EXE_SUFFIX;
use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};
use clap::Args;

use crate::build;
use crate::run::{self, step};
use crate::setup;
use crate::workspace::Workspace;

/// What the demo is called with.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Options {
    /// Passed on to the demo: `cargo xtask demo --help` lists them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub(crate) arguments: Vec<String>,
}

/// Runs it. Its exit code is ours.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<ExitCode> {
    run(workspace, &options.arguments).map(ExitCode::from)
}

/// Builds the firmware and the demo, starts it, and gives its exit code.
pub(crate) fn run(workspace: &Workspace, arguments: &[String]) -> Result<u8> {
    let way = setup::prepare(&[])?;
    let built = build::firmware(workspace, &way)?;
    let directory = built.directory().context("the firmware has no images")?;
    let mut program = workspace.cargo();
    program.args(["build", "--release", "--package", PACKAGE, "--bin", "demo"]);
    step("building the demo", || run::run(&mut program))?;
    // Not by `cargo run`, which would move it to the root of the repository: the files that it is to
    // write are named from where the user is.
    let program = workspace.target_dir().join("release").join(format!("demo{EXE_SUFFIX}"));
    let mut demo = Command::new(program);
    demo.arg("--images").arg(directory).args(arguments);
    let status = run::status(&mut demo)?;
    // Ended by a signal, it has no code.
    Ok(status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(1))
}

/// The package of the emulated cluster.
pub(crate) const PACKAGE: &str = "cosmic-emu";

/// Its feature that compares its processor core with another emulator, for tests.
pub(crate) const COMPARISON: &str = "unicorn";
