//! Programs for the target: how cargo builds them, and where they are.

use std::collections::BTreeMap;
use std::fs;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};
use serde_json::Value;

use crate::board::{self, Board};
use crate::new;
use crate::plan;
use crate::run::{self, step};
use crate::setup;
use crate::target::TargetWay;
use crate::workspace::{self, Workspace};

/// The images of one package, by name.
pub(crate) type Images = BTreeMap<String, PathBuf>;

/// What a build gave.
pub(crate) struct Built {
    /// The programs, by name.
    pub(crate) images: Images,
    /// How many of them were compiled, and not found up to date.
    pub(crate) compiled: usize,
    /// Warnings about our own packages.
    pub(crate) warnings: usize,
}

impl Built {
    /// Where the images are.
    pub(crate) fn directory(&self) -> Option<&Path> {
        self.images.values().next()?.parent()
    }
}

/// Builds images of the example's firmware, for its own cluster or another one, and for a board: all if none is named.
fn for_board(
    workspace: &Workspace,
    way: &TargetWay,
    cluster: &Path,
    board: Option<Board>,
    names: &[String],
) -> Result<Built> {
    step(&format!("building the firmware images for {}", cluster.display()), || {
        let mut command = way.cargo(workspace, "build");
        command.env(plan::VARIABLE, cluster);
        match board.and_then(Board::built_as) {
            Some(board) => command.env(board::VARIABLE, board),
            None => command.env_remove(board::VARIABLE),
        };
        plan::follow(&mut command, cluster)?;
        build(command, "firmware", PROFILE, names)
    })
}

/// Builds all images of the example's firmware.
pub(crate) fn of_example(workspace: &Workspace, way: &TargetWay) -> Result<Built> {
    for_board(workspace, way, &plan::find(plan::example(workspace))?, None, &[])
}

/// Builds the nodes whose size is a goal, with these features.
pub(crate) fn small(workspace: &Workspace, way: &TargetWay, features: &[&str]) -> Result<Built> {
    step("building the small images", || {
        let mut command = way.cargo(workspace, "build");
        command.arg(format!("--features={}", features.join(",")));
        build(command, SMALL, PROFILE_OF_SMALL, &[])
    })
}

/// The images whose size is measured: those of the example's firmware, and the small ones but for the hub.
pub(crate) fn measured(workspace: &Workspace, way: &TargetWay) -> Result<Images> {
    let mut images = of_example(workspace, way)?.images;
    images.extend(small(workspace, way, &[])?.images.into_iter().filter(|(name, _)| name != "hub"));
    Ok(images)
}

/// The images that are searched for panics: of each it can be told what it says, which in a small one costs flash. The
/// small ones stand where those without messages do, until these are built again.
pub(crate) fn searched(workspace: &Workspace, way: &TargetWay) -> Result<Images> {
    let mut images = of_example(workspace, way)?.images;
    images.extend(small(workspace, way, &["last-words"])?.images);
    Ok(images)
}

/// Builds images as [`for_board`] does, and keeps a copy of them in a folder of the cluster's own: the next build, for
/// another cluster, leaves it alone. Returns the folder, too.
pub(crate) fn kept(
    workspace: &Workspace,
    way: &TargetWay,
    cluster: &Path,
    board: Option<Board>,
    names: &[String],
) -> Result<(PathBuf, Built)> {
    let mut built = for_board(workspace, way, cluster, board, names)?;
    let folder = board::folder(workspace, cluster, board);
    keep(&mut built, &folder)?;
    Ok((folder, built))
}

/// Builds the images of the workshop, where it stands in the repository, and keeps a copy of them. Returns where.
pub(crate) fn of_workshop(workspace: &Workspace, way: &TargetWay) -> Result<PathBuf> {
    let example = workspace.root().join(WORKSHOP);
    // It is a workspace of its own.
    new::lock(workspace, &example)?;
    let cluster = plan::find(example.join(plan::OF_A_REPOSITORY))?;
    let theirs = Workspace::of(&workspace::metadata(&example)?)?.building_in(Some(workspace.target_dir()));
    let mut built = step("building the images of the workshop", || {
        let mut command = way.cargo(&theirs, "build");
        command.env("CARGO_TARGET_DIR", way.target_dir(&theirs));
        plan::follow(&mut command, &cluster)?;
        build(command, "workshop", PROFILE, &[])
    })?;
    let folder = board::folder(workspace, &cluster, None);
    keep(&mut built, &folder)?;
    Ok(folder)
}

/// Copies images into a folder, and names the copies instead.
fn keep(built: &mut Built, folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    for (name, image) in &mut built.images {
        let copy = folder.join(name);
        fs::copy(&image, &copy).with_context(|| format!("writing {}", copy.display()))?;
        *image = copy;
    }
    Ok(())
}

