//! One way through the house, down to what is flashed: the image of the brake, and the core in a host on the simulated
//! bus, are sent the same recorded frames, and deliver and count the same.
//!
//! The frames are those of a run of the whole cluster, some of them spoilt: left out, cut, sent by a wrong node or
//! twice with other content. (`sim/cosmic-bus/tests/hosts.rs` compares the hosts that are no images.)
//!
//! `cargo xtask test emulated` builds the images and names their directory in `COSMIC_IMAGES`.

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::rc::Rc;

use cosmic_bus::cluster::{self, Access, Application, ClockErrors};
use cosmic_bus::{Bus, EventKind, FaultModel, MAILBOXES, VirtualInstant, WireFrame};
use cosmic_core::Subject;
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, TxNode};
use cosmic_core::event_layer::{
    Channel, Content, Depth, Event, EventRate, ExceptionKind, Filter, HardAttributes, Policy, Publication,
    SoftAttributes, Subscription,
};
use cosmic_core::protocol::Rank;
use cosmic_core::services::ClockService;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_demo::bus_log::{BusLog, Ending};
use cosmic_demo::example::{self, EXAMPLE, Promise};
use cosmic_demo::record::{Digest, RecordKind, Records};
use cosmic_emu::{Cluster, NodeConfig, NodeId, ObservationKind, Port, Station};
use rand_core::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

const WHEEL_SPEED: usize = 0;
const TEMPERATURE: usize = 1;
const BRAKE_FORCE: usize = 2;
const SUSPENSION: usize = 3;
/// Among the nodes of the example.
const BRAKE: usize = 1;
const STRANGER: TxNode = TxNode::new(0x55).unwrap();

/// The brake is settled long before.
const FROM_MS: u64 = 1_000;
const UNTIL_MS: u64 = 3_000;

cosmic_core::content! {
    /// As in the firmware.
    #[derive(Clone, Copy)]
    struct WheelSpeed { sequence: u32, speed: u16, valid: bool }
}
cosmic_core::content! {
    /// As in the firmware.
    #[derive(Clone, Copy)]
    struct Measured { sequence: u32, value: i16 }
}
cosmic_core::content! {
    /// As in the firmware: brake force and suspension.
    #[derive(Clone, Copy)]
    struct Pair { sequence: u32, one: u16, other: u16 }
}

/// A frame, and when it is put into a mailbox.
type Script = Vec<(VirtualInstant, Frame)>;

/// What a node delivered and told.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
struct Counts {
    /// The events of each channel.
    delivered: BTreeMap<u16, Vec<Digest>>,
    /// How often of each channel, or of the node as a whole.
    exceptions: BTreeMap<(Option<u16>, &'static str), u32>,
    /// Frames with brake forces on the bus.
    forces: usize,
}

impl Counts {
    fn take(&mut self, channel: Option<u16>, kind: &RecordKind) {
        match (kind, channel) {
            (RecordKind::Delivered { digest, .. }, Some(channel)) => {
                self.delivered.entry(channel).or_default().push(*digest);
            }
            (RecordKind::Exception(kind), _) => {
                *self.exceptions.entry((channel, kind.name())).or_default() += 1;
            }
            (RecordKind::Lost { .. }, _) => panic!("records were lost"),
            _ => {}
        }
    }
}

fn ms(milliseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(milliseconds * 1_000_000)
}

fn etag(channel: usize) -> Etag {
    EXAMPLE.channels[channel].etag
}

fn emulated(names: &[&str]) -> (Cluster, Vec<NodeId>) {
    let images = std::env::var_os("COSMIC_IMAGES");
    let images = PathBuf::from(
        images.expect("COSMIC_IMAGES names no directory of images: run `cargo xtask test emulated`"),
    );
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()));
    cluster.bus_mut().record_trace(true);
    let add = |name: &&str| cluster.add_node(NodeConfig::new(*name, images.join(name))).unwrap();
    let nodes = names.iter().map(add).collect();
    (cluster, nodes)
}

