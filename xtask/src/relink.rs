//! Whether a build does no more, and no less, than a description of a cluster asks for.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};

use crate::apps;
use crate::plan;
use crate::tally::Tally;
use crate::target::TargetWay;
use crate::workspace::Workspace;

/// A description that was written again, but is the same, is no reason to build; one that has changed is, though it is
/// as old as before.
pub(crate) fn written_again(workspace: &Workspace, way: &TargetWay, folder: &Path) -> Result<Tally> {
    let cluster = plan::find(folder.join(plan::OF_A_REPOSITORY))?;
    let old = fs::metadata(&cluster)?.modified()?;
    let text = fs::read_to_string(&cluster).with_context(|| format!("reading {}", cluster.display()))?;
    let build = || apps::build(way, folder, &cluster, Some(workspace.target_dir()));
    fs::write(&cluster, &text).with_context(|| format!("writing {}", cluster.display()))?;
    let compiled = build()?.compiled;
    if compiled > 0 {
        eprintln!("error: {compiled} images were built again for a description that has not changed");
    }
    fs::write(&cluster, text.replacen("\nperiod = ", "\nperoid = ", 1))
        .with_context(|| format!("writing {}", cluster.display()))?;
    fs::File::options().write(true).open(&cluster)?.set_modified(old)?;
    let is_seen = build().is_err();
    if !is_seen {
        eprintln!("error: a description that has changed was not planned again");
    }
    Ok(Tally::one(compiled == 0 && is_seen))
}
