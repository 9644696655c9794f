//! Random clusters that configure themselves: nodes without ids, a broker and a standby, channels that are
//! bound at run time, and whatever may happen to them, all from one seed.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::trace::TraceEvent;
use cosmic_bus::{BitPosition, Bus, Chance, Fault, FaultModel, Filter, Rule, StationId, VirtualInstant};
use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, Content, Depth, Event, ExceptionKind, Filter as EventFilter, HardAttributes, Importance,
    NonRealTimeAttributes, Policy, Publication, PublishError, SoftAttributes, Subscription,
};
use cosmic_core::protocol::{Lease, Rank};
use cosmic_core::services::{self, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use embedded_can::{ExtendedId, Id};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

pub(crate) type Full = NodeServices<64, 128, 16, 128, Option<Broker<16, 32>>>;

/// Four soft real-time channels, two non real-time ones, and the one on which a node babbles. Those with an
/// odd number carry 32 bits, the others 64.
pub(crate) const CHANNELS: u8 = 7;
const BABBLE: u8 = 6;
const FIRST_NON_REAL_TIME: u8 = 4;
pub(crate) const MILLISECOND: u64 = 1_000_000;
/// So long an interest holds that nobody refreshes.
const LEASE: Lease = Lease::new(Duration::from_secs(2)).unwrap();

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(12),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: TxNode::new(1).unwrap(),
        len: 4,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(0),
    }],
);

const HARD: Channel<u32> = Channel::hard(
    Subject::new(0xA).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
);

/// Numbers drawn from a seed.
pub(crate) struct Dice(Pcg64Mcg);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    pub(crate) fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }
}

/// An event as it tells itself: its channel, its publisher, and its number there.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub(crate) struct Label {
    pub(crate) channel: u8,
    pub(crate) node: u8,
    pub(crate) number: u32,
}

impl Label {
    fn wide(self) -> u64 {
        u64::from(self.channel) << 56 | u64::from(self.node) << 48 | u64::from(self.number)
    }

    fn narrow(self) -> u32 {
        u32::from(self.channel) << 28 | u32::from(self.node) << 24 | self.number
    }

    /// From the bytes of a frame.
    pub(crate) fn read(bytes: &[u8]) -> Option<Self> {
        match *bytes {
            [first, b1, b2, b3] => Some(Self {
                channel: first >> 4,
                node: first & 0xF,
                number: u32::from_be_bytes([0, b1, b2, b3]),
            }),
            [channel, node, 0, 0, b0, b1, b2, b3] => {
                Some(Self { channel, node, number: u32::from_be_bytes([b0, b1, b2, b3]) })
            }
            _ => None,
        }
    }
}

/// What a subscriber got.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Delivery {
    pub(crate) node: u8,
    /// The channel of the subscription.
    pub(crate) channel: u8,
    pub(crate) label: Label,
    pub(crate) at: VirtualInstant,
}

/// What a node knew at some instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) at: VirtualInstant,
    pub(crate) start: u32,
    pub(crate) etags: [Option<Etag>; CHANNELS as usize],
}

/// What all applications saw.
#[derive(Default)]
pub(crate) struct Journal {
    /// Switched on by the harness: nobody publishes any more.
    pub(crate) calm: bool,
    /// Switched on by the harness: this node publishes far more than the bus takes.
    pub(crate) babbling: Option<u8>,
    pub(crate) deliveries: Vec<Delivery>,
    pub(crate) samples: HashMap<u8, Vec<Sample>>,
    /// Accepted publications by node, start and channel.
    pub(crate) accepted: HashMap<(u8, u32, u8), u32>,
    /// The last number that a node has published.
    numbers: HashMap<u8, u32>,
    pub(crate) starts: HashMap<u8, u32>,
    /// Events whose content was none of their channel's.
    pub(crate) malformed: Vec<(u8, VirtualInstant)>,
    /// Full queues of subscribers, by node and channel.
    pub(crate) overflows: HashMap<(u8, u8), u32>,
    pub(crate) hard: HashMap<u8, u32>,
}