/// What the others send to the brake when all run.
fn recorded() -> Script {
    let names: Vec<_> = EXAMPLE.nodes.iter().map(|node| node.name).collect();
    let (mut cluster, nodes) = emulated(&names);
    cluster.run_until(ms(UNTIL_MS + 100));
    let brake = cluster.station(nodes[BRAKE]);
    let mut trace = Vec::new();
    cluster.bus_mut().take_trace(&mut trace);
    let mut bus = BusLog::default();
    trace.iter().for_each(|event| bus.take(event));
    let sent = bus.attempts().iter().filter(|it| it.ending == Ending::Sent && it.station != brake);
    sent.filter_map(|it| Some((it.start, it.frame()?))).collect()
}

/// The same, with much that is wrong in between.
fn spoilt(recorded: &Script, seed: u64) -> Script {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut script = Script::new();
    for &(at, frame) in recorded {
        let (id, is_of) = (frame.id, |channel| frame.id.etag() == etag(channel));
        if at < ms(FROM_MS) || at > ms(UNTIL_MS - 100) || id.etag().is_reserved() {
            script.push((at, frame));
            continue;
        }
        let chance = random.next_u64() % 100;
        let cut = Frame::new(id, Payload::new(&frame.payload.as_slice()[..3]).unwrap());
        let by = |node| Frame::new(Id::new(id.priority(), node, id.etag()), frame.payload);
        let other = Frame::new(id, Payload::full([0; 8]));
        let rare = if is_of(SUSPENSION) { 10 } else { 1 };
        match chance * rare {
            0..10 => {}
            10..20 => script.push((at, cut)),
            20..30 => script.push((at, by(STRANGER))),
            30..40 if is_of(WHEEL_SPEED) => {
                script.push((at, frame));
                script.push((at + Duration::from_micros(200), other));
            }
            40..50 if is_of(SUSPENSION) => script.push((at, by(EXAMPLE.nodes[BRAKE].tx_node))),
            _ => script.push((at, frame)),
        }
    }
    script.sort_by_key(|(at, _)| *at);
    script
}

/// Sends a script.
struct Replay {
    script: VecDeque<(VirtualInstant, Frame)>,
    mailbox: usize,
}

impl Station for Replay {
    fn acts_at(&self) -> Option<VirtualInstant> {
        self.script.front().map(|(at, _)| *at)
    }

    fn act(&mut self, port: &mut Port<'_>) {
        let Some((_, frame)) = self.script.pop_front() else { return };
        assert!(port.load(self.mailbox, frame.into()), "the last but two has gone");
        self.mailbox = (self.mailbox + 1) % MAILBOXES;
    }

