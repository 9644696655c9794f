//! Runs the firmware on an emulated cluster.

use std::env::consts::EXE_SUFFIX;
use std::path::PathBuf;
use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};
use clap::Args;
use cosmic_commands::demo::Options;

use crate::images;
use crate::plan;
use crate::run::{self, step};
use crate::setup;
use crate::workspace::Workspace;

/// What the demo is called with.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Arguments {
    /// `--cluster FILE` builds for another cluster; all else is passed on to the demo, and
    /// `cargo xtask demo --help` lists it.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub(crate) all: Vec<String>,
}

/// Runs it. Its exit code is ours.
pub(crate) fn task(workspace: &Workspace, arguments: &Arguments) -> Result<ExitCode> {
    run(workspace, &arguments.all).map(ExitCode::from)
}

/// Builds the firmware and the demo, starts it, and gives its exit code.
pub(crate) fn run(workspace: &Workspace, arguments: &[String]) -> Result<u8> {
    let (cluster, arguments) = take_cluster(arguments)?;
    // Before anything is installed or built.
    if let Err(refusal) = Options::check(&arguments) {
        refusal.print().context("writing to the terminal")?;
        return Ok(u8::try_from(refusal.exit_code()).unwrap_or(1));
    }
    let cluster = cluster.as_deref().map(plan::find).transpose()?;
    let way = setup::prepare(&[])?;
    let built = images::firmware(workspace, &way, cluster.as_deref(), &[])?;
    let directory = built.directory().context("the firmware has no images")?;
    let mut program = workspace.cargo();
    program.args(["build", "--release", "--package", PACKAGE, "--bin", "demo"]);
    program.envs(cluster.map(|file| (plan::VARIABLE, file)));
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

/// The file behind `--cluster`, and the arguments that are the demo's own.
fn take_cluster(arguments: &[String]) -> Result<(Option<PathBuf>, Vec<String>)> {
    let (mut cluster, mut others) = (None, Vec::new());
    let mut all = arguments.iter();
    while let Some(argument) = all.next() {
        if argument == "--cluster" {
            let file = all.next().context("--cluster wants the file of a cluster behind it")?;
            cluster = Some(PathBuf::from(file));
        } else if let Some(file) = argument.strip_prefix("--cluster=") {
            cluster = Some(PathBuf::from(file));
        } else {
            others.push(argument.clone());
        }
    }
    Ok((cluster, others))
}

/// The package of the demo.
const PACKAGE: &str = "cosmic-demo";

/// What cargo is to test of the emulated cluster and the demo. The feature compares the processor core with
/// another emulator.
pub(crate) const EMULATED_TESTS: [&str; 6] =
    ["--package", "cosmic-emu", "--package", PACKAGE, "--features", "cosmic-emu/unicorn"];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cluster_is_taken_out_of_the_arguments() {
        let arguments = |list: &[&str]| list.iter().map(|&text| text.to_owned()).collect::<Vec<_>>();
        for given in [
            &["--seed", "2", "--cluster", "a.toml", "--json", "x"][..],
            &["--seed", "2", "--cluster=a.toml", "--json", "x"],
        ] {
            let (cluster, others) = take_cluster(&arguments(given)).unwrap();
            assert_eq!(cluster, Some(PathBuf::from("a.toml")));
            assert_eq!(others, ["--seed", "2", "--json", "x"]);
        }
        assert!(take_cluster(&arguments(&["--cluster"])).is_err());
        assert_eq!(take_cluster(&[]).unwrap(), (None, Vec::new()));
    }

    /// This workspace has nothing that could be built.
    #[test]
    fn wrong_options_are_refused_before_anything_is_built() {
        let workspace = Workspace::at("/nowhere/at/all");
        for arguments in [["--errors", "2"], ["--load", "-1"], ["--seconds", "1e-9"], ["--colour", "no"]] {
            assert_eq!(run(&workspace, &arguments.map(str::to_owned)).unwrap(), 2);
        }
        assert_eq!(run(&workspace, &["--help".to_owned()]).unwrap(), 0);
    }
}
