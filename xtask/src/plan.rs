//! The description of the cluster that the firmware is built for. Its build script plans it.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

/// Names another description than the example's to the build scripts of firmware and demo.
pub(crate) const VARIABLE: &str = "COSMIC_CLUSTER";

/// The file as a build script finds it, which runs in the folder of its package.
pub(crate) fn find(cluster: &Path) -> Result<PathBuf> {
    cluster
        .canonicalize()
        .with_context(|| format!("{} cannot be read; name the file of a cluster", cluster.display()))
}
