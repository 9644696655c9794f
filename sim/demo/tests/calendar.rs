//! What holds up the calendar task of the images that are flashed, and for how long.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_IMAGES`.

use std::path::PathBuf;

use cosmic_bus::{Bus, Chance, FaultModel, VirtualInstant};
use cosmic_core::can::BitRate;
use cosmic_demo::example::EXAMPLE;
use cosmic_emu::{Cluster, NodeConfig, ObservationKind};

/// RTIC's priority 7 of 16, as NVIC has it.
const CALENDAR: u8 = (16 - 7) << 4;

/// 1 µs at 168 MHz.
const LONGEST: u64 = 168;

#[test]
fn nothing_below_the_calendar_task_holds_it_up_for_a_microsecond() {
    let images = std::env::var_os("COSMIC_IMAGES");
    let images = PathBuf::from(
        images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`"),
    );
    // Faults make exceptions, and exceptions logs.
    let mut cluster =
        Cluster::new(Bus::new(BitRate::MAX, FaultModel::seeded(1).with_inversion(Chance::new(0.2).unwrap())));
    let add = |node: &cosmic_demo::example::Node| {
        cluster.add_node(NodeConfig::new(node.name, images.join(node.name))).unwrap()
    };
    let nodes: Vec<_> = EXAMPLE.nodes.iter().map(add).collect();
    cluster.run_until(VirtualInstant::from_ticks(5_000_000));
    nodes.iter().for_each(|&node| cluster.watch_masks(node, CALENDAR));
    cluster.run_until(VirtualInstant::from_ticks(2_000_000_000));
    let lines = cluster
        .take_observations()
        .iter()
        .filter(|seen| matches!(seen.kind, ObservationKind::Log(_)))
        .count();
    assert!(lines > 10, "the nodes logged {lines} lines");
    let mut too_long = Vec::new();
    for (&node, name) in nodes.iter().zip(EXAMPLE.nodes.iter().map(|node| node.name)) {
        let causes = cluster.longest_masked(node);
        assert!(causes.len() > 3, "nothing was measured");
        let told = causes.iter().map(|cause| format!("{name}: {} cycles by {}", cause.cycles, cause.place));
        println!("{}", told.clone().take(3).collect::<Vec<_>>().join("\n"));
        too_long.extend(told.zip(&causes).filter(|(_, cause)| cause.cycles >= LONGEST).map(|(text, _)| text));
    }
    assert_eq!(too_long, Vec::<String>::new());
}
