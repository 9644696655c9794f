//! The workshop (`examples/workshop`): a cluster that configures itself, run beside the one that is planned as a whole.
//!
//! Its nodes ask for their ids, bind their subjects, and ask whether they may publish what is in no plan. It is judged by
//! what was on the bus and by what its nodes log, not by records: it runs as a user would flash it.
//!
//! Half-way the desk is switched off, which names nodes and channels: a spare stands by. The lamp is switched on anew
//! then, and needs an id.

mod names;
mod promise;
mod summary;

use std::path::Path;

use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::can::Frame;
use cosmic_emu::{ClockError, Cluster, LoadError, NodeConfig, ObservationKind};
use cosmic_plan::cluster as described;

pub use promise::Promise;
pub use summary::Summary;

/// When the desk is switched off, in milliseconds.
pub const DESK_GOES: u64 = 4_000;
/// When the lamp is switched off and on.
pub const LAMP_STARTS_ANEW: u64 = 5_500;
/// When the run ends.
pub const END: u64 = 7_500;

/// What happened.
#[derive(Clone, Debug, Default)]
pub struct Story {
    /// What the nodes said, by the millisecond in which it was read out.
    pub lines: Vec<Line>,
    /// What was on the bus, in the order of time.
    pub frames: Vec<Sent>,
    /// What no node should do: faults, accesses that are not modelled, wrong bit rates; and what it logged as an error.
    pub oddities: Vec<String>,
}

/// A line of a node's log.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Line {
    /// When it was read out, in milliseconds.
    pub at: u64,
    /// Who said it.
    pub node: String,
    /// What, without its level.
    pub text: String,
}

/// A frame that was sent to its end.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Sent {
    /// The end of its end of frame.
    pub at: VirtualInstant,
    /// The frame.
    pub frame: Frame,
}

/// Runs the images of the nodes, each with the name of its node. No two crystals are equally fast.
///
/// # Errors
/// [`LoadError`]: an image cannot be run.
pub fn run(workshop: &described::Cluster, images: &Path) -> Result<Story, LoadError> {
    let mut cluster = Cluster::new(Bus::new(workshop.segment.bit_rate, FaultModel::none()));
    cluster.bus_mut().record_trace(true);
    let mut nodes = Vec::new();
    for (number, node) in (0..).zip(&workshop.nodes) {
        let mut config = NodeConfig::new(&node.name, images.join(&node.name));
        config.start_at = instant(starts(number));
        config.clock_error = ClockError::parts_per_million(drift(number)).unwrap_or_default();
        nodes.push(cluster.add_node(config)?);
    }
    let node = |name| workshop.nodes.iter().position(|node| node.name == name).map(|at| nodes[at]);
    let mut story = Story::default();
    for millisecond in 1..=END {
        cluster.run_until(instant(millisecond));
        story.observe(&mut cluster, workshop);
        match millisecond {
            DESK_GOES => node(DESK).into_iter().for_each(|desk| cluster.power_off(desk)),
            LAMP_STARTS_ANEW => node(LAMP).into_iter().for_each(|lamp| cluster.restart(lamp)),
            _ => {}
        }
    }
    Ok(story)
}

/// When the node of this number is switched on, in milliseconds: one after the other.
const fn starts(number: u64) -> u64 {
    number
}

/// The first, which gives the time, keeps the bus's own.
fn drift(number: u64) -> i32 {
    [0, 20, -30, 25, 15][number as usize % 5]
}

impl Story {
    /// The milliseconds in which a node said what begins so.
    fn instants(&self, node: &str, text: &str) -> Vec<u64> {
        let these = self.lines.iter().filter(|it| it.node == node && it.text.starts_with(text));
        these.map(|it| it.at).collect()
    }

    fn observe(&mut self, cluster: &mut Cluster, workshop: &described::Cluster) {
        for seen in cluster.take_observations() {
            let name = workshop.nodes[seen.node.index()].name.clone();
            let at = millisecond(seen.at);
            match seen.kind {
                ObservationKind::Log(line) if line.level != "ERROR" => {
                    self.lines.push(Line { at, node: name, text: line.message });
                }
                ObservationKind::Pin { .. } => {}
                other => self.oddities.push(format!("{name}, at {at} ms: {other}")),
            }
        }
        let mut trace = Vec::new();
        cluster.bus_mut().take_trace(&mut trace);
        self.frames.extend(trace.iter().filter_map(sent));
    }
}

fn sent(event: &TraceEvent) -> Option<Sent> {
    match &event.kind {
        TraceKind::FrameEnd { frame, .. } => {
            Some(Sent { at: event.at, frame: Frame::try_from(*frame).ok()? })
        }
        _ => None,
    }
}

fn instant(millisecond: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(millisecond * NANOSECONDS_OF_MILLISECOND)
}

/// The millisecond in which an instant lies.
fn millisecond(at: VirtualInstant) -> u64 {
    at.as_ticks() / NANOSECONDS_OF_MILLISECOND
}

const DESK: &str = "desk";
const SPARE: &str = "spare";
const PROBE: &str = "probe";
const SCOUT: &str = "scout";
const LAMP: &str = "lamp";
/// [`VirtualInstant`] counts nanoseconds.
const NANOSECONDS_OF_MILLISECOND: u64 = 1_000_000;
