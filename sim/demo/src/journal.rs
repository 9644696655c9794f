//! What is left of a run when it is over: all that the judge, the tables and the picture are made of.

use std::rc::Rc;

use cosmic_bus::{Accounting, StationId, VirtualInstant};
use cosmic_core::can::{BitRate, TxNode};

use crate::bus_log::BusLog;
use crate::clock::{GlobalTimeline, NodeClock};
use crate::cluster::Cluster;
use crate::load::BackgroundLog;
use crate::record::Record;

/// A run, as it was observed from outside.
#[derive(Clone, Debug)]
pub struct Journal {
    /// The cluster that ran.
    pub cluster: &'static Cluster,
    /// The bit rate of the bus.
    pub bit_rate: BitRate,
    /// What was on the wire.
    pub bus: BusLog,
    /// What the bus was busy with.
    pub accounting: Accounting,
    /// What the nodes have recorded; of one node in the order in which it was written.
    pub records: Vec<(TxNode, Record)>,
    /// The local clocks.
    pub clocks: Vec<(TxNode, NodeClock)>,
    /// The stations of the nodes on the bus.
    pub stations: Vec<(TxNode, StationId)>,
    /// What the background load has sent.
    pub background: BackgroundLog,
    /// When the handlers of the nodes ran, if that was asked for.
    pub handlers: Vec<HandlerRun>,
    /// Errors in the logs of the nodes, and what they did that the emulator does not know.
    pub errors: Vec<LoggedError>,
    /// When the run ended.
    pub end: VirtualInstant,
}

/// A handler of a node from its begin to its end; in between others may have pre-empted it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct HandlerRun {
    /// Which node.
    pub node: TxNode,
    /// Its name in the image.
    pub name: Rc<str>,
    /// The number of its exception.
    pub exception: u16,
    /// Its priority, as NVIC has it: the smaller, the more urgent.
    pub priority: u8,
    /// When it began.
    pub from: VirtualInstant,
    /// When it ended.
    pub until: VirtualInstant,
}

/// A node says that something went wrong with itself.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LoggedError {
    /// Which.
    pub node: TxNode,
    /// When that was read.
    pub at: VirtualInstant,
    /// What it says.
    pub text: String,
}

impl Journal {
    /// The local clock of a node.
    pub fn clock(&self, tx_node: TxNode) -> Option<NodeClock> {
        self.clocks.iter().find(|(node, _)| *node == tx_node).map(|(_, clock)| *clock)
    }

    /// Returns whether a node was bus-off at some time from `from` to `until`.
    pub fn was_off(&self, tx_node: TxNode, from: VirtualInstant, until: VirtualInstant) -> bool {
        let stations = self.stations.iter().filter(|(node, _)| *node == tx_node);
        stations.map(|(_, station)| *station).any(|station| self.bus.was_off(station, from, until))
    }

    /// Global time, by the sync frames.
    pub fn timeline(&self) -> GlobalTimeline {
        GlobalTimeline::of(self.bus.attempts(), |node| self.clock(node))
    }
}