    fn on_event(&mut self, _: &EventKind, _: &mut Port<'_>) {}
}

/// Forces that the brake has put on the bus since the trace was taken last.
fn forces(bus: &mut Bus) -> usize {
    let mut trace = Vec::new();
    bus.take_trace(&mut trace);
    let mut log = BusLog::default();
    trace.iter().for_each(|event| log.take(event));
    let of_brake = |frame: Frame| frame.id.etag() == etag(BRAKE_FORCE);
    log.attempts().iter().filter(|it| it.ending == Ending::Sent && it.frame().is_some_and(of_brake)).count()
}

/// What the image counts between two instants at which no slot is open.
fn by_the_image(script: &Script, from: VirtualInstant, until: VirtualInstant) -> Counts {
    let (mut cluster, nodes) = emulated(&[EXAMPLE.nodes[BRAKE].name]);
    cluster.add_station("replay", Box::new(Replay { script: script.clone().into(), mailbox: 0 }));
    let (mut counts, mut records) = (Counts::default(), Records::default());
    for until in [from, until] {
        counts = Counts::default();
        forces(cluster.bus_mut());
        cluster.run_until(until);
        for seen in cluster.take_observations() {
            match seen.kind {
                ObservationKind::Record { channel, bytes } if channel == cosmic_records::CHANNEL => {
                    let mut complete = Vec::new();
                    records.take(&bytes, &mut complete).unwrap();
                    complete.iter().for_each(|record| counts.take(record.channel, &record.kind));
                }
                ObservationKind::Stopped { .. } => panic!("the image has stopped: {}", seen.kind),
                _ => {}
            }
        }
    }
    assert!(!cluster.is_stopped(nodes[0]));
    counts.forces = forces(cluster.bus_mut());
    counts
}

/// The application of the brake, as short as can be.
struct Brake {
    counts: Rc<RefCell<Counts>>,
    force: Option<Publication<Pair>>,
    wheel_speed: Option<Subscription<WheelSpeed>>,
    temperature: Option<Subscription<Measured>>,
    suspension: Option<Subscription<Pair>>,
}

impl Application<ClockService> for Brake {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        self.force = Some(node.announce(&declared(BRAKE_FORCE)).unwrap());
        self.temperature = Some(node.subscribe(&declared(TEMPERATURE), Filter::ALL, QUEUE).unwrap());
        self.suspension = Some(node.subscribe(&declared(SUSPENSION), Filter::ALL, QUEUE).unwrap());
        // Settled by then.
        node.now + Duration::from_millis(500)
    }

    fn wake(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        self.wheel_speed = Some(node.subscribe(&declared(WHEEL_SPEED), Filter::ALL, QUEUE).unwrap());
        Instant::FAR_FUTURE
    }

    fn notified(&mut self, node: &mut Access<'_, ClockService>) {
        let counts = self.counts.clone();
        let mut counts = counts.borrow_mut();
        while let Some(event) = self.wheel_speed.as_ref().and_then(|it| node.next(it)) {
            counts.deliver(WHEEL_SPEED, &event.content);
            let force = Pair { sequence: event.content.sequence, one: 0, other: 0 };
            node.publish(self.force.as_ref().unwrap(), &Event::new(force)).unwrap();
        }
        while let Some(event) = self.temperature.as_ref().and_then(|it| node.next(it)) {
            counts.deliver(TEMPERATURE, &event.content);
        }
        while let Some(event) = self.suspension.as_ref().and_then(|it| node.next(it)) {
            counts.deliver(SUSPENSION, &event.content);
        }
        while let Some(exception) = node.take_exception() {
            let of_subject = |it: &&example::Channel| exception.subject == Some(subject(it.etag));
            let channel = EXAMPLE.channels.iter().find(of_subject).map(|it| it.number);
            counts.take(channel, &RecordKind::Exception(exception.kind));
        }
    }
}

impl Counts {
    fn deliver<C: Content>(&mut self, channel: usize, content: &C) {
        let mut bytes = vec![0; C::LEN];
        content.encode(&mut bytes);
        self.delivered.entry(EXAMPLE.channels[channel].number).or_default().push(Digest::of(&bytes));
    }
}

/// For each subscription, as in the firmware.
const QUEUE: Policy = Policy::Fifo(Depth::new(8).unwrap());

/// On the wire there are etags only.
fn subject(etag: Etag) -> Subject {
    Subject::new(u64::from(etag.get())).unwrap()
}

/// A channel with the quality and the rate of the description.
fn declared<C: Content>(channel: usize) -> Channel<C> {
    let channel = &EXAMPLE.channels[channel];
    let subject = subject(channel.etag);
    let jitter = Duration::from_micros(200);
    let rate = match channel.name {
        "temperature" => EventRate::periodic(Duration::from_millis(20)),
        "suspension" => EventRate::periodic(Duration::from_millis(1)),
        _ => EventRate::sporadic(Duration::from_millis(10)),
    };
    match channel.class {
        Promise::Soft { deadline, validity } => Channel::soft(subject, SoftAttributes { deadline, validity })
            .with_rate(rate.with_jitter(jitter))
            .with_etag(channel.etag),
        _ => {
            let slot = EXAMPLE.calendar.slots().iter().find(|slot| slot.etag == channel.etag).unwrap();
            let &cosmic_core::calendar::Slot { period, periodic, omission_degree, .. } = slot;
            Channel::hard(subject, channel.etag, HardAttributes { period, periodic, omission_degree })
        }
    }
}

