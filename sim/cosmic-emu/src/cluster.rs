//! Several nodes on one bus, in virtual time.
//!
//! Nodes influence each other only through the bus, and the bus says how long nothing will be heard of it
//! whatever is loaded ([`Bus::quiet_until`]). So the node that is furthest behind always runs next, on its
//! own, up to that instant: exact at the level of frames, and independent of how fast anything runs on the
//! host. A node that asks for something with an immediate answer, such as a withdrawal, stops and waits
//! until all others have caught up. One seed gives one sequence of observations, byte for byte.

use cosmic_bus::{Bus, BusOffRecovery, Event, StationId, VirtualInstant, time};

use cosmic_core::time::Duration;

use crate::image::LoadError;
use crate::node::Node;
use crate::node_config::NodeConfig;
use crate::observation::{Masked, NodeId, Observation, ObservationKind, ResetCause};
use crate::soc::can::Command;
use crate::station::{Port, Station};

/// Emulated nodes and other stations on one bus.
///
/// Call [`add_node`](Self::add_node) and [`add_station`](Self::add_station), then
/// [`run_until`](Self::run_until) as often as wanted, and [`take_observations`](Self::take_observations)
/// in between. The trace of the bus is taken from [`bus_mut`](Self::bus_mut).
pub struct Cluster {
    bus: Bus,
    nodes: Vec<(Node, StationId)>,
    stations: Vec<(Box<dyn Station>, StationId)>,
    /// What each of the bus's stations is, by its index.
    owners: Vec<Owner>,
    /// Commands that lie ahead of the bus, in the order in which the bus will get them.
    commands: Vec<(VirtualInstant, NodeId, Command)>,
    events: Vec<Event>,
    observations: Vec<Observation>,
}

#[derive(Clone, Copy, Debug)]
enum Owner {
    Node(usize),
    Station(usize),
}

/// There is no function of this name in the firmware of the node.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("no function {name} in the firmware; it may have been inlined: mark it #[inline(never)]")]
pub struct NoSuchFunction {
    /// What was asked for.
    pub name: String,
}

/// Two clusters were not joined: they have different bit rates, or one of the two buses was never free.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the two buses have different bit rates, or were never free at one instant")]
pub struct NotJoined;

/// Until two buses are free at one instant: no longer, however busy they are.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

impl Cluster {
    /// A cluster on this bus, without nodes.
    pub fn new(bus: Bus) -> Self {
        let owners = Vec::new();
        let (nodes, stations) = (Vec::new(), Vec::new());
        let (commands, events, observations) = (Vec::new(), Vec::new(), Vec::new());
        Self { bus, nodes, stations, owners, commands, events, observations }
    }

    /// Adds a node; it is switched on at its `start_at`.
    ///
    /// # Errors
    /// [`LoadError`] if its firmware cannot be run.
    pub fn add_node(&mut self, config: NodeConfig) -> Result<NodeId, LoadError> {
        let (name, start_at) = (config.name.clone(), config.start_at);
        let node = Node::new(config)?;
        let station = self.bus.attach(name);
        // It joins the bus when its firmware says so.
        self.bus.disconnect(start_at.min(self.bus.now()), station);
        self.bus.set_bus_off_recovery(station, BusOffRecovery::OnRequest);
        self.owners.push(Owner::Node(self.nodes.len()));
        self.nodes.push((node, station));
        Ok(NodeId(self.nodes.len() - 1))
    }

    /// Adds a station that has no processor, for example a source of background load.
    pub fn add_station(&mut self, name: impl Into<String>, station: Box<dyn Station>) -> StationId {
        let id = self.bus.attach(name);
        self.owners.push(Owner::Station(self.stations.len()));
        self.stations.push((station, id));
        id
    }

    /// Plugs in the cable to another running cluster: from now on there is one bus, this one, with the nodes and stations
    /// of both. Both first come to one instant, and on to the next at which no frame is on either bus. Returns the nodes of
    /// the other as they are called from now on, in the order in which they were added to it.
    ///
    /// # Errors
    /// [`NotJoined`].
    pub fn join(&mut self, mut other: Self) -> Result<Vec<NodeId>, NotJoined> {
        let start = self.bus.now().max(other.bus.now());
        let mut at = start;
        while at < start + LONGEST_WAIT {
            self.run_until(at);
            other.run_until(at);
            if self.bus.is_free() && other.bus.is_free() {
                return self.take_over(other);
            }
            at += self.bus.bit_rate().bit_time();
        }
        Err(NotJoined)
    }