pub(crate) type Shared = Rc<RefCell<Journal>>;

/// What a node does on each channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Roles {
    pub(crate) publishes: [bool; CHANNELS as usize],
    pub(crate) subscribes: [bool; CHANNELS as usize],
}

pub(crate) struct Scenario {
    pub(crate) cluster: Cluster<Full>,
    pub(crate) journal: Shared,
    pub(crate) stations: Vec<StationId>,
    pub(crate) roles: Vec<Roles>,
    pub(crate) trace: Vec<TraceEvent>,
    /// When a node came back to the others, or might have missed what they agreed on.
    pub(crate) unions: Vec<VirtualInstant>,
    pub(crate) dice: Dice,
}

impl Scenario {
    pub(crate) fn new(seed: u64) -> Self {
        let mut dice = Dice::new(seed);
        let errors = [0.0, 0.001, 0.01, 0.03][dice.below(4) as usize];
        let omissions = [0.0, 0.001, 0.01][dice.below(3) as usize];
        let faults = FaultModel::seeded(seed)
            .with_inversion(Chance::new(errors).unwrap())
            .with_omission(Chance::new(omissions).unwrap());
        let mut bus = Bus::new(BitRate::MAX, faults);
        bus.record_trace(true);
        let mut cluster = Cluster::new(bus, seed);
        let journal = Shared::default();
        let count = 4 + dice.below(5) as u8;
        let mut roles = Vec::new();
        let mut stations = Vec::new();
        for number in 1..=count {
            let mut drawn =
                Roles { publishes: [false; CHANNELS as usize], subscribes: [false; CHANNELS as usize] };
            for channel in 0..BABBLE {
                drawn.publishes[usize::from(channel)] = dice.below(3) == 0;
                drawn.subscribes[usize::from(channel)] = dice.below(2) == 0;
            }
            drawn.publishes[usize::from(BABBLE)] = number == count;
            roles.push(drawn);
            let node = node(number, drawn, &mut dice, &journal);
            stations.push(cluster.add(node));
        }
        for station in &stations {
            cluster.power_on(*station);
            let pause = VirtualInstant::from_ticks(cluster.now().as_ticks() + dice.below(50 * MILLISECOND));
            cluster.run_until(pause);
        }
        let unions = vec![cluster.now()];
        Self { cluster, journal, stations, roles, trace: Vec::new(), unions, dice }
    }

    pub(crate) fn advance(&mut self, milliseconds: u64) {
        let until = VirtualInstant::from_ticks(self.cluster.now().as_ticks() + milliseconds * MILLISECOND);
        self.cluster.run_until(until);
        self.cluster.bus().take_trace(&mut self.trace);
    }

    /// Something happens to a random node.
    pub(crate) fn disrupt(&mut self) {
        let index = self.dice.below(self.stations.len() as u64) as usize;
        let station = self.stations[index];
        let span = 1 + self.dice.below(3_000);
        match self.dice.below(5) {
            0 => self.cluster.power_on(station),
            1 => {
                self.cluster.power_off(station);
                self.advance(span);
                self.cluster.power_on(station);
            }
            2 => {
                self.cluster.disconnect(station);
                self.advance(span);
                self.cluster.connect(station);
            }
            3 => self.drive_off_the_bus(station),
            _ => {
                self.journal.borrow_mut().babbling = Some(self.stations.len() as u8);
                self.advance(span / 3);
                self.journal.borrow_mut().babbling = None;
            }
        }
        self.unions.push(self.cluster.now());
        let pause = self.dice.below(1_500);
        self.advance(pause);
    }

    /// Destroys the frames of a node until it is bus-off.
    fn drive_off_the_bus(&mut self, station: StationId) {
        let tx_node = self.cluster.visit(station, |node| node.half().services().tx_node()).flatten();
        let Some(tx_node) = tx_node else { return };
        let id = ExtendedId::new(u32::from(tx_node.get()) << 14).unwrap();
        let frames = Filter::new(Id::Extended(id), false, 0x7F << 14);
        let fault = Fault::Inverted(BitPosition::Drawn);
        self.cluster.bus().faults_mut().add_rule(Rule { frames, skip: 0, count: 40, fault });
        self.advance(200);
        self.cluster.bus().faults_mut().clear_rules();
    }
}