/// These ELF files, by their paths; if there are none, those that `build` gives.
pub(crate) fn given_or_built(
    workspace: &Workspace,
    files: &[PathBuf],
    build: fn(&Workspace, &TargetWay) -> Result<Images>,
) -> Result<Images> {
    if files.is_empty() {
        return build(workspace, &setup::prepare(&[])?);
    }
    Ok(files.iter().map(|file| (file.display().to_string(), file.clone())).collect())
}

/// Builds programs of a package by a call of [`TargetWay::cargo`]: all if none is named.
///
/// Cargo shows a warning about a package of the workspace again when it has nothing to compile, so that
/// the count is that of the code as it stands.
pub(crate) fn build(mut command: Command, package: &str, profile: &str, names: &[String]) -> Result<Built> {
    command.args(["--package", package, "--profile", profile]);
    let in_colour = std::io::stderr().is_terminal();
    command.arg(if in_colour {
        "--message-format=json-diagnostic-rendered-ansi"
    } else {
        "--message-format=json"
    });
    if names.is_empty() {
        command.arg("--bins");
    }
    for name in names {
        command.args(["--bin", name]);
    }
    let mut built = Built { images: Images::new(), compiled: 0, warnings: 0 };
    let status = run::lines(&mut command, |line| match CargoLine::parse(line) {
        Some(CargoLine::Image { name, path, is_fresh }) => {
            built.compiled += usize::from(!is_fresh);
            built.images.insert(name, path);
        }
        Some(CargoLine::Diagnostic { text, is_warning }) => {
            eprint!("{text}");
            built.warnings += usize::from(is_warning);
        }
        None => {}
    })?;
    if !status.success() {
        bail!("building `{package}` for the target failed; see above");
    }
    Ok(built)
}

/// What matters of a line of cargo's.
#[derive(PartialEq, Eq, Debug)]
enum CargoLine {
    /// A program was built, or is up to date.
    Image { name: String, path: PathBuf, is_fresh: bool },
    /// The compiler has something to say.
    Diagnostic { text: String, is_warning: bool },
}

impl CargoLine {
    fn parse(line: &str) -> Option<Self> {
        let value: Value = serde_json::from_str(line).ok()?;
        match value["reason"].as_str()? {
            "compiler-artifact" => {
                let path = value["executable"].as_str()?;
                // A build script is an executable too, but of the host.
                let is_program = value["target"]["kind"].as_array()?.iter().any(|kind| kind == "bin");
                let name = value["target"]["name"].as_str()?;
                let is_fresh = value["fresh"] == true;
                is_program.then(|| Self::Image { name: name.into(), path: path.into(), is_fresh })
            }
            "compiler-message" => {
                let message = &value["message"];
                let text = message["rendered"].as_str()?.to_owned();
                // The summary "1 warning emitted" has no place in the code.
                let is_warning = message["level"] == "warning" && message["spans"] != serde_json::json!([]);
                Some(Self::Diagnostic { text, is_warning })
            }
            _ => None,
        }
    }
}

/// The package of images that misbehave on purpose.
pub(crate) const TRIALS: &str = "trials";

/// The cluster that configures itself.
pub(crate) const WORKSHOP: &str = "examples/workshop";

/// The profile of what is flashed, in the workspace's manifest.
pub(crate) const PROFILE: &str = "firmware";
/// The package of the nodes whose size is a goal.
pub(crate) const SMALL: &str = "small";
/// The profile of the nodes whose size is a goal.
pub(crate) const PROFILE_OF_SMALL: &str = "firmware-small";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_found_in_cargos_messages() {
        let line = r#"{"reason":"compiler-artifact","target":{"kind":["bin"],"name":"sensor"},
            "executable":"/t/sensor","fresh":true}"#;
        let image = CargoLine::Image { name: "sensor".into(), path: "/t/sensor".into(), is_fresh: true };
        assert_eq!(CargoLine::parse(line), Some(image));
        let script = r#"{"reason":"compiler-artifact","target":{"kind":["custom-build"],"name":"b"},
            "executable":"/t/build-script-build"}"#;
        assert_eq!(CargoLine::parse(script), None);
        assert_eq!(CargoLine::parse("no JSON"), None);
    }

    #[test]
    fn warnings_are_told_from_their_summary() {
        let warning = r#"{"reason":"compiler-message","message":{"rendered":"w","level":"warning",
            "spans":[{"file_name":"a.rs"}]}}"#;
        let expected = CargoLine::Diagnostic { text: "w".into(), is_warning: true };
        assert_eq!(CargoLine::parse(warning), Some(expected));
        let summary = r#"{"reason":"compiler-message","message":{"rendered":"1 warning emitted",
            "level":"warning","spans":[]}}"#;
        let expected = CargoLine::Diagnostic { text: "1 warning emitted".into(), is_warning: false };
        assert_eq!(CargoLine::parse(summary), Some(expected));
    }
}