    fn take_over(&mut self, other: Self) -> Result<Vec<NodeId>, NotJoined> {
        let (nodes, stations) = (self.nodes.len(), self.stations.len());
        let theirs = self.bus.join(other.bus).map_err(|_| NotJoined)?;
        let on_bus = |station: StationId| theirs[station.index()];
        let moved = |node: NodeId| NodeId(node.0 + nodes);
        let all = other.nodes.len();
        self.nodes.extend(other.nodes.into_iter().map(|(node, station)| (node, on_bus(station))));
        self.stations.extend(other.stations.into_iter().map(|(it, station)| (it, on_bus(station))));
        self.owners.extend(other.owners.into_iter().map(|owner| match owner {
            Owner::Node(node) => Owner::Node(node + nodes),
            Owner::Station(station) => Owner::Station(station + stations),
        }));
        self.commands
            .extend(other.commands.into_iter().map(|(at, node, command)| (at, moved(node), command)));
        let observations = other.observations.into_iter();
        self.observations.extend(observations.map(|it| Observation { node: moved(it.node), ..it }));
        Ok((nodes..nodes + all).map(NodeId).collect())
    }

    /// The bus: its trace, accounting, error states.
    pub const fn bus(&self) -> &Bus {
        &self.bus
    }

    /// The bus, for example to take its trace or to add a fault. It must not be advanced, nor given frames.
    pub const fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// The station of a node on the bus.
    pub fn station(&self, node: NodeId) -> StationId {
        self.nodes[node.0].1
    }

    /// Instructions that a node has executed.
    pub fn instructions(&self, node: NodeId) -> u64 {
        self.nodes[node.0].0.pace().instructions()
    }

    /// Cycles of its core clock that a node has been awake since it started: it executed instructions, or entered or left
    /// handlers, and did not wait in a WFI.
    pub fn awake(&self, node: NodeId) -> u64 {
        self.nodes[node.0].0.pace().awake()
    }

    /// What the counter of TIM2 of a node shows, as a debug probe would read it, and the true instant since
    /// when it shows that; `None` while the timer stands. Relates the local time of firmware that counts it
    /// there to true time.
    pub fn tim2(&self, node: NodeId) -> Option<(u32, VirtualInstant)> {
        self.nodes[node.0].0.tim2()
    }

    /// Returns whether the node has stopped, by a fault or because it was switched off.
    pub fn is_stopped(&self, node: NodeId) -> bool {
        self.nodes[node.0].0.is_stopped()
    }

    /// Watches for a function of a node's firmware: every call is an [`ObservationKind::Reached`], with the
    /// number of instructions executed before it. `function` is its full path, or the end of it.
    ///
    /// # Errors
    /// [`NoSuchFunction`].
    pub fn watch(&mut self, node: NodeId, function: &str) -> Result<(), NoSuchFunction> {
        let node = &self.nodes[node.0].0;
        let found = node.image().function(function);
        let address = found.ok_or_else(|| NoSuchFunction { name: function.to_owned() })?;
        node.pace().add_probe(address);
        Ok(())
    }

    /// Watches for the instruction at an address of a node's firmware.
    pub fn watch_address(&mut self, node: NodeId, pc: u32) {
        self.nodes[node.0].0.pace().add_probe(pc & !1);
    }

    /// From now on, measure for how long interrupts of a priority, as NVIC has it, are masked at a node.
    pub fn watch_masks(&mut self, node: NodeId, priority: u8) {
        self.nodes[node.0].0.pace().watch_masks(priority);
    }

    /// For how long interrupts of that priority were masked at most, by whatever they would pre-empt: one entry for
    /// each place in the program, the longest first. Changes of the masks by exception entry and return are not
    /// looked at, since only FAULTMASK has any.
    pub fn longest_masked(&self, node: NodeId) -> Vec<Masked> {
        self.nodes[node.0].0.longest_masked()
    }

