//! The plan of the cluster: what `cosmic-plan` makes of its description, and the firmware is built from.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use crate::run::{self, step};
use crate::workspace::Workspace;

/// Names another plan to the build of the firmware.
pub(crate) const VARIABLE: &str = "COSMIC_PLAN";

/// Plans a cluster, and says where the constants for the firmware are.
pub(crate) fn make(workspace: &Workspace, cluster: &Path) -> Result<PathBuf> {
    // The planner runs in the root of the repository, the file is named from where the user is.
    let cluster = cluster
        .canonicalize()
        .with_context(|| format!("{} cannot be read; name the file of a cluster", cluster.display()))?;
    let out = workspace.target_dir().join("plan");
    let mut planner = workspace.cargo();
    planner.args(["run", "--quiet", "--package", "cosmic-plan", "--", "build"]);
    planner.arg(&cluster).arg("--out").arg(&out);
    step("planning the calendar", || run::run(&mut planner))?;
    Ok(out.join(FILE))
}

/// Checks that the plan in the repository is what the planner makes of its description.
pub(crate) fn check(workspace: &Workspace) -> Result<()> {
    let made = make(workspace, &workspace.root().join(DESCRIPTION))?;
    let kept = workspace.root().join("firmware/plan").join(FILE);
    let read =
        |path: &Path| fs::read_to_string(path).with_context(|| format!("{} cannot be read", path.display()));
    if read(&made)? != read(&kept)? {
        bail!(
            "{} is not what the planner makes of {DESCRIPTION}; type: cp {} {}",
            kept.display(),
            made.display(),
            kept.display()
        );
    }
    Ok(())
}

/// What the planner writes for the firmware.
const FILE: &str = "calendar.rs";

/// The description of the example cluster.
const DESCRIPTION: &str = "cosmic-plan/examples/vehicle.toml";
