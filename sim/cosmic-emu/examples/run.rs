//! Runs firmware files as the nodes of one cluster and prints what is seen of them.
//!
//! `cargo run -p cosmic-emu --example run -- MILLISECONDS LOAD_PERCENT ELF...`

use std::process::ExitCode;
use std::time::Instant;

use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::can::{BitRate, Etag, Id, Priority, TxNode};
use cosmic_emu::{BackgroundLoad, ClockError, Cluster, NodeConfig, ObservationKind};

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let mut number = || arguments.next().and_then(|text| text.parse::<u32>().ok());
    let (Some(milliseconds), Some(load_percent)) = (number(), number()) else {
        eprintln!("usage: run MILLISECONDS LOAD_PERCENT ELF...");
        return ExitCode::FAILURE;
    };
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::seeded(1)));
    let (mut names, mut nodes) = (Vec::new(), Vec::new());
    for (n, file) in arguments.enumerate() {
        let name = format!("node{n}");
        let mut config = NodeConfig::new(&name, file);
        // No two nodes of a real cluster start at the same instant, or run at the same speed.
        config.start_at = VirtualInstant::from_ticks(1_234_567 * n as u64);
        config.clock_error = ClockError::parts_per_million(17 * n as i32 - 20).unwrap_or_default();
        match cluster.add_node(config) {
            Ok(node) => nodes.push(node),
            Err(error) => {
                eprintln!("{error}");
                return ExitCode::FAILURE;
            }
        }
        names.push(name);
    }
    let ids = [Priority::new(200), Priority::LEAST]
        .map(|priority| Id::new(priority, TxNode::MAX, Etag::BOUND_LAST));
    if let Some(load) = BackgroundLoad::new(cluster.bus(), load_percent, ids.to_vec(), 1) {
        cluster.add_station("load", Box::new(load));
    }
    let started = Instant::now();
    for end in 1..=milliseconds {
        cluster.run_until(VirtualInstant::from_ticks(u64::from(end) * 1_000_000));
        for seen in cluster.take_observations() {
            if matches!(seen.kind, ObservationKind::Pin { .. } | ObservationKind::Record { .. }) {
                continue;
            }
            let at = seen.at.duration_since_epoch().as_micros();
            println!("{at:>10} µs {}: {}", names[seen.node.index()], seen.kind);
        }
    }
    for (node, name) in nodes.iter().zip(&names) {
        println!("{name}: {} instructions", cluster.instructions(*node));
    }
    println!("{:?}", cluster.bus().accounting());
    let spent = started.elapsed().as_secs_f64();
    println!("{:.2} virtual seconds a second", f64::from(milliseconds) / 1000.0 / spent);
    ExitCode::SUCCESS
}
