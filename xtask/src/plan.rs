//! The description of the cluster that the firmware is built for. Its build script plans it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};

use crate::workspace::Workspace;

/// Names the description to the build script of the firmware.
pub(crate) const VARIABLE: &str = "COSMIC_CLUSTER";

/// Tells the build scripts what is in the description (`cosmic_plan`), so that nothing is built again because the file
/// was written again.
const CONTENT: &str = "COSMIC_CLUSTER_CONTENT";

/// Where a repository of a user's has its description.
pub(crate) const OF_A_REPOSITORY: &str = "cluster.toml";

/// The cluster of the example firmware.
pub(crate) fn example(workspace: &Workspace) -> PathBuf {
    workspace.root().join("cosmic-plan/examples/vehicle.toml")
}

/// The file as a build script finds it, which runs in the folder of its package. One file has one name, so that
/// nothing is built again for another.
pub(crate) fn find(cluster: impl AsRef<Path>) -> Result<PathBuf> {
    let cluster = cluster.as_ref();
    cluster.canonicalize().with_context(|| {
        format!("{} cannot be read; name the file of a cluster with --cluster", cluster.display())
    })
}

/// Has a call of cargo build anew if the content of this file has changed, whatever its time.
pub(crate) fn follow(command: &mut Command, cluster: &Path) -> Result<()> {
    let cluster = find(cluster)?;
    let content = fs::read(&cluster).with_context(|| format!("reading {}", cluster.display()))?;
    command.env(CONTENT, format!("{:016x} {}", hash(&content), cluster.display()));
    Ok(())
}

/// FNV-1a.
fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xCBF2_9CE4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01B3)
    })
}

/// What a cluster is called among others: by its file, and by the place of that, if it is not the example.
pub(crate) fn name(workspace: &Workspace, cluster: &Path) -> String {
    let stem =
        cluster.file_stem().map_or_else(|| "cluster".into(), |stem| stem.to_string_lossy().into_owned());
    if example(workspace).canonicalize().is_ok_and(|example| example == cluster) {
        return stem;
    }
    format!("{stem}-{:08x}", hash(cluster.as_os_str().as_encoded_bytes()) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clusters_of_one_name_in_two_places_are_told_apart() {
        let workspace = Workspace::find().unwrap();
        let example = find(example(&workspace)).unwrap();
        assert_eq!(name(&workspace, &example), "vehicle");
        let [one, other] =
            ["/a/vehicle.toml", "/b/vehicle.toml"].map(|file| name(&workspace, Path::new(file)));
        assert!(one.starts_with("vehicle-") && one != other, "{one} {other}");
    }
}
