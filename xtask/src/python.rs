//! The Python package `cosmic_can`: built as a wheel, installed into an environment of its own, and tested there.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::run::{self, step};
use crate::tally::Tally;
use crate::venv;
use crate::workspace::Workspace;

/// Builds the wheel, installs it as a user would, and runs its tests; the types are checked, too. Counts as one test for
/// each of these, since pytest counts its own.
pub(crate) fn test(workspace: &Workspace) -> Result<Tally> {
    let folder = workspace.target_dir().join("python");
    let python = venv::prepare(&folder.join("venv"), &PACKAGES)?;
    let package = workspace.root().join("linux/python");
    let wheel = step("building the wheel", || build(&python, &package, &folder))?;
    step("installing the wheel", || {
        let mut install = venv::pip(&python);
        run::run(install.args(["install", "--quiet", "--force-reinstall", "--no-deps"]).arg(wheel))
    })?;
    let mut tally = Tally::default();
    tally.add(step("testing the Python package", || {
        let mut tests = Command::new(&python);
        tests.args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]).current_dir(&package);
        run::run(tests.env("PYTHONDONTWRITEBYTECODE", "1")).map(|()| Tally::one(true))
    }));
    tally.add(step("checking the types of the Python package", || {
        let mut types = Command::new(&python);
        types.args(["-m", "mypy", "--strict", "--package", "cosmic_can", "--cache-dir"]);
        types.arg(folder.join("mypy")).current_dir(&folder);
        run::run(&mut types)?;
        let mut types = Command::new(&python);
        types.args(["-m", "mypy", "--strict", "--cache-dir"]).arg(folder.join("mypy"));
        types.args(["move_joint.py", "print_events.py", "watch_two.py"]);
        types.current_dir(workspace.root().join("examples/python"));
        run::run(&mut types).map(|()| Tally::one(true))
    }));
    Ok(tally)
}

/// Formatting and clippy of its part in Rust, which is in a workspace of its own.
pub(crate) fn check(workspace: &Workspace) -> Result<Tally> {
    let mut format = workspace.cargo();
    format.args(["fmt", "--check"]);
    let mut clippy = workspace.cargo();
    // In the profile of the wheel: what it depends on is compiled once.
    clippy.args(["clippy", "--release", "--locked", "--all-targets", "--", "--deny", "warnings"]);
    for command in [&mut format, &mut clippy] {
        command.current_dir(workspace.root().join("linux/python"));
        command.env("CARGO_TARGET_DIR", workspace.target_dir().join("python"));
        step("clippy on the Python package", || run::run(command))?;
    }
    Ok(Tally::default())
}

/// Builds the wheel, and finds it.
fn build(python: &Path, package: &Path, folder: &Path) -> Result<PathBuf> {
    let out = folder.join("wheels");
    // An older one would be found, too.
    let _ = fs::remove_dir_all(&out);
    let mut maturin = Command::new(python);
    maturin.args(["-m", "maturin", "build", "--release", "--locked", "--quiet", "--out"]).arg(&out);
    run::run(maturin.current_dir(package).env("CARGO_TARGET_DIR", folder))?;
    let wheels = fs::read_dir(&out).with_context(|| format!("{} cannot be read", out.display()))?;
    let found = wheels
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.extension().is_some_and(|extension| extension == "whl"));
    found.map_or_else(|| bail!("maturin has left no wheel in {}", out.display()), Ok)
}

/// As the tests need them; pyproject.toml says what a user needs to build.
const PACKAGES: [&str; 9] = [
    "maturin==1.16.0",
    "pytest==9.2.0",
    "pandas==3.1.1",
    "polars==2.1.0",
    "matplotlib==3.11.2",
    "nbclient==0.11.0",
    "nbformat==5.11.1",
    "ipykernel==7.4.0",
    "mypy==2.4.1",
];
