//! The cluster that configures itself (`examples/workshop`), run behind the demo of the one that is planned as a whole.

use std::process::{Command, ExitCode};

use anyhow::Result;
use cosmic_commands::demo::Options;

use crate::demo;
use crate::images;
use crate::plan;
use crate::run::{self, step};
use crate::setup;
use crate::workspace::Workspace;

/// Runs the demo; of the example, the workshop behind it. The exit code is the worse one of the two.
pub(crate) fn behind_the_demo(workspace: &Workspace, arguments: &demo::Arguments) -> Result<ExitCode> {
    if !are_of_the_example(&arguments.all) {
        return demo::task(workspace, arguments);
    }
    let code = demo::run(workspace, &arguments.all)?;
    println!();
    Ok(ExitCode::from(code.max(run(workspace)?)))
}

/// Builds the images and the program that runs and judges them, starts it, and gives its exit code.
pub(crate) fn run(workspace: &Workspace) -> Result<u8> {
    let images = images::of_workshop(workspace, &setup::prepare(&[])?)?;
    let mut build = workspace.cargo();
    build.args(["build", "--release", "--package", "cosmic-demo", "--bin", "workshop"]);
    step("building the judge of the workshop", || run::run(&mut build))?;
    let mut workshop = Command::new(workspace.program("release", "workshop"));
    workshop.arg("--cluster").arg(workspace.root().join(images::WORKSHOP).join(plan::OF_A_REPOSITORY));
    run::code(workshop.arg("--images").arg(images))
}

/// Returns whether no other cluster is named. Of arguments that are wrong the demo says what is.
fn are_of_the_example(arguments: &[String]) -> bool {
    Options::read(arguments).is_ok_and(|options| {
        options.cluster.is_none()
            && options.apps.is_none()
            && options.images.is_none()
            && options.elf_files.is_empty()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_workshop_runs_behind_the_example_only() {
        let are =
            |words: &[&str]| are_of_the_example(&words.iter().map(|&it| it.to_owned()).collect::<Vec<_>>());
        assert!(are(&[]) && are(&["--load", "95", "--seconds", "2"]));
        for other in [
            &["--cluster", "a.toml"][..],
            &["--apps", "dir"],
            &["--images", "dir"],
            &["arm.elf"],
            &["--wan"],
            &["--help"],
        ] {
            assert!(!are(other), "{other:?}");
        }
    }
}
