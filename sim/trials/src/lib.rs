//! The cluster of `firmware/trials` on the emulated boards, and what is seen of it.
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_IMAGES`.

use std::path::PathBuf;

use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::can::{BitRate, Frame};
use cosmic_core::protocol::{ControlMessage, NodeStatus};
use cosmic_emu::{CanController, Cluster, NodeConfig, NodeId, Observation, ObservationKind, ResetCause};
use fugit::HertzU32;

/// A cluster while it runs.
pub struct Trial {
    /// The cluster.
    pub cluster: Cluster,
    /// Its nodes, by their names.
    pub nodes: Vec<(&'static str, NodeId)>,
    /// What has been seen.
    pub seen: Vec<Observation>,
    /// What has been on the bus.
    pub trace: Vec<TraceEvent>,
}

/// The directory of the images.
pub fn images() -> PathBuf {
    let images = std::env::var_os("COSMIC_IMAGES");
    images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`").into()
}

/// An instant by its millisecond.
pub fn ms(milliseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(milliseconds * 1_000_000)
}

impl Trial {
    /// These nodes, each with the image of its name, on a bus without faults. The first byte of a part's unique
    /// identifier says what it does wrong: see `firmware/trials`.
    pub fn new(nodes: &[(&'static str, u8)]) -> Self {
        Self::with(nodes, |_| {})
    }

    /// These nodes, with a change of what each is made of.
    pub fn with(nodes: &[(&'static str, u8)], change: impl Fn(&mut NodeConfig)) -> Self {
        Self::on(Bus::new(BitRate::MAX, FaultModel::none()), nodes, change)
    }

    /// These nodes on this bus, with a change of what each is made of.
    pub fn on(bus: Bus, nodes: &[(&'static str, u8)], change: impl Fn(&mut NodeConfig)) -> Self {
        let mut cluster = Cluster::new(bus);
        cluster.bus_mut().record_trace(true);
        let images = images();
        let add = |(number, &(name, misdeed)): (u64, &(&'static str, u8))| {
            let mut config = NodeConfig::new(name, images.join(name));
            config.unique_id[0] = misdeed;
            config.start_at = ms(number);
            change(&mut config);
            let id = cluster.add_node(config).unwrap_or_else(|error| panic!("{name}: {error}"));
            (name, id)
        };
        let nodes = (0..).zip(nodes).map(add).collect();
        Self { cluster, nodes, seen: Vec::new(), trace: Vec::new() }
    }

    /// Plugs in the cable to another trial, whose nodes have other names. What has been seen of the other stays seen; what
    /// has been on its bus does not.
    pub fn join(&mut self, other: Self) {
        let ids = self.cluster.join(other.cluster).unwrap_or_else(|error| panic!("{error}"));
        let before = other.nodes;
        let renamed = |node: NodeId| ids[node.index()];
        self.seen.extend(other.seen.into_iter().map(|seen| Observation { node: renamed(seen.node), ..seen }));
        self.nodes.extend(before.into_iter().map(|(name, id)| (name, renamed(id))));
    }

    /// Lets time pass.
    pub fn run_until(&mut self, milliseconds: u64) {
        self.cluster.run_until(ms(milliseconds));
        self.seen.extend(self.cluster.take_observations());
        self.cluster.bus_mut().take_trace(&mut self.trace);
    }

    /// Lets time pass until a frame is being sent that `is_it` says yes to: up to 20 µs into it. Panics when there is none
    /// by this millisecond.
    pub fn run_into_frame(&mut self, milliseconds: u64, is_it: impl Fn(&Frame) -> bool) {
        let mut now = self.cluster.bus().now();
        loop {
            let known = self.trace.len();
            now = VirtualInstant::from_ticks(now.as_ticks() + 20_000);
            assert!(now < ms(milliseconds), "there was no such frame by {milliseconds} ms");
            self.cluster.run_until(now);
            self.cluster.bus_mut().take_trace(&mut self.trace);
            let starts = |event: &TraceEvent| match &event.kind {
                TraceKind::FrameStart { frame, .. } => {
                    Frame::try_from(*frame).is_ok_and(|frame| is_it(&frame))
                }
                _ => false,
            };
            if self.trace[known..].iter().any(starts) {
                return;
            }
        }
    }

    /// A node, by its name.
    pub fn node(&self, name: &str) -> NodeId {
        self.nodes.iter().find(|(it, _)| *it == name).map(|(_, id)| *id).expect("a node of the trial")
    }

    /// The log of a node from a millisecond on: when, and what.
    pub fn log(&self, name: &str, from: u64) -> Vec<(u64, String)> {
        let node = self.node(name);
        let line = |seen: &Observation| match &seen.kind {
            ObservationKind::Log(line) if seen.node == node => {
                Some((millisecond(seen.at), format!("{} {}", line.level, line.message)))
            }
            _ => None,
        };
        self.seen.iter().filter_map(line).filter(|(at, _)| *at >= from).collect()
    }

    /// Whether a node has logged a line with this text from a millisecond on.
    pub fn said(&self, name: &str, text: &str, from: u64) -> bool {
        self.log(name, from).iter().any(|(_, line)| line.contains(text))
    }

    /// The resets of a node.
    pub fn resets(&self, name: &str) -> Vec<(u64, ResetCause)> {
        let node = self.node(name);
        let reset = |seen: &Observation| match seen.kind {
            ObservationKind::Reset(cause) if seen.node == node => Some((millisecond(seen.at), cause)),
            _ => None,
        };
        self.seen.iter().filter_map(reset).collect()
    }

    /// The frames that were sent to their end from a millisecond on, each with its millisecond.
    pub fn frames(&self, from: u64) -> impl Iterator<Item = (u64, Frame)> {
        self.frames_at(from).map(|(at, frame)| (millisecond(at), frame))
    }

    /// As [`frames`](Self::frames), each with its instant.
    pub fn frames_at(&self, from: u64) -> impl Iterator<Item = (VirtualInstant, Frame)> {
        let frame = |event: &TraceEvent| match &event.kind {
            TraceKind::FrameEnd { frame, .. } => Some((event.at, Frame::try_from(*frame).ok()?)),
            _ => None,
        };
        self.trace.iter().filter_map(frame).filter(move |(at, _)| *at >= ms(from))
    }

    /// The statuses that were sent from a millisecond on.
    pub fn statuses(&self, from: u64) -> impl Iterator<Item = (u64, NodeStatus)> {
        let status = |(at, frame)| match ControlMessage::decode(&frame) {
            Some(ControlMessage::NodeStatus(status)) => Some((at, status)),
            _ => None,
        };
        self.frames(from).filter_map(status)
    }

    /// What was seen that no healthy cluster shows: accesses that are not modelled, stops, wrong bit rates.
    pub fn oddities(&self) -> Vec<String> {
        let odd = |seen: &&Observation| {
            !matches!(
                seen.kind,
                ObservationKind::Log(_) | ObservationKind::Pin { .. } | ObservationKind::Reset(_)
            )
        };
        let name = |id: NodeId| self.nodes.iter().find(|(_, it)| *it == id).map_or("?", |(name, _)| name);
        let told = |seen: &Observation| format!("{} at {}: {}", name(seen.node), seen.at, seen.kind);
        self.seen.iter().filter(odd).map(told).collect()
    }
}

/// What stands around the chip on the board that an image is built for.
pub fn on_board(config: &mut NodeConfig) {
    match config.name.as_str() {
        "worker_nucleo" | "hearer" => config.can = CanController::Can2,
        "guest_feather" => config.crystal = HertzU32::MHz(12),
        _ => {}
    }
}

/// The millisecond of an instant.
pub fn millisecond(at: VirtualInstant) -> u64 {
    at.as_ticks() / 1_000_000
}
