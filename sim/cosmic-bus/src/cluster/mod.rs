//! Whole clusters in virtual time: any number of nodes, each with the core's own code, on one bus.
//!
//! Each node has a clock of its own, that drifts, ticks and stamps late; a [dispatcher task and the tasks
//! below it](Application); and a controller with three mailboxes on the bit-accurate [`Bus`]. Processing
//! takes no virtual time: what a processor adds is in [`ClockErrors`].
//!
//! Everything follows from the seed: the faults on the bus and the delays in the nodes.

mod clock;
mod node;

pub use clock::ClockErrors;
pub use node::{Access, Application, Half, NodeConfig, SLOTS};

use crate::bus::Bus;
use crate::event::{Event, StationId};
use crate::filter::Filters;
use crate::time::{EPOCH, FAR_FUTURE, VirtualInstant};
use cosmic_core::services::Services;
use node::Node;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A cluster of nodes on a bus.
pub struct Cluster<S: Services> {
    bus: Bus,
    nodes: Vec<Node<S>>,
    /// The node of each station; stations without one are the caller's own.
    by_station: Vec<Option<usize>>,
    wakes: BinaryHeap<Reverse<(VirtualInstant, usize)>>,
    random: Pcg64Mcg,
    events: Vec<Event>,
    now: VirtualInstant,
}

impl<S: Services> Cluster<S> {
    /// A cluster without nodes; `seed` is for the delays in the nodes, the bus has its own.
    pub fn new(bus: Bus, seed: u64) -> Self {
        Self {
            bus,
            nodes: Vec::new(),
            by_station: Vec::new(),
            wakes: BinaryHeap::new(),
            random: Pcg64Mcg::seed_from_u64(seed),
            events: Vec::new(),
            now: EPOCH,
        }
    }

    /// Adds a node, that is off, connected to the bus.
    pub fn add(&mut self, config: NodeConfig<S>) -> StationId {
        let station = self.bus.attach(config.name.clone());
        let random = Pcg64Mcg::seed_from_u64(self.random.next_u64());
        self.by_station.resize(station.index() + 1, None);
        self.by_station[station.index()] = Some(self.nodes.len());
        self.nodes.push(Node::new(station, config, random));
        self.bus.disconnect(self.now, station);
        station
    }

    /// The bus, to add faults or stations, set filters, or disconnect a station.
    pub fn bus(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// True time.
    pub fn now(&self) -> VirtualInstant {
        self.now
    }

    /// Switches a node on; if it is on, restarts it.
    pub fn power_on(&mut self, station: StationId) {
        self.bus.reset(self.now, station);
        self.bus.connect(self.now, station);
        self.at_node(station, |node, bus, now| node.power_on(bus, now));
    }

    /// Switches a node off: it vanishes from the bus in the middle of whatever it does.
    pub fn power_off(&mut self, station: StationId) {
        self.bus.disconnect(self.now, station);
        self.at_node(station, |node, _, _| node.power_off());
    }

    /// Cuts a node off the bus; it goes on by itself.
    pub fn disconnect(&mut self, station: StationId) {
        self.bus.disconnect(self.now, station);
    }

    /// Ends what [`disconnect`](Self::disconnect) began.
    pub fn connect(&mut self, station: StationId) {
        self.bus.connect(self.now, station);
    }

    /// Sets the acceptance filters of a node's controller.
    pub fn set_filters(&mut self, station: StationId, filters: Filters) {
        self.bus.set_filters(station, filters);
    }

    /// Acts on a node that is on, as its application could; `None` if it is off.
    pub fn visit<R>(
        &mut self,
        station: StationId,
        visitor: impl FnOnce(&mut Access<'_, S>) -> R,
    ) -> Option<R> {
        let mut result = None;
        self.at_node(station, |node, bus, now| result = node.visit(bus, now, visitor));
        result
    }

    /// Lets time pass until `until`, inclusive.
    pub fn run_until(&mut self, until: VirtualInstant) {
        loop {
            let next_wake = self.wakes.peek().map_or(FAR_FUTURE, |Reverse((at, _))| *at);
            let next_event = self.bus.next_event().unwrap_or(FAR_FUTURE);
            let next = next_wake.min(next_event);
            if next > until {
                break;
            }
            self.now = self.now.max(next);
            self.hand_out_events();
            while let Some(&Reverse((at, index))) = self.wakes.peek() {
                if at > self.now {
                    break;
                }
                self.wakes.pop();
                self.wake(index);
            }
        }
        self.now = self.now.max(until);
        self.hand_out_events();
    }

    fn hand_out_events(&mut self) {
        let mut events = std::mem::take(&mut self.events);
        self.bus.advance(self.now, &mut events);
        for event in events.drain(..) {
            let index = self.by_station.get(event.station.index()).copied().flatten();
            let Some(index) = index else { continue };
            let node = &mut self.nodes[index];
            node.on_event(&mut self.bus, self.now, &event.kind);
            self.schedule(index);
        }
        self.events = events;
    }

    fn wake(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        let due = (node.hard_wakes_at <= self.now, node.soft_wakes_at <= self.now);
        if due.0 {
            node.run_hard(&mut self.bus, self.now);
        }
        if due.1 {
            node.run_soft(&mut self.bus, self.now);
        }
        if due.0 || due.1 {
            self.schedule(index);
        }
    }

    fn at_node(&mut self, station: StationId, act: impl FnOnce(&mut Node<S>, &mut Bus, VirtualInstant)) {
        let Some(index) = self.by_station.get(station.index()).copied().flatten() else { return };
        act(&mut self.nodes[index], &mut self.bus, self.now);
        self.schedule(index);
    }

    /// Entries that are out of date stay in the heap; waking then does nothing.
    fn schedule(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        let at = node.hard_wakes_at.min(node.soft_wakes_at);
        if node.scheduled_at != at {
            node.scheduled_at = at;
            if at < FAR_FUTURE {
                self.wakes.push(Reverse((at, index)));
            }
        }
    }
}
