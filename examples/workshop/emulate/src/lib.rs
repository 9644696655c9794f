//! The workshop on this machine: runs the images, as they would be flashed, on emulated boards and a bit-accurate bus.

use std::env;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;

use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_emu::{Cluster, NodeConfig, NodeId, ObservationKind};

cosmic_core::include_plan!();

/// Builds the images. The environment variable `COSMIC_IMAGES` names a folder with images that are built already.
pub fn images() -> Result<PathBuf, Box<dyn Error>> {
    if let Some(built) = env::var_os("COSMIC_IMAGES") {
        return Ok(built.into());
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().ok_or("no parent folder")?;
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let mut build = Command::new(env!("CARGO"));
    let status = build.arg("images").arg("--target-dir").arg(&target).current_dir(root).status()?;
    if !status.success() {
        return Err("`cargo images` failed; see above".into());
    }
    Ok(target.join("thumbv7em-none-eabihf/firmware"))
}

/// The workshop while it runs.
pub struct Workshop {
    cluster: Cluster,
    nodes: Vec<NodeId>,
    /// What the nodes have said: in which millisecond, who, and what.
    pub lines: Vec<(u64, &'static str, String)>,
}

impl Workshop {
    /// All nodes of the plan, each with the image of its name; those that are named are switched on later, in this
    /// millisecond.
    pub fn new(images: &Path, later: &[(&str, u64)]) -> Result<Self, Box<dyn Error>> {
        let mut cluster = Cluster::new(Bus::new(plan::SEGMENT.bit_rate, FaultModel::none()));
        let mut nodes = Vec::new();
        for (number, node) in (0..).zip(plan::NODES) {
            let mut config = NodeConfig::new(node.name, images.join(node.name));
            let start = later.iter().find(|(name, _)| *name == node.name).map_or(number, |(_, at)| *at);
            config.start_at = VirtualInstant::from_ticks(start * 1_000_000);
            nodes.push(cluster.add_node(config)?);
        }
        Ok(Self { cluster, nodes, lines: Vec::new() })
    }

    /// Lets time pass, and takes down what is said. What is worse than a warning ends it.
    pub fn run_until(&mut self, millisecond: u64) -> Result<(), String> {
        self.cluster.run_until(VirtualInstant::from_ticks(millisecond * 1_000_000));
        for seen in self.cluster.take_observations() {
            let name = plan::NODES[seen.node.index()].name;
            let at = seen.at.duration_since_epoch().as_millis();
            match seen.kind {
                ObservationKind::Log(line) if line.level != "ERROR" => {
                    self.lines.push((at, name, format!("{} {}", line.level, line.message)));
                }
                ObservationKind::Pin { .. } => {}
                other => return Err(format!("{name} at {at} ms: {other}")),
            }
        }
        Ok(())
    }

    /// Takes the power from a node.
    pub fn switch_off(&mut self, name: &str) {
        let at = plan::NODES.iter().position(|node| node.name == name);
        self.cluster.power_off(self.nodes[at.expect("the plan has the node")]);
    }

    /// What a node has said that begins so, from a millisecond on.
    pub fn said(&self, node: &str, text: &str, from: u64) -> usize {
        let these =
            |(at, who, what): &&(u64, &str, String)| *who == node && *at >= from && what.starts_with(text);
        self.lines.iter().filter(these).count()
    }
}
