//! Runs the firmware images on the emulated cluster and writes down what can be observed.

use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use std::{fmt, io};

use cosmic_bus::trace::Candump;
use cosmic_bus::{
    BitPosition, Bus, Chance, EventKind, Fault, FaultModel, Filter, Rule, VirtualInstant, WireFrame,
};
use cosmic_commands::demo::Elf;
use cosmic_core::can::{Command, Id, Priority, TxNode};
use cosmic_core::network::soft::PriorityMap;
use cosmic_core::time::{Duration, Instant};
use embedded_can::ExtendedId;
use thiserror::Error;

use crate::bus_log::BusLog;
use crate::clock::NodeClock;
use crate::cluster::Cluster as Judged;
use crate::handlers::Handlers;
use crate::hard;
use crate::journal::{Journal, LoggedError};
use crate::load::{Background, Share};
use crate::record::{Record, RecordError, Records};
use crate::span::Span;
use cosmic_emu::{ClockError, Cluster, LoadError, NodeConfig, NodeId, ObservationKind, Port, Station};

/// What a run is to be like.
#[derive(Clone, PartialEq, Debug)]
pub struct Plan {
    /// What runs.
    pub cluster: &'static Judged,
    /// The images.
    pub images: Images,
    /// How long it takes, in virtual time.
    pub length: Duration,
    /// All chance follows from it.
    pub seed: u64,
    /// The load of the bus as a whole.
    pub load: Share,
    /// The chance that a frame on the wire is destroyed.
    pub errors: Chance,
    /// Whether to write down when the handlers of the nodes run.
    pub handlers: bool,
    /// So many attempts are destroyed in a row in one hard real-time slot; 0 for none.
    pub burst: u32,
}

/// Where the images are.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Images {
    /// All in one folder; each has the name of its node.
    Folder(PathBuf),
    /// One by one.
    Files(Vec<Elf>),
}

impl Images {
    /// Each image must be of a node.
    fn all_of(&self, cluster: &Judged) -> Result<(), RunError> {
        let Self::Files(files) = self else { return Ok(()) };
        let is_strange = |elf: &&Elf| cluster.nodes.iter().all(|node| node.name != elf.node);
        let Some(strange) = files.iter().find(is_strange) else { return Ok(()) };
        let names: Vec<_> = cluster.nodes.iter().map(|node| node.name).collect();
        let (file, names) = (strange.file.clone(), names.join(", "));
        Err(RunError::NoNode { node: strange.node.clone(), file, cluster: cluster.name.clone(), names })
    }

    /// The image of a node.
    fn of(&self, node: &str) -> Option<PathBuf> {
        match self {
            Self::Folder(folder) => Some(folder.join(node)),
            Self::Files(files) => files.iter().find(|elf| elf.node == node).map(|elf| elf.file.clone()),
        }
    }
}

impl fmt::Display for Images {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder(folder) => write!(f, "images in {}", folder.display()),
            Self::Files(files) => {
                let files: Vec<_> = files.iter().map(|elf| elf.file.display().to_string()).collect();
                write!(f, "images {}", files.join(", "))
            }
        }
    }
}

/// A run cannot be done.
#[derive(Error, Debug)]
pub enum RunError {
    /// A node has no image.
    #[error("{node} has no image; name one of this name, or {node}=FILE")]
    NoImage {
        /// Which.
        node: &'static str,
    },
    /// An image is of no node.
    #[error("{}: {cluster} has no node `{node}`; write NODE={}, NODE being one of {names}", file.display(), file.display())]
    NoNode {
        /// Whose it would be.
        node: String,
        /// The image.
        file: PathBuf,
        /// The cluster.
        cluster: String,
        /// Its nodes.
        names: String,
    },
    /// An image cannot be run.
    #[error(transparent)]
    Image(#[from] LoadError),
    /// A node has stopped.
    #[error("{node} has stopped after {:.3} ms: {what}", at.as_ticks() as f64 / 1e6)]
    Stopped {
        /// Which.
        node: &'static str,
        /// When.
        at: VirtualInstant,
        /// Why and where.
        what: String,
    },
    /// The records of a node cannot be read.
    #[error("{node}: {error}")]
    Record {
        /// Which.
        node: &'static str,
        /// Why not.
        error: RecordError,
    },
    /// The timer of a node never ran, or not at the rate that local time is counted at.
    #[error(
        "{node}: TIM2 does not count at 4 MHz, so its local time is not known; the demo runs images for the boards \
         of the crate `boards`"
    )]
    NoClock {
        /// Which.
        node: &'static str,
    },
    /// The log cannot be written.
    #[error("the candump log cannot be written ({0}); make room, or name another directory with --out")]
    Log(#[from] io::Error),
}

