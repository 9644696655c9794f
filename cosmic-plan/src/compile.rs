//! The planner as a build script calls it: what the cluster's description says is what is built.

use crate::analysis::advice::advice;
use crate::analysis::segment::assess;
use crate::cluster::Cluster;
use crate::document::file::read_text;
use crate::document::{Problems, Source};
use crate::output::{rust, text};
use crate::plan::relax::{relaxations, relaxations_of_the_largest};
use crate::plan::{Effort, NoPlan, plan};
use std::path::{Path, PathBuf};
use std::{env, fmt, fs, io};

/// The name of the file that [`cosmic_core::include_plan!`] includes.
const FILE: &str = "plan.rs";

/// The environment variable by which a program that calls cargo may tell what is in a description: a hash, a space, and
/// the full path of the file. A description that was written again, but is the same, is then no reason to build anew. By
/// the time of the file alone, which is all that cargo looks at, it is.
pub const CONTENT: &str = "COSMIC_CLUSTER_CONTENT";

/// Plans a cluster for the program whose build script calls this. The program then says
/// [`cosmic_core::include_plan!`].
///
/// ```no_run
/// // All of build.rs, but for `fn main`:
/// cosmic_plan::compile("cluster.toml");
/// ```
///
/// If there is no plan, or the file is wrong, or something in it does not hold, the build ends here with all that
/// is wrong: file, line, field and remedy.
pub fn compile(file: impl AsRef<Path>) {
    Config::default().compile(file);
}

/// As [`compile`], for a build script that has more to do with the error.
///
/// # Errors
/// See [`CompileError`].
pub fn try_compile(file: impl AsRef<Path>) -> Result<(), CompileError> {
    Config::default().try_compile(file)
}

/// How a cluster is compiled.
///
/// ```no_run
/// // The contents of the channels can then be logged.
/// cosmic_plan::Config::default().derive("defmt::Format").compile("cluster.toml");
/// ```
#[derive(Clone, Default, Debug)]
pub struct Config {
    derives: Vec<String>,
}

impl Config {
    /// The types of contents that the file describes derive this trait besides `Clone`, `Copy`, `PartialEq`, `Debug`,
    /// and `Eq` if they can. The program must know it.
    #[must_use]
    pub fn derive(mut self, path: &str) -> Self {
        self.derives.push(path.to_owned());
        self
    }

    /// See [`compile`].
    pub fn compile(&self, file: impl AsRef<Path>) {
        if let Err(error) = self.try_compile(file) {
            eprintln!("{error}");
            std::process::exit(1);
        }
    }

    /// See [`try_compile`].
    ///
    /// # Errors
    /// See [`CompileError`].
    pub fn try_compile(&self, file: impl AsRef<Path>) -> Result<(), CompileError> {
        try_to_compile(file.as_ref(), &self.derives)
    }
}

fn try_to_compile(file: &Path, derives: &[String]) -> Result<(), CompileError> {
    println!("cargo::rerun-if-env-changed={CONTENT}");
    if !is_followed(file, env::var(CONTENT).ok().as_deref()) {
        println!("cargo::rerun-if-changed={}", file.display());
    }
    let out = env::var_os("OUT_DIR").map(PathBuf::from).ok_or(CompileError::NoBuildScript)?;
    let text = read_text(file).map_err(|error| CompileError::Unreadable(file.into(), error))?;
    let source = Source::new(file.display().to_string(), text);
    let cluster = Cluster::read(&source).map_err(CompileError::Document)?;
    for other in &cluster.files {
        println!("cargo::rerun-if-changed={}", other.display());
    }
    let rendered = planned(file, &cluster, derives)?;
    let path = out.join(FILE);
    fs::write(&path, rendered).map_err(|error| CompileError::Unwritable(path, error))
}

/// Returns whether the variable [`CONTENT`] is about this file.
fn is_followed(file: &Path, content: Option<&str>) -> bool {
    let told = content.and_then(|content| content.split_once(' '));
    told.is_some_and(|(_, path)| file.canonicalize().is_ok_and(|file| file == Path::new(path)))
}

/// The text of the constants.
fn planned(file: &Path, cluster: &Cluster, derives: &[String]) -> Result<String, CompileError> {
    let effort = Effort::default();
    let plan = plan(cluster, &effort).map_err(|failure| {
        let ways_out = match &failure {
            NoPlan::Impossible(conflict) => relaxations(cluster, conflict, &effort),
            NoPlan::GaveUp { .. } => relaxations_of_the_largest(cluster, &effort),
        };
        CompileError::NoPlan(file.into(), text::of_failure(cluster, &failure) + &text::ways_out(&ways_out))
    })?;
    if let Err(faults) = crate::verify::verify(cluster, &plan) {
        let faults = faults.join("; ");
        let what = format!("the independent check refuses the plan: {faults}; please report this");
        return Err(CompileError::NoPlan(file.into(), what));
    }
    let assessment = assess(cluster, &plan);
    if !assessment.holds() {
        let helps = text::advice(&advice(cluster, &assessment, &effort));
        return Err(CompileError::Unproven(
            file.into(),
            text::summary(cluster, &plan, &assessment) + "\n" + &helps,
        ));
    }
    let name = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    rust::render(cluster, &plan, &name, derives).map_err(CompileError::NotRendered)
}

/// Why a cluster is not built.
#[derive(Debug)]
#[non_exhaustive]
pub enum CompileError {
    /// There is no `OUT_DIR`.
    NoBuildScript,
    /// The description cannot be read.
    Unreadable(PathBuf, io::Error),
    /// All that is wrong with the description.
    Document(Problems),
    /// There is no calendar, and why.
    NoPlan(PathBuf, String),
    /// A calendar exists, but not all deadlines hold.
    Unproven(PathBuf, String),
    /// The plan cannot be written as constants.
    NotRendered(rust::NotRendered),
    /// The constants cannot be written.
    Unwritable(PathBuf, io::Error),
}

impl fmt::Display for CompileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoBuildScript => write!(f, "OUT_DIR is not set: call this in a build script"),
            Self::Unreadable(file, error) => {
                let file = file.display();
                write!(f, "{file} cannot be read: {error}; give the path of a cluster file")
            }
            Self::Document(problems) => {
                let count = problems.list().len();
                let s = if count == 1 { "" } else { "s" };
                write!(f, "{problems}{count} problem{s}; nothing was built")
            }
            Self::NoPlan(file, what) => write!(f, "{}: {what}", file.display()),
            Self::Unproven(file, what) => {
                write!(f, "{}: {what}\n`cosmic-plan explain` shows what makes up a bound", file.display())
            }
            Self::NotRendered(error) => error.fmt(f),
            Self::Unwritable(file, error) => write!(f, "{} cannot be written: {error}", file.display()),
        }
    }
}

impl std::error::Error for CompileError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_file_that_a_caller_follows_is_followed() {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let (vehicle, rover) = (here.join("examples/vehicle.toml"), here.join("examples/rover.toml"));
        let told = format!("0123abcd {}", vehicle.canonicalize().unwrap().display());
        assert!(is_followed(&vehicle, Some(&told)));
        assert!(is_followed(&here.join("src/../examples/vehicle.toml"), Some(&told)));
        assert!(!is_followed(&rover, Some(&told)) && !is_followed(&vehicle, None));
        assert!(!is_followed(&here.join("none.toml"), Some("0123abcd none.toml")));
    }
}