fn by_the_host(script: &Script, from: VirtualInstant, until: VirtualInstant) -> Counts {
    let counts = Rc::new(RefCell::new(Counts::default()));
    let mut cluster = cluster::Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()), 1);
    cluster.bus().record_trace(true);
    let me = EXAMPLE.nodes[BRAKE].tx_node;
    let of_application = counts.clone();
    let node = cluster.add(cluster::NodeConfig {
        name: "brake".into(),
        tx_node: Some(me),
        calendar: EXAMPLE.calendar,
        clock: ClockErrors::NONE,
        services: Box::new(move |now| {
            let (rank, period) = (Rank::new(me.get() - 1), EXAMPLE.sync_period);
            let config = SyncConfig { rank, period, ..SyncConfig::DEFAULT };
            ClockService::new(config, EXAMPLE.calendar, Some(me), now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            let counts = of_application.clone();
            Box::new(Brake { counts, force: None, wheel_speed: None, temperature: None, suspension: None })
        }),
    });
    let replay = cluster.bus().attach("replay");
    cluster.power_on(node);
    let mut script = script.iter().enumerate().peekable();
    for until in [from, until] {
        counts.take();
        forces(cluster.bus());
        while let Some((number, &(at, frame))) = script.next_if(|(_, (at, _))| *at < until) {
            cluster.run_until(at);
            let loaded = cluster.bus().load(at, replay, number % MAILBOXES, WireFrame::from(frame));
            loaded.expect("the last but two has gone");
        }
        cluster.run_until(until);
    }
    let forces = forces(cluster.bus());
    Counts { forces, ..counts.take() }
}

#[test]
fn the_image_counts_what_the_core_counts() {
    let recorded = recorded();
    let next = |channel: usize, after: VirtualInstant| {
        let is_it = |it: &&(VirtualInstant, Frame)| it.0 > after && it.1.id.etag() == etag(channel);
        recorded.iter().find(is_it).expect("it is sent again and again").0
    };
    // In the middle between two slots, and between two frames of the channel that has most.
    let between = |after| next(SUSPENSION, next(WHEEL_SPEED, after) + Duration::from_millis(5));
    let [from, until] = [FROM_MS - 20, UNTIL_MS].map(|at| between(ms(at)) + Duration::from_micros(500));
    for seed in 0..4 {
        let script = spoilt(&recorded, seed);
        let counts = by_the_image(&script, from, until);
        assert_eq!(counts, by_the_host(&script, from, until), "seed {seed}");
        // What was spoilt is seen.
        let told = |channel: usize, kind: ExceptionKind| {
            let channel = Some(EXAMPLE.channels[channel].number);
            counts.exceptions.get(&(channel, kind.name())).copied().unwrap_or_default()
        };
        assert!(told(WHEEL_SPEED, ExceptionKind::MissedEvent) > 10, "{counts:?}");
        assert!(told(WHEEL_SPEED, ExceptionKind::ContradictoryEvent) > 5, "{counts:?}");
        assert!(told(TEMPERATURE, ExceptionKind::EventOverdue) > 5, "{counts:?}");
        assert!(told(SUSPENSION, ExceptionKind::Malformed) > 5, "{counts:?}");
        assert!(counts.exceptions.contains_key(&(None, ExceptionKind::DuplicateTxNode.name())), "{counts:?}");
        assert!(counts.forces > 100 && counts.delivered.len() == 3, "{counts:?}");
    }
}