/// Runs the cluster as planned, and writes the log of the bus. `reached` is called now and then.
///
/// # Errors
/// [`RunError`].
pub fn run(
    plan: &Plan,
    log: impl io::Write,
    mut reached: impl FnMut(VirtualInstant),
) -> Result<Journal, RunError> {
    let mut run = Run::start(plan, log)?;
    let end = VirtualInstant::from_ticks(0) + plan.length;
    let mut now = VirtualInstant::from_ticks(0);
    while now < end {
        run.plan_load(now);
        run.disturb(plan.burst, now, end);
        now = run.next_stop(now).min(end);
        run.cluster.run_until(now);
        run.observe()?;
        reached(now);
    }
    run.finish(end)
}

struct Run<W> {
    judged: &'static Judged,
    cluster: Cluster,
    nodes: Vec<Observed>,
    background: Rc<RefCell<Background>>,
    bus: BusLog,
    log: Candump<W>,
    records: Vec<(TxNode, Record)>,
    errors: Vec<LoggedError>,
    burst: Burst,
    handlers: Handlers,
}

struct Observed {
    id: NodeId,
    name: &'static str,
    tx_node: TxNode,
    records: Records,
    /// The first reading of its timer.
    first: Option<(Instant, VirtualInstant)>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Burst {
    Waiting,
    /// From, until.
    Planned(VirtualInstant, VirtualInstant),
    On(VirtualInstant),
    Over,
}

impl<W: io::Write> Run<W> {
    fn start(plan: &Plan, log: W) -> Result<Self, RunError> {
        let judged = plan.cluster;
        plan.images.all_of(judged)?;
        let bit_rate = judged.calendar.segment().bit_rate;
        let faults = FaultModel::seeded(plan.seed).with_inversion(plan.errors);
        let mut cluster = Cluster::new(Bus::new(bit_rate, faults));
        cluster.bus_mut().record_trace(true);
        let mut nodes = Vec::new();
        for (at, node) in judged.nodes.iter().enumerate() {
            let image = plan.images.of(node.name).ok_or(RunError::NoImage { node: node.name })?;
            let mut config = NodeConfig::new(node.name, image);
            let (start, drift) = difference(at);
            config.start_at = VirtualInstant::from_ticks(0) + start;
            config.clock_error = ClockError::parts_per_million(drift).unwrap_or_default();
            let id = cluster.add_node(config)?;
            if plan.handlers {
                cluster.watch_handlers(id);
            }
            let (name, tx_node, records) = (node.name, node.tx_node, Records::default());
            nodes.push(Observed { id, name, tx_node, records, first: None });
        }
        let map = PriorityMap::of_calendar(judged.calendar);
        let background =
            Rc::new(RefCell::new(Background::new(bit_rate, map, plan.load, plan.seed).beside(judged)));
        cluster.add_station(
            "background",
            Box::new(Loading { background: background.clone(), commands: vec![] }),
        );
        Ok(Self {
            judged,
            cluster,
            nodes,
            background,
            bus: BusLog::default(),
            log: Candump::new(log),
            records: Vec::new(),
            errors: Vec::new(),
            burst: Burst::Waiting,
            handlers: Handlers::default(),
        })
    }

    fn plan_load(&mut self, now: VirtualInstant) {
        let mut background = self.background.borrow_mut();
        if background.plans_at() <= now {
            background.plan(now, self.cluster.bus().accounting().busy_bits());
        }
    }

