//! The nodes whose size is a goal do what they are for: a hub names them and asks, and they answer in all classes.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_SMALL_IMAGES`.

use std::path::PathBuf;

use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::can::{BitRate, TxNode};
use cosmic_emu::{Cluster, NodeConfig, ObservationKind};

const NODES: [&str; 4] = ["hub", "full", "full_logs", "ups"];
const START_MS: u64 = 700;
const END_MS: u64 = 2_500;

/// What the nodes have logged.
fn run() -> Vec<(&'static str, String)> {
    let images = std::env::var_os("COSMIC_SMALL_IMAGES");
    let images = PathBuf::from(
        images.expect("COSMIC_SMALL_IMAGES names no directory of images: run `cargo xtask test emulated`"),
    );
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()));
    for name in NODES {
        cluster.add_node(NodeConfig::new(name, images.join(name))).unwrap();
    }
    cluster.run_until(VirtualInstant::from_ticks(END_MS * 1_000_000));
    let mut lines = Vec::new();
    for seen in cluster.take_observations() {
        let name = NODES[seen.node.index()];
        match seen.kind {
            // At the start the others are not there yet.
            ObservationKind::Log(line)
                if line.level == "WARN" && seen.at < VirtualInstant::from_ticks(START_MS * 1_000_000) => {}
            ObservationKind::Log(line) => lines.push((name, format!("{} {}", line.level, line.message))),
            ObservationKind::Pin { .. } => {}
            other => panic!("{name}: {other}"),
        }
    }
    lines
}

#[test]
fn each_answers_what_it_is_asked() {
    let lines = run();
    // Every tenth answer, in the order of the questions.
    let answered = |what: &str, by: &[u8], most: usize| {
        let tens = |by: &u8| -> Vec<u16> {
            let end = format!(" of node {by}");
            let numbers = lines.iter().filter_map(|(_, line)| line.strip_prefix(&format!("INFO {what} ")));
            numbers.filter_map(|rest| rest.strip_suffix(&end)?.parse().ok()).collect()
        };
        for by in by {
            let answers = tens(by);
            assert!(answers.len() > most / 2, "{what} of {by}: {answers:?}\n{lines:#?}");
            assert!(answers.windows(2).all(|pair| pair[1] == pair[0] + 10), "{what} of {by}: {answers:?}");
        }
    };
    // What is asked every so many milliseconds.
    let tens = |period_ms: u64| (END_MS / period_ms / 10) as usize;
    answered("angle", &[2], tens(10));
    answered("torque", &[3], tens(10));
    answered("heat", &[2, 3], tens(20));
    // The last asked the broker for its id, who gives the highest first.
    answered("report", &[2, 3, TxNode::MAX.get()], tens(50));
    let configured =
        |(who, line): &&(&str, String)| *who == "full_logs" && line.starts_with("INFO Configured");
    assert_eq!(lines.iter().filter(configured).count(), 1, "{lines:#?}");
    assert!(!lines.iter().any(|(_, line)| line.starts_with("WARN")), "{lines:#?}");
}
