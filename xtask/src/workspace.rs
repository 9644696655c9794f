//! Where things are.

use std::env;
use std::env::consts::EXE_SUFFIX;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};

/// The repository, and the directory of build products.
#[derive(Debug)]
pub(crate) struct Workspace {
    root: PathBuf,
    target_dir: PathBuf,
}

impl Workspace {
    /// Asks cargo for the workspace that this program was called for. That is not always the one it was built
    /// in: clones that share a folder of build products share this program, too.
    pub(crate) fn find() -> Result<Self> {
        // `cargo run` names the folder of the manifest; who starts the program by hand stands somewhere.
        let folder = env::var_os("CARGO_MANIFEST_DIR").map_or_else(env::current_dir, |it| Ok(it.into()));
        Self::around(&folder.context("the current directory cannot be read")?)
    }

    /// The workspace that a folder belongs to.
    fn around(folder: &Path) -> Result<Self> {
        let workspace = Self::of(&metadata(folder)?)?;
        if !workspace.root.join("xtask/Cargo.toml").is_file() {
            bail!("{} is not the workspace of COSMIC; call this inside it", workspace.root.display());
        }
        Ok(workspace)
    }

    /// Any workspace, by what cargo says of it.
    pub(crate) fn of(metadata: &serde_json::Value) -> Result<Self> {
        let path = |key: &str| {
            metadata[key].as_str().map(PathBuf::from).context("cargo does not say where it builds")
        };
        Ok(Self { root: path("workspace_root")?, target_dir: path("target_directory")? })
    }

    /// The same, with another folder of build products, if one is named.
    pub(crate) fn building_in(self, target_dir: Option<&Path>) -> Self {
        Self { target_dir: target_dir.map_or(self.target_dir, Path::to_owned), ..self }
    }

    /// One that is not there, for tests of what must not touch it.
    #[cfg(test)]
    pub(crate) fn at(root: &str) -> Self {
        Self { root: root.into(), target_dir: Path::new(root).join("target") }
    }

    /// The top of the repository.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// Where cargo puts what it builds for the host.
    pub(crate) fn target_dir(&self) -> &Path {
        &self.target_dir
    }

    /// A program of ours, as built in this profile.
    pub(crate) fn program(&self, profile: &str, name: &str) -> PathBuf {
        self.target_dir().join(profile).join(format!("{name}{EXE_SUFFIX}"))
    }

    /// A call of cargo in the root of the repository.
    pub(crate) fn cargo(&self) -> Command {
        let mut command = Command::new(cargo());
        command.current_dir(&self.root);
        env::vars_os().map(|(name, _)| name).filter(|name| is_of_this_program(name)).for_each(|name| {
            command.env_remove(name);
        });
        command
    }
}

/// Cargo tells a program that it runs of which package it is. Build scripts take that for a change: what depends on them,
/// zenoh among it, would be built once for who calls cargo and once more for who calls `cargo xtask`.
fn is_of_this_program(variable: &OsStr) -> bool {
    let variable = variable.to_string_lossy();
    variable.starts_with("CARGO_PKG_") || variable.starts_with("CARGO_MANIFEST_")
}

/// What cargo says of the workspace that a folder belongs to.
pub(crate) fn metadata(folder: &Path) -> Result<serde_json::Value> {
    let output = Command::new(cargo())
        .args(["metadata", "--no-deps", "--format-version", "1"])
        .current_dir(folder)
        .output()
        .with_context(|| format!("`cargo metadata` cannot be started in {}", folder.display()))?;
    serde_json::from_slice(&output.stdout)
        .with_context(|| format!("{} is in no workspace of cargo's", folder.display()))
}

/// The cargo that started this program, or else the one on the PATH.
fn cargo() -> OsString {
    env::var_os("CARGO").unwrap_or_else(|| "cargo".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// The least that cargo takes for a workspace with this program in it.
    fn clone(at: &Path) {
        for folder in ["xtask/src", "deep/below"] {
            fs::create_dir_all(at.join(folder)).unwrap();
        }
        fs::write(at.join("Cargo.toml"), "[workspace]\nmembers = [\"xtask\"]\n").unwrap();
        fs::write(at.join("xtask/Cargo.toml"), "[package]\nname = \"xtask\"\n").unwrap();
        fs::write(at.join("xtask/src/main.rs"), "fn main() {}\n").unwrap();
    }

    /// The tests are run by cargo, as the program is: it has told them of which package they are.
    #[test]
    fn cargo_is_called_as_by_a_person() {
        assert!(env::vars_os().any(|(name, _)| name == "CARGO_PKG_NAME"));
        let command = Workspace::at("/").cargo();
        let removed =
            |wanted: &str| command.get_envs().any(|(name, value)| name == wanted && value.is_none());
        assert!(removed("CARGO_PKG_NAME") && removed("CARGO_MANIFEST_DIR"));
        assert!(!removed("PATH"));
    }

    #[test]
    fn each_clone_is_its_own_workspace() {
        let directory = env::temp_dir().join(format!("xtask-clones-{}", std::process::id()));
        let _ = fs::remove_dir_all(&directory);
        fs::create_dir_all(&directory).unwrap();
        let directory = directory.canonicalize().unwrap();
        for name in ["one", "other"] {
            let root = directory.join(name);
            clone(&root);
            for folder in [&root, &root.join("xtask"), &root.join("deep/below")] {
                assert_eq!(Workspace::around(folder).unwrap().root(), root);
            }
        }
        let error = Workspace::around(&directory).unwrap_err().to_string();
        assert_eq!(error, format!("{} is in no workspace of cargo's", directory.display()));
        fs::remove_file(directory.join("one/xtask/Cargo.toml")).unwrap();
        fs::write(directory.join("one/Cargo.toml"), "[workspace]\n").unwrap();
        let error = Workspace::around(&directory.join("one")).unwrap_err().to_string();
        assert!(error.contains("is not the workspace of COSMIC"), "{error}");
        fs::remove_dir_all(directory).unwrap();
    }
}