pub(crate) fn subject(channel: u8) -> Subject {
    Subject::new(0xC0 + u64::from(channel)).unwrap()
}

fn channel<C: Content>(number: u8) -> Channel<C> {
    if number < FIRST_NON_REAL_TIME || number == BABBLE {
        let (deadline, validity) = if number == BABBLE { (1, 4) } else { (3 + u64::from(number), 40) };
        let [deadline, validity] = [deadline, validity].map(Duration::from_millis);
        return Channel::soft(subject(number), SoftAttributes { deadline, validity });
    }
    let validity = Some(Duration::from_millis(300));
    let attributes = NonRealTimeAttributes { importance: Importance::MOST, validity };
    Channel::non_real_time(subject(number), attributes)
}

fn node(number: u8, roles: Roles, dice: &mut Dice, journal: &Shared) -> NodeConfig<Full> {
    // The publisher in the calendar, which hosts the first broker, and the standby.
    let tx_node = if number <= 2 { TxNode::new(number) } else { None };
    let drift = dice.below(200_001) as i32 - 100_000;
    let period = Duration::from_millis(4 + dice.below(12));
    let noise = dice.below(1 << 32);
    let journal = journal.clone();
    // The UIDs are not in the order of the numbers, so that either broker may be the one that stays.
    let uid = NodeUid::new(0xC05_0000 + dice.below(1 << 16) * 16 + u64::from(number)).unwrap();
    NodeConfig {
        name: format!("node {number}"),
        tx_node,
        calendar: &CALENDAR,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(drift)),
        services: Box::new(move |now| {
            let config = services::NodeConfig {
                tx_node,
                noise,
                clock: SyncConfig { rank: Rank::new(number - 1), ..SyncConfig::DEFAULT },
                lease: LEASE,
                ..services::NodeConfig::new(uid)
            };
            let broker =
                (number <= 2).then(|| Broker::new(uid, BrokerTiming::DEFAULT, Nodes::new(), Subjects::new()));
            Full::new(&config, &CALENDAR, broker, now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            let start = *journal.borrow_mut().starts.entry(number).and_modify(|it| *it += 1).or_insert(1);
            Box::new(App {
                number,
                start,
                roles,
                period,
                journal: journal.clone(),
                hard: None,
                hard_in: None,
                wide: Vec::new(),
                narrow: Vec::new(),
                wide_in: Vec::new(),
                narrow_in: Vec::new(),
            })
        }),
    }
}

struct App {
    number: u8,
    start: u32,
    roles: Roles,
    period: Duration,
    journal: Shared,
    hard: Option<Publication<u32>>,
    hard_in: Option<Subscription<u32>>,
    wide: Vec<(u8, Publication<u64>)>,
    narrow: Vec<(u8, Publication<u32>)>,
    wide_in: Vec<(u8, Subscription<u64>)>,
    narrow_in: Vec<(u8, Subscription<u32>)>,
}

impl App {
    fn publish(&mut self, node: &mut Access<'_, Full>, journal: &mut Journal, babble: bool) {
        let App { number: own, start, .. } = *self;
        let mut next = |channel| {
            let number = journal.numbers.entry(own).and_modify(|it| *it += 1).or_insert(0);
            Label { channel, node: own, number: *number }
        };
        let mut outcomes = Vec::new();
        for (channel, publication) in self.wide.iter().filter(|(channel, _)| (*channel == BABBLE) == babble) {
            outcomes.push((*channel, node.publish(publication, &Event::new(next(*channel).wide()))));
        }
        for (channel, publication) in self.narrow.iter().filter(|_| !babble) {
            outcomes.push((*channel, node.publish(publication, &Event::new(next(*channel).narrow()))));
        }
        for (channel, outcome) in outcomes {
            match outcome {
                Ok(()) => *journal.accepted.entry((own, start, channel)).or_default() += 1,
                Err(PublishError::NotBound | PublishError::QueueFull) => {}
                Err(error) => panic!("{error:?}"),
            }
        }
    }