    fn next_stop(&self, now: VirtualInstant) -> VirtualInstant {
        let planned = self.background.borrow().plans_at();
        match self.burst {
            Burst::Planned(at, _) | Burst::On(at) if at > now => planned.min(at),
            _ => planned,
        }
    }

    /// Destroys the attempts to send the first slot's frame in one window, at 60 % of the run.
    fn disturb(&mut self, count: u32, now: VirtualInstant, end: VirtualInstant) {
        if count == 0 {
            return;
        }
        match self.burst {
            Burst::Waiting if now.as_ticks() / 3 >= end.as_ticks() / 5 => {
                if let Some((from, until)) = self.next_window(now) {
                    self.burst = Burst::Planned(from, until);
                }
            }
            Burst::Planned(from, until) if from <= now => {
                let Some(slot) = self.judged.calendar.slots().first() else { return };
                let id = Id::new(Priority::HARD, slot.publisher, slot.etag);
                // Not replaced: a COSMIC identifier has 29 bits.
                let id = ExtendedId::new(id.raw()).unwrap_or(ExtendedId::ZERO);
                // In the CRC: the attempt takes its whole time.
                let fault = Fault::Inverted(BitPosition::FromEnd(12));
                let rule = Rule { frames: Filter::exactly(id.into()), skip: 0, count, fault };
                self.cluster.bus_mut().faults_mut().add_rule(rule);
                self.burst = Burst::On(until);
            }
            Burst::On(until) if until <= now => {
                self.cluster.bus_mut().faults_mut().clear_rules();
                self.burst = Burst::Over;
            }
            _ => {}
        }
    }

    /// The next window of the first slot, with some time around it.
    fn next_window(&self, now: VirtualInstant) -> Option<(VirtualInstant, VirtualInstant)> {
        let journal = self.journal(now).ok()?;
        let slot = self.judged.calendar.slots().first()?;
        let last = *hard::windows(&journal, &journal.timeline(), slot).last()?;
        let periods = Span::between(last.ready, now).as_nanos() / Span::from(slot.period).as_nanos() + 1;
        let later = Duration::from_ticks(periods.unsigned_abs() * slot.period.as_ticks());
        let around = Duration::from_micros(300);
        let from = Span::from(around);
        Some(((-from).after(last.ready + later), last.delivery + later + around))
    }

    fn observe(&mut self) -> Result<(), RunError> {
        let mut trace = Vec::new();
        self.cluster.bus_mut().take_trace(&mut trace);
        for event in &trace {
            self.log.write(event)?;
            self.bus.take(event);
        }
        for seen in self.cluster.take_observations() {
            let Some(node) = self.nodes.get_mut(seen.node.index()) else { continue };
            match seen.kind {
                ObservationKind::Record { channel, bytes } if channel == cosmic_records::CHANNEL => {
                    let mut records = Vec::new();
                    let read = node.records.take(&bytes, &mut records);
                    read.map_err(|error| RunError::Record { node: node.name, error })?;
                    self.records.extend(records.into_iter().map(|record| (node.tx_node, record)));
                }
                ObservationKind::Stopped { .. } | ObservationKind::WrongBitRate { .. } => {
                    let (node, at, what) = (node.name, seen.at, seen.kind.to_string());
                    return Err(RunError::Stopped { node, at, what });
                }
                ObservationKind::Handler { exception, priority, begins } => {
                    let name = || self.cluster.handler(node.id, exception);
                    self.handlers.take((node.tx_node, exception, priority), begins, seen.at, name);
                }
                ObservationKind::Log(line) if line.level == "ERROR" => {
                    self.errors.push(LoggedError { node: node.tx_node, at: seen.at, text: line.message });
                }
                ObservationKind::NotModelled { .. } | ObservationKind::NotClocked { .. } => {
                    let text = seen.kind.to_string();
                    self.errors.push(LoggedError { node: node.tx_node, at: seen.at, text });
                }
                _ => {}
            }
        }
        for node in &mut self.nodes {
            node.first = node.first.or_else(|| reading(&self.cluster, node.id));
        }
        Ok(())
    }

