//! Builds the applications of a user's repository, as it would be flashed.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use serde_json::Value;

use crate::images::{self, PROFILE};
use crate::plan;
use crate::run::step;
use crate::target::{TRIPLE, TargetWay};
use crate::workspace::{self, Workspace};

/// What was built.
pub(crate) struct Apps {
    /// Where the images are.
    pub(crate) directory: PathBuf,
    /// How many of them were compiled, and not found up to date.
    pub(crate) compiled: usize,
}

/// Builds all programs of the repository around `folder` that are named like a node of the cluster, with the feature
/// that has them observed, if they have it. `target_dir`: build there, instead of in the
/// repository's own folder of build products.
pub(crate) fn build(
    way: &TargetWay,
    folder: &Path,
    cluster: &Path,
    target_dir: Option<&Path>,
) -> Result<Apps> {
    let metadata = workspace::metadata(folder)?;
    let theirs = Workspace::of(&metadata)?.building_in(target_dir);
    let nodes = nodes(cluster)?;
    let packages = packages(&metadata, &nodes);
    if packages.is_empty() {
        let names = nodes.into_iter().collect::<Vec<_>>().join("`, `");
        bail!("no package in {} has a program named like a node of the cluster: `{names}`", folder.display());
    }
    let mut apps = Apps { directory: way.target_dir(&theirs).join(TRIPLE).join(PROFILE), compiled: 0 };
    for Package { name, programs, is_observed } in packages {
        let mut command = way.cargo(&theirs, "build");
        command.env("CARGO_TARGET_DIR", theirs.target_dir());
        plan::follow(&mut command, cluster)?;
        if is_observed {
            command.args(["--features", OBSERVED]);
        } else {
            eprintln!(
                "note: `{name}` has no feature `{OBSERVED}`; without an observer there is little to judge"
            );
        }
        let built = step(&format!("building the images of `{name}`"), || {
            images::build(command, &name, PROFILE, &programs)
        })?;
        apps.compiled += built.compiled;
        apps.directory = built.directory().map_or(apps.directory, Path::to_owned);
    }
    Ok(apps)
}

/// A package with programs for nodes.
struct Package {
    name: String,
    programs: Vec<String>,
    is_observed: bool,
}

fn packages(metadata: &Value, nodes: &BTreeSet<String>) -> Vec<Package> {
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let is_program = |target: &Value| list(&target["kind"]).iter().any(|kind| kind == "bin");
    let package = |package: &Value| {
        let programs = list(&package["targets"]).into_iter().filter(is_program);
        let names = programs.filter_map(|target| Some(target["name"].as_str()?.to_owned()));
        let programs: Vec<_> = names.filter(|name| nodes.contains(name)).collect();
        let name = package["name"].as_str()?.to_owned();
        let is_observed = package["features"].get(OBSERVED).is_some();
        (!programs.is_empty()).then_some(Package { name, programs, is_observed })
    };
    list(&metadata["packages"]).iter().filter_map(package).collect()
}

/// The names of the nodes in a description. What is wrong with it the planner will say.
fn nodes(cluster: &Path) -> Result<BTreeSet<String>> {
    let text = fs::read_to_string(cluster).with_context(|| format!("reading {}", cluster.display()))?;
    let mut nodes = BTreeSet::new();
    let mut in_node = false;
    for line in text.lines().map(str::trim) {
        if line.starts_with('[') {
            in_node = line.starts_with("[[node]]");
        } else if in_node && let Some((key, value)) = line.split_once('=') {
            let name = value.trim().strip_prefix('"').and_then(|value| value.split('"').next());
            nodes.extend(name.filter(|_| key.trim() == "name").map(str::to_owned));
        }
    }
    Ok(nodes)
}

/// The feature of a package that has its nodes observed.
const OBSERVED: &str = "observed";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_of_nodes_are_found_and_others_left_out() {
        let metadata = serde_json::json!({ "packages": [
            { "name": "robot", "features": { "observed": [] }, "targets": [
                { "kind": ["bin"], "name": "arm" }, { "kind": ["bin"], "name": "smoke" },
                { "kind": ["lib"], "name": "controller" } ] },
            { "name": "emulate", "features": {}, "targets": [ { "kind": ["bin"], "name": "emulate" } ] },
        ] });
        let nodes = ["arm", "controller"].map(str::to_owned).into();
        let found = packages(&metadata, &nodes);
        let [Package { name, programs, is_observed: true }] = found.as_slice() else {
            panic!("{}", found.len())
        };
        assert_eq!((name.as_str(), programs.as_slice()), ("robot", &["arm".to_owned()][..]));
    }

    #[test]
    fn nodes_are_those_of_the_description() {
        let workspace = Workspace::find().unwrap();
        let nodes = nodes(&crate::plan::example(&workspace)).unwrap();
        assert_eq!(nodes.into_iter().collect::<Vec<_>>(), ["brake", "diagnostics", "sensor"]);
    }
}
