//! The robot on this machine: builds the images and runs them, as they would be flashed, on emulated boards and a
//! bit-accurate bus.

use std::env;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;

use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_emu::{ClockError, Cluster, NodeConfig, Observation};

cosmic_core::include_plan!();

/// Builds the images. The environment variable `COSMIC_IMAGES` names a folder with images that are built already.
pub fn images() -> Result<PathBuf, Box<dyn Error>> {
    if let Some(built) = env::var_os("COSMIC_IMAGES") {
        return Ok(built.into());
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().ok_or("no parent folder")?;
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let status = Command::new(env!("CARGO"))
        .arg("images")
        .arg("--target-dir")
        .arg(&target)
        .current_dir(root)
        .status()?;
    if !status.success() {
        return Err("`cargo images` failed; see above".into());
    }
    Ok(target.join("thumbv7em-none-eabihf/firmware"))
}

/// One node for each of the plan, with the image of its name. No two are switched on at the same instant, and no
/// two crystals are alike.
pub fn cluster(images: &Path) -> Result<Cluster, Box<dyn Error>> {
    let mut cluster = Cluster::new(Bus::new(plan::SEGMENT.bit_rate, FaultModel::none()));
    for (number, node) in (0_i32..).zip(plan::NODES) {
        let mut config = NodeConfig::new(node.name, images.join(node.name));
        config.start_at = VirtualInstant::from_ticks(1_234_567 * u64::from(number.unsigned_abs()));
        config.clock_error = ClockError::parts_per_million(30 * number - 15).unwrap_or_default();
        cluster.add_node(config)?;
    }
    Ok(cluster)
}

/// Lets time pass, and returns what was seen.
pub fn run(cluster: &mut Cluster, milliseconds: u64) -> Vec<Observation> {
    cluster.run_until(VirtualInstant::from_ticks(milliseconds * 1_000_000));
    cluster.take_observations()
}
