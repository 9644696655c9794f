//! `cargo run`: the robot for three virtual seconds, with the logs of its nodes.

use std::error::Error;

use cosmic_emu::ObservationKind;
use emulate::{cluster, images, plan, run};

fn main() -> Result<(), Box<dyn Error>> {
    let mut cluster = cluster(&images()?)?;
    for end in 1..=3_000 {
        for seen in run(&mut cluster, end) {
            if !matches!(seen.kind, ObservationKind::Pin { .. }) {
                let at = seen.at.duration_since_epoch().as_micros();
                println!("{at:>8} µs {}: {}", plan::NODES[seen.node.index()].name, seen.kind);
            }
        }
    }
    Ok(())
}