    /// From now on, say when the handlers of a node begin and end to run ([`ObservationKind::Handler`]). They are the
    /// tasks of an RTIC application.
    pub fn watch_handlers(&mut self, node: NodeId) {
        self.nodes[node.0].0.watch_handlers();
    }

    /// The name of the function that handles an exception in the firmware of a node.
    pub fn handler(&self, node: NodeId, exception: u16) -> Option<String> {
        self.nodes[node.0].0.handler(exception)
    }

    /// Cuts the power of a node at the present instant.
    pub fn power_off(&mut self, node: NodeId) {
        self.nodes[node.0].0.power_off();
        self.cut_off(node);
    }

    /// Nothing of a node is on the bus any more, nor on its way there.
    fn cut_off(&mut self, node: NodeId) {
        let (at, station) = (self.bus.now(), self.nodes[node.0].1);
        self.bus.disconnect(at, station);
        self.bus.reset(at, station);
        self.bus.set_bus_off_recovery(station, BusOffRecovery::OnRequest);
        self.commands.retain(|(_, owner, _)| *owner != node);
    }

    /// Switches a node off and on again at the present instant.
    pub fn restart(&mut self, node: NodeId) {
        self.power_off(node);
        self.nodes[node.0].0.restart(self.bus.now());
    }

    /// What was seen since the last call, in the order of time; of one instant in the order of nodes.
    pub fn take_observations(&mut self) -> Vec<Observation> {
        let mut observations = std::mem::take(&mut self.observations);
        observations.sort_by_key(|observation| (observation.at, observation.node));
        observations
    }

    /// Pulls the reset pin of a node at the present instant: its power stays on. One that is off stays off.
    pub fn reset(&mut self, node: NodeId) {
        let at = self.bus.now();
        let it = &mut self.nodes[node.0].0;
        if it.is_off() {
            return;
        }
        it.note(at, ObservationKind::Reset(ResetCause::Pin));
        self.cut_off(node);
        self.nodes[node.0].0.reset(at, ResetCause::Pin);
    }

    /// The crystal of a node fails at the present instant, or begins to oscillate again. If the firmware has switched the
    /// clock security system on, it is told of a failure (RM0090, 7.2.7).
    pub fn set_crystal(&mut self, node: NodeId, runs: bool) {
        let at = self.bus.now();
        self.nodes[node.0].0.set_crystal(at, runs);
    }

    /// The supply of a node sinks below the threshold of the voltage detector at the present instant, or rises above it. If
    /// the firmware has switched the detector on, it is told (RM0090, 5.2.3).
    pub fn set_supply(&mut self, node: NodeId, is_low: bool) {
        let at = self.bus.now();
        self.nodes[node.0].0.set_supply(at, is_low);
    }

    /// Lets time pass until `to`. Nodes stop within a few cycles of it.
    pub fn run_until(&mut self, to: VirtualInstant) {
        loop {
            let (next, actor) = self.next_actor();
            let horizon = next.min(to);
            self.give_commands(horizon);
            if let Some(at) = self.bus.next_event()
                && at <= horizon
            {
                self.advance_bus(at);
                continue;
            }
            self.advance_bus(horizon);
            match actor {
                _ if next >= to => break,
                Some(Owner::Node(node)) => self.run_node(node, to),
                Some(Owner::Station(station)) => self.run_station(station),
                None => break,
            }
        }
        for node in 0..self.nodes.len() {
            self.nodes[node].0.drain();
            self.collect(node);
        }
    }

    /// Who acts next by itself, and when.
    fn next_actor(&self) -> (VirtualInstant, Option<Owner>) {
        let mut first = (time::FAR_FUTURE, None);
        for (n, (node, _)) in self.nodes.iter().enumerate() {
            let at = node.acts_at();
            if at < first.0 {
                first = (at, Some(Owner::Node(n)));
            }
        }
        for (n, (station, _)) in self.stations.iter().enumerate() {
            if let Some(at) = station.acts_at()
                && at < first.0
            {
                first = (at, Some(Owner::Station(n)));
            }
        }
        first
    }

