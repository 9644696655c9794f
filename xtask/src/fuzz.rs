//! Builds and runs the fuzz targets of the core, on the stable toolchain.
//!
//! They are a workspace of their own, with libFuzzer in it, which is built from source: all that is needed
//! besides Rust is a C++ compiler. What a target has learnt (its corpus) is kept among the build products, and
//! the next run goes on from there.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use cosmic_commands::number::within;

use crate::run::{self, step};
use crate::setup::{self, Tool};
use crate::tally::Tally;
use crate::workspace::Workspace;

/// What to fuzz, and for how long.
#[derive(Args)]
pub(crate) struct Options {
    /// For how many seconds each target runs.
    #[arg(long, default_value_t = 10, value_parser = within(1..=1_000_000_u32), allow_negative_numbers = true)]
    seconds: u32,

    /// Only these; all if none is named.
    targets: Vec<String>,
}

/// Runs the targets that are asked for.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<ExitCode> {
    Ok(run_targets(workspace, options)?.conclude())
}

/// Runs all targets for a moment: each counts as one test.
pub(crate) fn smoke(workspace: &Workspace) -> Result<Tally> {
    run_targets(workspace, &Options { seconds: SMOKE_SECONDS, targets: Vec::new() })
}

fn run_targets(workspace: &Workspace, options: &Options) -> Result<Tally> {
    let home = workspace.root().join(HOME);
    let targets = chosen(all_targets(&home)?, &options.targets)?;
    setup::install_tools(&[Tool::Compiler])?;
    let products = workspace.target_dir().join("fuzz");
    let host = host_triple()?;
    step("building the fuzz targets", || run::run(&mut build(workspace, &home, &products, &host)))?;
    let binaries = products.join(&host).join("release");
    let mut tally = Tally::default();
    for target in &targets {
        let fuzzed = step(&format!("fuzzing {target} for {} s", options.seconds), || {
            fuzz(&binaries, &products, target, options.seconds)
        });
        tally.add(fuzzed.map(|()| Tally { passed: 1, failed: 0 }));
    }
    Ok(tally)
}

/// The names of all targets, in order.
fn all_targets(home: &Path) -> Result<Vec<String>> {
    let directory = home.join("fuzz_targets");
    let reading = || format!("reading {}", directory.display());
    let mut names = Vec::new();
    for entry in fs::read_dir(&directory).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        if path.extension().is_some_and(|extension| extension == "rs") {
            names.extend(path.file_stem().and_then(|stem| stem.to_str()).map(str::to_owned));
        }
    }
    names.sort_unstable();
    Ok(names)
}

/// Those of all targets that are wanted.
fn chosen(all: Vec<String>, wanted: &[String]) -> Result<Vec<String>> {
    if let Some(unknown) = wanted.iter().find(|name| !all.contains(name)) {
        bail!("there is no fuzz target `{unknown}`; there are {}", all.join(", "));
    }
    Ok(if wanted.is_empty() { all } else { wanted.to_vec() })
}

/// The triple is named so that the flags do not reach build scripts.
fn build(workspace: &Workspace, home: &Path, products: &Path, host: &str) -> Command {
    let mut command = workspace.cargo();
    command.current_dir(home);
    command.args(["build", "--quiet", "--release", "--bins", "--target", host, "--target-dir"]).arg(products);
    command.env("RUSTFLAGS", FLAGS.join(" "));
    command.env_remove("CARGO_ENCODED_RUSTFLAGS");
    command
}

