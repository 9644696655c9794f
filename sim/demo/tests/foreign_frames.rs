//! Frames that COSMIC does not send, on the images that are flashed: they must survive them.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_IMAGES`.

use std::collections::VecDeque;
use std::path::PathBuf;

use cosmic_bus::trace::TraceKind;
use cosmic_bus::{Bus, EventKind, FaultModel, VirtualInstant, WireFrame};
use cosmic_core::can::{BitRate, Etag, Id, Priority, TxNode};
use cosmic_demo::example::EXAMPLE;
use cosmic_emu::{Cluster, NodeConfig, NodeId, ObservationKind, Port, Station};
use embedded_can::{ExtendedId, Frame as _, StandardId};

/// Sends its frames one behind the other, from an instant on.
struct Stranger {
    starts_at: Option<VirtualInstant>,
    frames: VecDeque<WireFrame>,
}

impl Stranger {
    fn send(&mut self, port: &mut Port<'_>) {
        if let Some(frame) = self.frames.pop_front() {
            assert!(port.load(0, frame));
        }
    }
}

impl Station for Stranger {
    fn acts_at(&self) -> Option<VirtualInstant> {
        self.starts_at
    }

    fn act(&mut self, port: &mut Port<'_>) {
        self.starts_at = None;
        self.send(port);
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        if matches!(event, EventKind::Sent { .. }) {
            self.send(port);
        }
    }
}

fn instant(microseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(microseconds * 1000)
}

fn example(stranger: Vec<WireFrame>, starts_at: VirtualInstant) -> (Cluster, Vec<NodeId>) {
    let images = std::env::var_os("COSMIC_IMAGES");
    let images = PathBuf::from(
        images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`"),
    );
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()));
    cluster.bus_mut().record_trace(true);
    let add = |node: &cosmic_demo::example::Node| {
        cluster.add_node(NodeConfig::new(node.name, images.join(node.name))).unwrap()
    };
    let nodes = EXAMPLE.nodes.iter().map(add).collect();
    let stranger = Stranger { starts_at: Some(starts_at), frames: stranger.into() };
    cluster.add_station("stranger", Box::new(stranger));
    (cluster, nodes)
}

/// All nodes run, and each still sends.
fn all_go_on(cluster: &mut Cluster, nodes: &[NodeId], until: VirtualInstant) {
    let mut trace = Vec::new();
    cluster.bus_mut().take_trace(&mut trace);
    cluster.run_until(until);
    cluster.bus_mut().take_trace(&mut trace);
    let stops = cluster.take_observations().into_iter().filter_map(|seen| match seen.kind {
        ObservationKind::Stopped { .. } => Some(format!("{:?} at {}: {}", seen.node, seen.at, seen.kind)),
        _ => None,
    });
    assert_eq!(stops.collect::<Vec<_>>(), Vec::<String>::new());
    for &node in nodes {
        assert!(!cluster.is_stopped(node));
        let station = cluster.station(node);
        let sends =
            |kind: &TraceKind| matches!(kind, TraceKind::FrameEnd { station: who, .. } if *who == station);
        assert!(trace.iter().any(|event| sends(&event.kind)), "{node:?} is silent");
    }
}

/// One frame for each channel and protocol message, in both FIFOs, with a priority that none uses at once.
fn ids() -> Vec<ExtendedId> {
    let slot = EXAMPLE.calendar.slots()[0];
    let stranger = TxNode::new(0x55).unwrap();
    let mut ids = vec![Id::new(Priority::HARD, slot.publisher, slot.etag)];
    let etags = EXAMPLE.channels.iter().map(|channel| channel.etag);
    let protocol = [0, 1, 2, 4, 16, 17, 18, 19].map(|raw| Etag::new(raw).unwrap());
    ids.extend(etags.chain(protocol).map(|etag| Id::new(Priority::LEAST, stranger, etag)));
    ids.into_iter().map(|id| ExtendedId::new(id.raw()).unwrap()).collect()
}

#[test]
fn length_codes_above_eight_do_no_harm() {
    let mut frames = Vec::new();
    for id in ids() {
        for code in 9..=15 {
            let data = WireFrame::new(id, &[0xA5; 8]).unwrap();
            frames.push(data.with_length_code(code).unwrap());
        }
    }
    let (mut cluster, nodes) = example(frames, instant(300_000));
    cluster.run_until(instant(400_000));
    all_go_on(&mut cluster, &nodes, instant(600_000));
}

#[test]
fn remote_frames_and_standard_identifiers_do_no_harm() {
    let mut frames = Vec::new();
    for id in ids() {
        let standard = StandardId::new((id.as_raw() >> 18) as u16).unwrap();
        for code in [0, 8, 15] {
            let remote = WireFrame::new_remote(id, 0).unwrap();
            frames.push(remote.with_length_code(code).unwrap());
            let remote = WireFrame::new_remote(standard, 0).unwrap();
            frames.push(remote.with_length_code(code).unwrap());
        }
        frames.push(WireFrame::new(standard, &[1; 8]).unwrap());
        frames.push(WireFrame::new(standard, &[1; 8]).unwrap().with_length_code(12).unwrap());
    }
    let (mut cluster, nodes) = example(frames, instant(300_000));
    cluster.run_until(instant(400_000));
    all_go_on(&mut cluster, &nodes, instant(600_000));
}