    fn take_events(&self, node: &mut Access<'_, Full>, journal: &mut Journal) {
        let mut got = Vec::new();
        for (channel, subscription) in &self.wide_in {
            while let Some(event) = node.next(subscription) {
                got.push((*channel, Label::read(&event.content.to_be_bytes())));
            }
        }
        for (channel, subscription) in &self.narrow_in {
            while let Some(event) = node.next(subscription) {
                got.push((*channel, Label::read(&event.content.to_be_bytes())));
            }
        }
        for (channel, label) in got {
            let label = label.expect("an event of these applications");
            journal.deliveries.push(Delivery { node: self.number, channel, label, at: node.true_now });
        }
    }
}

impl Application<Full> for App {
    fn start(&mut self, node: &mut Access<'_, Full>) -> Instant {
        let fifo = Policy::Fifo(Depth::new(4).unwrap());
        self.hard = if self.number == 1 { Some(node.announce(&HARD).unwrap()) } else { None };
        self.hard_in = Some(node.subscribe(&HARD, EventFilter::ALL, fifo).unwrap());
        for number in 0..CHANNELS {
            let index = usize::from(number);
            let (publishes, subscribes) = (self.roles.publishes[index], self.roles.subscribes[index]);
            if number % 2 == 0 {
                let channel = channel::<u64>(number);
                self.wide.extend(publishes.then(|| (number, node.announce(&channel).unwrap())));
                let subscribed = || (number, node.subscribe(&channel, EventFilter::ALL, fifo).unwrap());
                self.wide_in.extend(subscribes.then(subscribed));
            } else {
                let channel = channel::<u32>(number);
                self.narrow.extend(publishes.then(|| (number, node.announce(&channel).unwrap())));
                let subscribed = || (number, node.subscribe(&channel, EventFilter::ALL, fifo).unwrap());
                self.narrow_in.extend(subscribes.then(subscribed));
            }
        }
        node.now + self.period
    }

    fn wake(&mut self, node: &mut Access<'_, Full>) -> Instant {
        let journal = self.journal.clone();
        let mut journal = journal.borrow_mut();
        let etags = std::array::from_fn(|at| node.half().services().etag_of(subject(at as u8)));
        let sample = Sample { at: node.true_now, start: self.start, etags };
        journal.samples.entry(self.number).or_default().push(sample);
        if journal.babbling == Some(self.number) {
            for _ in 0..20 {
                self.publish(node, &mut journal, true);
            }
            return node.now + Duration::from_millis(1);
        }
        if !journal.calm {
            self.publish(node, &mut journal, false);
        }
        if let Some(hard) = &self.hard {
            match node.publish(hard, &Event::new(1)) {
                // It still claims its id.
                Ok(()) | Err(PublishError::NotBound) => {}
                Err(error) => panic!("{error:?}"),
            }
        }
        node.now + self.period
    }

    fn notified(&mut self, node: &mut Access<'_, Full>) {
        let journal = self.journal.clone();
        let mut journal = journal.borrow_mut();
        while node.half().services_mut().take_news().is_some() {}
        self.take_events(node, &mut journal);
        if let Some(subscription) = &self.hard_in {
            while node.next(subscription).is_some() {
                *journal.hard.entry(self.number).or_default() += 1;
            }
        }
        while let Some(exception) = node.take_exception() {
            let channel = (0..CHANNELS).find(|channel| exception.subject == Some(subject(*channel)));
            match (exception.kind, channel) {
                (ExceptionKind::QueueFull, Some(channel)) => {
                    *journal.overflows.entry((self.number, channel)).or_default() += 1;
                }
                (ExceptionKind::Malformed, _) => journal.malformed.push((self.number, node.true_now)),
                _ => {}
            }
        }
    }
}
