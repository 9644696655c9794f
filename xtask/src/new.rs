//! Makes a repository with the nodes of a cluster, as a user would have it: a copy of one of the `examples/`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};

use crate::workspace::Workspace;

/// Where to make it.
#[derive(Args)]
pub(crate) struct Options {
    /// A folder that does not exist yet, or is empty.
    directory: PathBuf,
    /// What is in it.
    #[arg(long, value_enum, default_value_t = Example::Robot)]
    example: Example,
}

/// A repository that can be copied.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Example {
    /// An arm, a controller and a panel, with a test that runs them on this machine.
    Robot,
    /// Nodes that find each other: a broker and its spare, probes that come and go, a lamp; with a test, too.
    Workshop,
    /// Six nodes whose contents stand in the description of the cluster, to be run by `cargo xtask demo --apps`.
    Rover,
}

/// Makes it, and says how to go on.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<()> {
    make(workspace, options.example, &options.directory)?;
    if options.example == Example::Rover {
        let folder = options.directory.display();
        println!("{folder} is a rover of six nodes. From this repository:");
        println!("  cargo xtask demo --apps {folder}     builds, runs and judges it");
        println!("There: cargo images builds, cargo flash --bin base flashes.");
        return Ok(());
    }
    if options.example == Example::Workshop {
        println!("{} is a cluster that configures itself. There:", options.directory.display());
        println!("  cargo test                 builds the images and runs them on an emulated cluster");
        println!("  cargo flash --bin desk     flashes one of them, by probe-rs");
        return Ok(());
    }
    println!("{} is a cluster of three nodes: arm, controller, panel. There:", options.directory.display());
    println!("  cargo run                  builds the images and runs them on an emulated cluster");
    println!("  cargo test                 the same, as a test");
    println!("  cargo flash --bin arm      flashes one of them, by probe-rs");
    println!("What they do is in src/bin/, who publishes what in cluster.toml.");
    Ok(())
}

/// Copies the example. Its dependencies on this repository are named by their full path, its other dependencies
/// have the versions that were tested here.
pub(crate) fn make(workspace: &Workspace, example: Example, directory: &Path) -> Result<()> {
    let is_taken = fs::read_dir(directory).is_ok_and(|mut entries| entries.next().is_some());
    if is_taken || directory.is_file() {
        bail!("{} is not empty; name a folder that does not exist yet", directory.display());
    }
    match example {
        Example::Robot => copy(&workspace.root().join("examples/robot"), directory)?,
        Example::Workshop => copy(&workspace.root().join("examples/workshop"), directory)?,
        Example::Rover => {
            copy(&workspace.root().join("examples/rover"), directory)?;
            let (from, to) = (workspace.root().join(ROVER), directory.join("cluster.toml"));
            fs::copy(&from, &to).with_context(|| format!("writing {}", to.display()))?;
        }
    }
    let manifest = directory.join(MANIFEST);
    let text = fs::read_to_string(&manifest).with_context(|| format!("reading {}", manifest.display()))?;
    write(&manifest, &with_paths(&text, workspace.root())?)?;
    lock(workspace, directory)
}

/// A repository depends on the versions that are tested here.
pub(crate) fn lock(workspace: &Workspace, directory: &Path) -> Result<()> {
    let lock = directory.join(LOCK);
    fs::copy(workspace.root().join(LOCK), &lock).with_context(|| format!("writing {}", lock.display()))?;
    Ok(())
}

/// The manifest, with full paths to the crates of this repository.
fn with_paths(manifest: &str, root: &Path) -> Result<String> {
    let root = root.to_str().context("the path of this repository is no text")?;
    // In a TOML string these stand for something else.
    if root.contains(['"', '\\']) {
        bail!("{root}: move this repository to a path without quotation marks and backslashes");
    }
    Ok(manifest.replace("path = \"../../", &format!("path = \"{root}/")))
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("making {}", to.display()))?;
    let entries = fs::read_dir(from).with_context(|| format!("reading {}", from.display()))?;
    for entry in entries {
        let entry = entry.with_context(|| format!("reading {}", from.display()))?;
        let name = entry.file_name();
        if NOT_COPIED.iter().any(|other| name == *other) {
            continue;
        }
        let (from, to) = (entry.path(), to.join(&name));
        if from.is_dir() {
            copy(&from, &to)?;
        } else {
            fs::copy(&from, &to).with_context(|| format!("writing {}", to.display()))?;
        }
    }
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

/// The planner's example is what the rover is built from.
const ROVER: &str = "cosmic-plan/examples/rover.toml";
const MANIFEST: &str = "Cargo.toml";
const LOCK: &str = "Cargo.lock";
/// What a build leaves behind.
const NOT_COPIED: [&str; 2] = ["target", LOCK];

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder for one test, removed at its end.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("cosmic-new-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&path);
            Self(path)
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn the_copy_is_whole_and_names_this_repository() {
        let scratch = Scratch::new("copy");
        let workspace = Workspace::find().unwrap();
        make(&workspace, Example::Robot, &scratch.0).unwrap();
        for file in ["cluster.toml", "memory.x", "build.rs", ".cargo/config.toml", "src/bin/arm.rs", LOCK] {
            assert!(scratch.0.join(file).is_file(), "{file} is missing");
        }
        assert!(!scratch.0.join("target").exists());
        let manifest = fs::read_to_string(scratch.0.join(MANIFEST)).unwrap();
        assert!(!manifest.contains("\"../"), "{manifest}");
        assert!(manifest.contains(&format!("{}/cosmic-rtic\"", workspace.root().display())), "{manifest}");
    }

    /// What the documentation promises: all of an application, in so many lines.
    #[test]
    fn an_application_has_at_most_60_lines() {
        for (example, programs) in [(Example::Robot, 3), (Example::Workshop, 5), (Example::Rover, 6)] {
            let scratch = Scratch::new("lines");
            make(&Workspace::find().unwrap(), example, &scratch.0).unwrap();
            let applications: Vec<_> = fs::read_dir(scratch.0.join("src/bin")).unwrap().flatten().collect();
            assert_eq!(applications.len(), programs, "{example:?}");
            for application in applications {
                let lines = fs::read_to_string(application.path()).unwrap().lines().count();
                assert!(lines <= 60, "{} has {lines} lines", application.path().display());
            }
        }
    }

    #[test]
    fn the_rover_has_a_program_for_each_node_of_its_description() {
        let scratch = Scratch::new("rover");
        make(&Workspace::find().unwrap(), Example::Rover, &scratch.0).unwrap();
        let cluster = fs::read_to_string(scratch.0.join("cluster.toml")).unwrap();
        let nodes = cluster.split("[[node]]\nname = \"").skip(1).map(|rest| rest.split('"').next().unwrap());
        let nodes: Vec<_> = nodes.collect();
        assert_eq!(nodes.len(), 6);
        for node in nodes {
            assert!(scratch.0.join("src/bin").join(node).with_extension("rs").is_file(), "{node}");
        }
    }

    #[test]
    fn what_is_there_is_not_overwritten() {
        let scratch = Scratch::new("taken");
        fs::create_dir_all(&scratch.0).unwrap();
        fs::write(scratch.0.join("mine"), "").unwrap();
        let error = make(&Workspace::find().unwrap(), Example::Robot, &scratch.0).unwrap_err();
        assert!(
            error.to_string().ends_with("is not empty; name a folder that does not exist yet"),
            "{error}"
        );
        assert_eq!(fs::read_dir(&scratch.0).unwrap().count(), 1);
    }
}