/// Runs one target. Its output is shown only if it fails.
fn fuzz(binaries: &Path, products: &Path, target: &str, seconds: u32) -> Result<()> {
    let (corpus, crashes) = (products.join("corpus").join(target), products.join("crashes"));
    for directory in [&corpus, &crashes] {
        fs::create_dir_all(directory).with_context(|| format!("creating {}", directory.display()))?;
    }
    let mut command = Command::new(binaries.join(target));
    command.arg(format!("-max_total_time={seconds}")).arg("-max_len=1024").arg("-timeout=10");
    command.arg(format!("-artifact_prefix={}/{target}-", crashes.display())).arg(&corpus);
    command.stdin(Stdio::null());
    let output = command.output().with_context(|| format!("`{}` cannot be started", run::line(&command)))?;
    let log = String::from_utf8_lossy(&output.stderr);
    if output.status.success() {
        println!("{target}: {}", summary(&log).unwrap_or("no summary"));
        return Ok(());
    }
    eprint!("{log}");
    let input = failing_input(&log).unwrap_or_else(|| crashes.clone());
    let binary = binaries.join(target);
    bail!("fuzz target `{target}` failed; `{} {}` repeats it", binary.display(), input.display())
}

/// The last line, as `Done 12345 runs in 11 second(s)`.
fn summary(log: &str) -> Option<&str> {
    log.lines().rev().find(|line| line.starts_with("Done "))
}

/// The file that libFuzzer has written the input to.
fn failing_input(log: &str) -> Option<PathBuf> {
    log.lines().rev().find_map(|line| line.split_once("Test unit written to ")).map(|(_, path)| path.into())
}

fn host_triple() -> Result<String> {
    let output = Command::new("rustc").arg("-vV").output().context("`rustc -vV` cannot be started")?;
    let version = String::from_utf8_lossy(&output.stdout);
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("`rustc -vV` names no host")?.to_owned())
}

/// Where the targets are.
const HOME: &str = "cosmic-core/fuzz";

const SMOKE_SECONDS: u32 = 3;

/// What cargo-fuzz sets, but for the address sanitizer, which needs a nightly compiler; the core has no
/// unsafe code.
const FLAGS: [&str; 7] = [
    "--cfg fuzzing",
    "-Cpasses=sancov-module",
    "-Ccodegen-units=1",
    "-Cllvm-args=-sanitizer-coverage-level=4",
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
    "-Cllvm-args=-sanitizer-coverage-pc-table",
    "-Cllvm-args=-sanitizer-coverage-trace-compares",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_target_is_a_binary_of_the_package() {
        let home = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(HOME);
        let manifest = fs::read_to_string(home.join("Cargo.toml")).unwrap();
        let targets = all_targets(&home).unwrap();
        assert!(targets.contains(&"node".to_owned()), "{targets:?}");
        for target in targets {
            assert!(manifest.contains(&format!("name = \"{target}\"")), "{target}");
        }
    }

    #[test]
    fn unknown_targets_are_named() {
        let all = || vec!["decode".to_owned(), "node".to_owned()];
        assert_eq!(chosen(all(), &[]).unwrap(), all());
        assert_eq!(chosen(all(), &["node".to_owned()]).unwrap(), ["node"]);
        let error = chosen(all(), &["nodes".to_owned()]).unwrap_err();
        assert_eq!(error.to_string(), "there is no fuzz target `nodes`; there are decode, node");
    }

    #[test]
    fn what_libfuzzer_prints_is_understood() {
        let log = "#2\tINITED\nDone 17 runs in 3 second(s)\n";
        assert_eq!(summary(log), Some("Done 17 runs in 3 second(s)"));
        let log = "artifact_prefix='/t/'; Test unit written to /t/node-crash-1\nBase64: AA==\n";
        assert_eq!(failing_input(log), Some("/t/node-crash-1".into()));
    }

    #[test]
    fn a_target_that_fails_is_an_error_with_the_way_to_repeat_it() {
        let products = std::env::temp_dir().join(format!("cosmic-fuzz-{}", std::process::id()));
        // `false` takes any arguments, and fails.
        let error = fuzz(Path::new("/bin"), &products, "false", 1).unwrap_err();
        assert!(error.to_string().starts_with("fuzz target `false` failed; `/bin/false "), "{error}");
        fuzz(Path::new("/bin"), &products, "true", 1).unwrap();
        fs::remove_dir_all(products).unwrap();
    }
}
