//! For how much of the time the core of a node is awake on a full bus: the images that are flashed, as they are.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_IMAGES`. The figures of
//! `docs/measurements.md` are what this prints.

use std::path::PathBuf;

use cosmic_bus::{Bus, EventKind, FaultModel, VirtualInstant};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_demo::example::EXAMPLE;
use cosmic_emu::{Cluster, NodeConfig, NodeId, ObservationKind, Port, Station};

/// Keeps the three mailboxes of its controller full with frames of one identifier.
struct Flood {
    id: Id,
    starts_at: Option<VirtualInstant>,
    sequence: u64,
    sent: std::rc::Rc<std::cell::Cell<u64>>,
}

impl Flood {
    fn load(&mut self, mailbox: usize, port: &mut Port<'_>) {
        self.sequence += 1;
        // As contents of the suspension: a sequence number, travel and velocity.
        let payload = Payload::full((self.sequence << 32).to_be_bytes());
        assert!(port.load(mailbox, Frame::new(self.id, payload).into()));
    }
}

impl Station for Flood {
    fn acts_at(&self) -> Option<VirtualInstant> {
        self.starts_at
    }

    fn act(&mut self, port: &mut Port<'_>) {
        self.starts_at = None;
        (0..3).for_each(|mailbox| self.load(mailbox, port));
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        if let EventKind::Sent { mailbox } = event {
            self.sent.set(self.sent.get() + 1);
            self.load(*mailbox, port);
        }
    }
}

/// What a node did in a second under a flood.
struct Second {
    /// Of the time, in percent.
    awake: f64,
    /// Frames of the flood.
    frames: u64,
}

/// Runs these nodes, floods the bus, and measures one of them from the second on in which all is settled.
fn measure(nodes: &[&'static str], measured: &str, flood: Id) -> Second {
    let images = std::env::var_os("COSMIC_IMAGES");
    let images = PathBuf::from(
        images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`"),
    );
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()));
    let add = |name: &&'static str| cluster.add_node(NodeConfig::new(*name, images.join(name))).unwrap();
    let ids: Vec<NodeId> = nodes.iter().map(add).collect();
    let node = ids[nodes.iter().position(|name| *name == measured).unwrap()];
    let sent = std::rc::Rc::default();
    let station = Flood { id: flood, starts_at: Some(at(800)), sequence: 0, sent: std::rc::Rc::clone(&sent) };
    cluster.add_station("flood", Box::new(station));
    cluster.run_until(at(1_000));
    let _ = cluster.take_observations();
    let (awake, before) = (cluster.awake(node), sent.get());
    cluster.run_until(at(2_000));
    let warned = |seen: &cosmic_emu::Observation| match &seen.kind {
        ObservationKind::Log(line) if seen.node == node && line.level != "DEBUG" => {
            Some(line.message.clone())
        }
        _ => None,
    };
    let complaints: Vec<_> = cluster.take_observations().iter().filter_map(warned).collect();
    assert_eq!(complaints, Vec::<String>::new(), "{measured}");
    let awake = (cluster.awake(node) - awake) as f64 / f64::from(CORE_HERTZ) * 100.0;
    Second { awake, frames: sent.get() - before }
}

fn at(milliseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(milliseconds * 1_000_000)
}

/// The node and the etag of the suspension, which the brake subscribes to.
fn suspension(priority: Priority) -> Id {
    let channel = EXAMPLE.channels.iter().find(|channel| channel.name == "suspension").unwrap();
    Id::new(priority, channel.publisher, channel.etag)
}

/// Of nobody in the plan.
fn foreign() -> Id {
    Id::new(Priority::LEAST, TxNode::MAX, Etag::BOUND_FIRST)
}

const CORE_HERTZ: u32 = 168_000_000;

#[test]
fn a_node_sleeps_most_of_the_time_on_a_full_bus() {
    let least = Priority::LEAST;
    let all = ["sensor", "brake", "diagnostics"];
    let cases = [
        ("sensor, foreign frames", measure(&all, "sensor", foreign()), 5.0),
        (
            "diagnostics, which publishes at 1 kHz, foreign frames",
            measure(&all, "diagnostics", foreign()),
            20.0,
        ),
        ("brake, which takes every frame", measure(&["sensor", "brake"], "brake", suspension(least)), 20.0),
    ];
    for (name, second, most) in cases {
        println!("{name}: {:.1} % awake, {} frames of the flood", second.awake, second.frames);
        assert!(second.frames > 5_000, "{name}: {} frames", second.frames);
        assert!(second.awake < most, "{name}: {:.1} % awake", second.awake);
    }
}
