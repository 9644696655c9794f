//! Builds what runs on the boards.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use crate::board::Board;
use crate::images;
use crate::plan;
use crate::setup;
use crate::size;
use crate::workspace::Workspace;

/// What to build.
#[derive(Args)]
pub(crate) struct Options {
    /// Only this image; may be given several times.
    #[arg(long = "image", value_name = "NAME")]
    images: Vec<String>,
    /// Build for this cluster instead of the example.
    #[arg(long, value_name = "FILE")]
    cluster: Option<PathBuf>,
    /// Build for this board; without, for those with a crystal of 8 MHz.
    #[arg(long, value_enum)]
    board: Option<Board>,
}

/// Builds the images of the firmware and prints their sizes.
pub(crate) fn task(workspace: &Workspace, options: &Options) -> Result<()> {
    let cluster = options.cluster.clone().unwrap_or_else(|| plan::example(workspace));
    let cluster = plan::find(cluster)?;
    let way = setup::prepare(&[])?;
    let (folder, built) = images::kept(workspace, &way, &cluster, options.board, &options.images)?;
    print!("{}", size::table(&size::measure_all(&built.images)?));
    println!("The images for {} are in {}.", cluster.display(), folder.display());
    Ok(())
}
