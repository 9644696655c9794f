//! Runs the firmware on an emulated cluster.

use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};
use clap::Args;
use cosmic_commands::demo::Options;
use cosmic_commands::wan;

use crate::apps;
use crate::images;
use crate::linux;
use crate::plan;
use crate::run::{self, step};
use crate::setup;
use crate::tally::Tally;
use crate::workspace::Workspace;

/// What the demo is called with.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Arguments {
    /// `cargo xtask demo --help` and `cargo xtask demo --wan --help` list them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub(crate) all: Vec<String>,
}

/// Runs it. Its exit code is ours.
pub(crate) fn task(workspace: &Workspace, arguments: &Arguments) -> Result<ExitCode> {
    let (of_wan, others): (Vec<_>, Vec<_>) = arguments.all.iter().cloned().partition(|it| it == "--wan");
    let code = if of_wan.is_empty() { run(workspace, &others) } else { run_wan(workspace, &others) };
    code.map(ExitCode::from)
}

/// The demo of the gateway.
pub(crate) fn run_wan(workspace: &Workspace, arguments: &[String]) -> Result<u8> {
    let build = || {
        for package in ["cosmic-serve", "cosmic-wan-demo"] {
            let mut program = workspace.cargo();
            program.args(["build", "--package", package, "--bins"]);
            step(&format!("building {package}"), || run::run(&mut program))?;
        }
        Ok(())
    };
    run_wan_built(workspace, arguments, build)
}

fn run_wan_built(
    workspace: &Workspace,
    arguments: &[String],
    build: impl FnOnce() -> Result<()>,
) -> Result<u8> {
    let options = match wan::Options::read(arguments) {
        Ok(options) => options,
        Err(refusal) => {
            refusal.print().context("writing to the terminal")?;
            return Ok(u8::try_from(refusal.exit_code()).unwrap_or(1));
        }
    };
    let cluster = plan::find(options.cluster.unwrap_or_else(|| plan::example(workspace)))?;
    let images = match options.images {
        Some(images) => images,
        None => images::kept(workspace, &setup::prepare(&[])?, &cluster, None, &[])?.0,
    };
    build()?;
    let mut demo = Command::new(workspace.program("debug", WAN_DEMO));
    demo.arg("--cluster").arg(cluster).arg("--images").arg(images);
    demo.arg("--server").arg(workspace.program("debug", SERVER)).args(of_the_demo(arguments));
    run::code(&mut demo)
}

/// The demo of the gateway for some seconds. It judges itself: nothing stale, and what crosses, crosses. Then once more,
/// with its page in a browser.
pub(crate) fn short_wan(workspace: &Workspace) -> Result<Tally> {
    let out = workspace.target_dir().join("wan-demo-of-tests");
    let cluster = plan::find(plan::example(workspace))?;
    let images = images::kept(workspace, &setup::prepare(&[])?, &cluster, None, &[])?.0;
    let mut arguments: Vec<String> = SHORT.map(str::to_owned).into();
    for (option, path) in [("--out", &out), ("--cluster", &cluster), ("--images", &images)] {
        arguments.extend([option.to_owned(), path.display().to_string()]);
    }
    let build = || linux::build(workspace, &[WAN_DEMO, SERVER]);
    let mut tally = Tally::one(run_wan_built(workspace, &arguments, build)? == 0);
    tally.add(linux::test_page_of_wan(workspace, &cluster, &images, &workspace.program("debug", SERVER)));
    Ok(tally)
}

const WAN_DEMO: &str = "wan-demo";
const SERVER: &str = "serve-emulated";
const SHORT: [&str; 6] = ["--cut", "2", "--around", "1", "--rounds", "20"];

/// Runs ELF files that a user names. Their exit code is that of the demo.
pub(crate) fn run_elf_files(workspace: &Workspace, arguments: &Arguments) -> Result<ExitCode> {
    if Options::read(&arguments.all).is_ok_and(|options| options.elf_files.is_empty()) {
        eprintln!("error: name the ELF files of the nodes: `cargo xtask run [OPTIONS] <ELF>...`");
        return Ok(ExitCode::from(2));
    }
    task(workspace, arguments)
}

/// Builds the firmware and the demo, starts it, and gives its exit code.
pub(crate) fn run(workspace: &Workspace, arguments: &[String]) -> Result<u8> {
    // Before anything is installed or built.
    let options = match Options::read(arguments) {
        Ok(options) => options,
        Err(refusal) => {
            refusal.print().context("writing to the terminal")?;
            return Ok(u8::try_from(refusal.exit_code()).unwrap_or(1));
        }
    };
    let is_of_elf_files = !options.elf_files.is_empty();
    let cluster = plan::find(match (&options.cluster, &options.apps) {
        (Some(file), _) => file.clone(),
        (None, Some(apps)) => apps.join(plan::OF_A_REPOSITORY),
        (None, None) if is_of_elf_files => plan::OF_A_REPOSITORY.into(),
        (None, None) => plan::example(workspace),
    })?;
    let images = match (&options.images, &options.apps) {
        (Some(images), _) => Some(images.clone()),
        (None, Some(apps)) => Some(apps::build(&setup::prepare(&[])?, apps, &cluster, None)?.directory),
        (None, None) if is_of_elf_files => None,
        (None, None) => Some(images::kept(workspace, &setup::prepare(&[])?, &cluster, None, &[])?.0),
    };
    let mut program = workspace.cargo();
    program.args(["build", "--release", "--package", PACKAGE, "--bin", "demo"]);
    step("building the demo", || run::run(&mut program))?;
    // Not by `cargo run`, which would move it to the root of the repository: the files that it is to
    // write are named from where the user is.
    let mut demo = Command::new(workspace.program("release", "demo"));
    demo.arg("--cluster").arg(cluster);
    if let Some(images) = images {
        demo.arg("--images").arg(images);
    }
    demo.args(of_the_demo(arguments));
    run::code(&mut demo)
}

/// The arguments without those that say what to build.
fn of_the_demo(arguments: &[String]) -> Vec<String> {
    const OURS: [&str; 3] = ["--cluster", "--apps", "--images"];
    let mut others = Vec::new();
    let mut all = arguments.iter();
    while let Some(argument) = all.next() {
        if OURS.contains(&argument.as_str()) {
            all.next();
        } else if !OURS
            .iter()
            .any(|ours| argument.strip_prefix(ours).is_some_and(|rest| rest.starts_with('=')))
        {
            others.push(argument.clone());
        }
    }
    others
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
    fn what_is_built_is_taken_out_of_the_arguments() {
        let arguments = |list: &[&str]| list.iter().map(|&text| text.to_owned()).collect::<Vec<_>>();
        for given in [
            &["--seed", "2", "--cluster", "a.toml", "--json", "x", "--apps=y"][..],
            &["--seed", "2", "--images", "z", "--cluster=a.toml", "--json", "x"],
        ] {
            assert_eq!(of_the_demo(&arguments(given)), ["--seed", "2", "--json", "x"]);
        }
    }

    /// This workspace has nothing that could be built.
    #[test]
    fn wrong_options_are_refused_before_anything_is_built() {
        let workspace = Workspace::at("/nowhere/at/all");
        for arguments in [["--errors", "2"], ["--load", "-1"], ["--seconds", "1e-9"], ["--colour", "no"]] {
            assert_eq!(run(&workspace, &arguments.map(str::to_owned)).unwrap(), 2);
        }
        assert_eq!(run(&workspace, &["--help".to_owned()]).unwrap(), 0);
        assert_eq!(run_wan(&workspace, &["--cut".to_owned(), "0".to_owned()]).unwrap(), 2);
    }
}
