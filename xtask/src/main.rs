//! The tasks of this repository: `cargo xtask --help`.
//!
//! Everything that CI does is one of these, and runs the same on a desk.

mod apps;
mod apt;
mod bench;
mod bit_rates;
mod board;
mod build;
mod cargo_test;
mod ci;
mod demo;
mod experiment;
mod flash;
mod fuzz;
mod guide;
mod images;
mod linux;
mod new;
mod panics;
mod plan;
mod program;
mod python;
mod qemu;
mod run;
mod setup;
mod size;
mod socketcan;
mod suite;
mod tally;
mod target;
mod tools;
mod venv;
mod walk;
mod workshop;
mod workspace;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use workspace::Workspace;

/// Build, test and demonstrate COSMIC.
///
/// Each task installs what it lacks before it starts, where it may; `setup` installs everything.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Find or install the compiler's Cortex-M target, QEMU, cmake, libclang, Wireshark and cantools.
    Setup,
    /// Build the firmware images and print their sizes.
    Build(build::Options),
    /// Run the firmware on an emulated cluster and show what each channel did.
    Demo(demo::Arguments),
    /// Run ELF files of your own on an emulated cluster, and judge them: one for each node of cluster.toml here, or of the
    /// --cluster FILE.
    Run(demo::Arguments),
    /// Measure scheduling, clocks and speed on the simulated bus, and the gateway; see docs/experiments.md.
    Experiment(experiment::Options),
    /// Run all tests: on the host, on Linux links, in the emulated cluster, in QEMU.
    Test(suite::Options),
    /// Count the instructions of the hot paths on a Cortex-M4F, and compare them with their limits.
    Bench(bench::Options),
    /// Print flash and RAM of each image, and the share of the middleware.
    Size(size::Options),
    /// Flash an image that was built onto a board, and start it.
    Flash(flash::Options),
    /// Show the log of a board that runs such an image.
    Attach(flash::Options),
    /// List the places of each image that can end in a panic.
    Panics(panics::Options),
    /// Everything that must hold before a change goes in.
    Ci,
    /// Make a repository of your own: a cluster of two nodes that runs at once.
    New(new::Options),
    /// Feed the decoders and whole nodes what no node would send; needs a C++ compiler.
    Fuzz(fuzz::Options),
}

fn main() -> ExitCode {
    let task = Arguments::parse().task;
    match Workspace::find().and_then(|workspace| perform(task, &workspace)) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn perform(task: Task, workspace: &Workspace) -> anyhow::Result<ExitCode> {
    match task {
        Task::Setup => {
            let way = setup::prepare(&setup::EVERYTHING)?;
            tools::prepare(workspace)?;
            println!("All there. The Cortex-M target comes from {way}.");
        }
        Task::Build(options) => build::task(workspace, &options)?,
        Task::Demo(options) => return workshop::behind_the_demo(workspace, &options),
        Task::Run(options) => return demo::run_elf_files(workspace, &options),
        Task::Experiment(options) => return experiment::task(workspace, &options),
        Task::Test(options) => return suite::task(workspace, &options),
        Task::Bench(options) => return bench::task(workspace, &options),
        Task::Size(options) => size::task(workspace, &options)?,
        Task::Flash(options) => return flash::task(workspace, &options, flash::Act::Flash),
        Task::Attach(options) => return flash::task(workspace, &options, flash::Act::Attach),
        Task::Panics(options) => panics::task(workspace, &options)?,
        Task::Ci => return ci::task(workspace),
        Task::New(options) => new::task(workspace, &options)?,
        Task::Fuzz(options) => return fuzz::task(workspace, &options),
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn the_demo_gets_its_arguments_unchanged() {
        let arguments = ["cargo xtask", "demo", "--seconds", "5", "--help"];
        let Task::Demo(options) = Arguments::try_parse_from(arguments).unwrap().task else {
            panic!("another task");
        };
        assert_eq!(options.all, ["--seconds", "5", "--help"]);
    }
}
