//! Environments of Python among the build products, with packages of fixed versions.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};

use crate::run::{self, step};
use crate::setup::{self, Tool};

/// A Python with these packages, in an environment in this folder. One that is there with the same packages is used as it
/// is.
///
/// # Errors
/// What is missing and cannot be installed here, and what to type.
pub(crate) fn prepare(folder: &Path, packages: &[&str]) -> Result<PathBuf> {
    setup::install_tools(&[Tool::Python])?;
    let python = folder.join("bin/python");
    let stamp = folder.join("cosmic-packages");
    let wanted = packages.join("\n");
    if fs::read_to_string(&stamp).is_ok_and(|present| present == wanted) && python.exists() {
        return Ok(python);
    }
    let names: Vec<&str> = packages.iter().filter_map(|package| package.split('=').next()).collect();
    step(&format!("installing {}", names.join(", ")), || {
        run::run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(folder))
            .context("Python cannot make an environment: install Debian's `python3-venv`")?;
        run::run(pip(&python).args(["install", "--quiet"]).args(packages))
            .with_context(|| format!("type `{} -m pip install {}`", python.display(), packages.join(" ")))
    })?;
    fs::write(&stamp, wanted).with_context(|| format!("{} cannot be written", stamp.display()))?;
    Ok(python)
}

pub(crate) fn pip(python: &Path) -> Command {
    let mut pip = Command::new(python);
    pip.args(["-m", "pip", "--disable-pip-version-check"]);
    pip
}