    /// The straight lines through the first and the present readings of the timers.
    fn clocks(&self) -> Result<Vec<(TxNode, NodeClock)>, RunError> {
        let clock = |node: &Observed| {
            let clock = NodeClock::through(node.first?, reading(&self.cluster, node.id)?)?;
            let off = clock.local(FAR).signed_since(clock.local(NEAR)) - Span::between(NEAR, FAR).as_nanos();
            (off.abs() < LARGEST_ERROR.as_nanos()).then_some((node.tx_node, clock))
        };
        let clocks = self.nodes.iter().map(|node| clock(node).ok_or(RunError::NoClock { node: node.name }));
        clocks.collect()
    }

    fn journal(&self, end: VirtualInstant) -> Result<Journal, RunError> {
        Ok(Journal {
            cluster: self.judged,
            bit_rate: self.cluster.bus().bit_rate(),
            bus: self.bus.clone(),
            accounting: self.cluster.bus().accounting().clone(),
            records: self.records.clone(),
            clocks: self.clocks()?,
            stations: self.nodes.iter().map(|node| (node.tx_node, self.cluster.station(node.id))).collect(),
            background: self.background.borrow().log().clone(),
            handlers: self.handlers.runs.clone(),
            errors: self.errors.clone(),
            end,
        })
    }

    fn finish(self, end: VirtualInstant) -> Result<Journal, RunError> {
        let journal = self.journal(end)?;
        self.log.into_inner().flush()?;
        Ok(journal)
    }
}

/// The timer of a node as local time, and since when it has shown that.
fn reading(cluster: &Cluster, node: NodeId) -> Option<(Instant, VirtualInstant)> {
    let (count, since) = cluster.tim2(node)?;
    Some((Instant::from_epoch(TICK * count), since))
}

/// The background load as a station of the cluster.
struct Loading {
    background: Rc<RefCell<Background>>,
    commands: Vec<Command>,
}

impl Loading {
    fn carry_out(&mut self, port: &mut Port<'_>) {
        self.background.borrow_mut().act(port.now(), &mut self.commands);
        for command in self.commands.drain(..) {
            match command {
                Command::Load(mailbox, frame) => {
                    let loaded = port.load(mailbox as usize, WireFrame::from(frame));
                    debug_assert!(loaded, "the core loads a mailbox only when it is empty");
                }
                Command::Withdraw(mailbox) => port.withdraw(mailbox as usize),
            }
        }
    }
}

impl Station for Loading {
    fn acts_at(&self) -> Option<VirtualInstant> {
        Some(self.background.borrow().acts_at())
    }

    fn act(&mut self, port: &mut Port<'_>) {
        self.carry_out(port);
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        self.background.borrow_mut().on_event(event, port.now());
        self.carry_out(port);
    }
}

/// When the node with this number is switched on, and how many millionths its crystal is off: no two are alike.
fn difference(number: usize) -> (Duration, i32) {
    DIFFERENCES.get(number).copied().unwrap_or_else(|| {
        // The steps have no divisor in common with the ranges.
        let start = Duration::from_micros(700 + number as u64 * 1_700 % 9_973);
        (start, (number * 31 % 81) as i32 - 40)
    })
}

/// Of the first nodes.
const DIFFERENCES: [(Duration, i32); 3] = [
    (Duration::from_micros(1_300), 40),
    (Duration::from_micros(200), -35),
    (Duration::from_micros(4_700), 20),
];
/// Of the timer that counts local time (`boards/src/clock.rs`).
const TICK: Duration = Duration::from_ticks(250);
const NEAR: VirtualInstant = VirtualInstant::from_ticks(0);
const FAR: VirtualInstant = VirtualInstant::from_ticks(1_000_000_000);
/// In a second: as much as an internal oscillator may be off.
const LARGEST_ERROR: Span = Span::from_nanos(10_000_000);