    fn run_node(&mut self, node: usize, to: VirtualInstant) {
        let until = self.bus.quiet_until().min(to);
        self.nodes[node].0.run(until);
        if let Some(cause) = self.nodes[node].0.wants_reset() {
            self.reset_node(node, cause);
        }
        self.collect(node);
    }

    fn reset_node(&mut self, node: usize, cause: ResetCause) {
        let at = self.nodes[node].0.now();
        self.collect(node);
        let id = NodeId(node);
        self.commands.push((at, id, Command::Disconnect));
        self.commands.push((at, id, Command::Reset));
        self.nodes[node].0.note(at, ObservationKind::Reset(cause));
        self.nodes[node].0.reset(at, cause);
    }

    fn run_station(&mut self, station: usize) {
        let (station, id) = &mut self.stations[station];
        station.act(&mut Port::new(&mut self.bus, *id));
    }

    /// Moves what a node said to the queues of the cluster.
    fn collect(&mut self, node: usize) {
        let id = NodeId(node);
        let node = &mut self.nodes[node].0;
        self.commands.extend(node.take_commands().into_iter().map(|(at, command)| (at, id, command)));
        let seen = node.take_seen().into_iter();
        self.observations.extend(seen.map(|(at, kind)| Observation { at, node: id, kind }));
    }

    /// Hands all commands until `until` to the bus.
    fn give_commands(&mut self, until: VirtualInstant) {
        if self.commands.is_empty() {
            return;
        }
        // A stable sort: the commands of one node stay in order.
        self.commands.sort_by_key(|(at, node, _)| (*at, *node));
        let due = self.commands.partition_point(|(at, ..)| *at <= until);
        let due: Vec<_> = self.commands.drain(..due).collect();
        for (at, node, command) in due {
            self.give_command(at, node, command);
        }
    }

    fn give_command(&mut self, at: VirtualInstant, id: NodeId, command: Command) {
        let (node, station) = &mut self.nodes[id.0];
        let (bus, station) = (&mut self.bus, *station);
        match command {
            Command::Connect => {
                let bits_per_second = node.can_bits_per_second();
                if bits_per_second == bus.bit_rate().bits_per_second() {
                    bus.connect(at, station);
                } else {
                    node.note(at, ObservationKind::WrongBitRate { bits_per_second });
                }
            }
            Command::Disconnect => bus.disconnect(at, station),
            Command::Reset => {
                bus.reset(at, station);
                bus.set_bus_off_recovery(station, BusOffRecovery::OnRequest);
            }
            Command::RecoverAutomatically(automatically) => {
                let recovery =
                    if automatically { BusOffRecovery::Automatic } else { BusOffRecovery::OnRequest };
                bus.set_bus_off_recovery(station, recovery);
            }
            Command::RequestRecovery => bus.request_recovery(at, station),
            // The controller's mailboxes mirror those of the bus, so the mailbox is free.
            Command::Load { mailbox, frame } => {
                let _ = bus.load(at, station, mailbox, frame);
            }
            Command::Withdraw { mailbox } => bus.withdraw(at, station, mailbox),
        }
    }

    fn advance_bus(&mut self, to: VirtualInstant) {
        let mut events = std::mem::take(&mut self.events);
        self.bus.advance(to, &mut events);
        let any = !events.is_empty();
        for event in events.drain(..) {
            self.dispatch(&event);
        }
        self.events = events;
        if any {
            // Counters change without an event of their own, but only when somebody has one.
            for (node, station) in &mut self.nodes {
                node.set_errors(self.bus.error_state(*station));
            }
        }
    }

    fn dispatch(&mut self, event: &Event) {
        let Some(owner) = self.owners.get(event.station.index()).copied() else { return };
        match owner {
            Owner::Node(node) => {
                self.nodes[node].0.deliver(event.at, &event.kind, self.bus.bit_rate().bit_time());
                self.collect(node);
            }
            Owner::Station(station) => {
                let (station, id) = &mut self.stations[station];
                station.on_event(&event.kind, &mut Port::new(&mut self.bus, *id));
            }
        }
    }
}
