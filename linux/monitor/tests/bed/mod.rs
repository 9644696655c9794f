//! A planned cluster on the simulated bus: nodes with the core's own code that publish and subscribe as the plan says,
//! a station that does what nobody planned, and a listener. All in virtual time.
#![allow(dead_code, reason = "no test uses all of it")]

use std::cell::RefCell;
use std::rc::Rc;

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{Bus, FaultModel, StationId, VirtualInstant, WireFrame};
use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::Calendar;
use cosmic_core::can::{ErrorCounters, Etag, Frame, Payload, TxNode};
use cosmic_core::event_layer::{
    Attributes, Channel, Content, Depth, Event, Filter, MessagePublisher, Policy,
};
use cosmic_core::services::{self, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use cosmic_monitor::{Finding, Monitor, Rule, SegmentPlan};
use cosmic_plan::document::Source;

pub(crate) type Services = NodeServices<64, 128, 16, 128, Option<Broker<16, 32>>>;

pub(crate) const ROVER: &str = include_str!("../../../../cosmic-plan/examples/rover.toml");

pub(crate) fn plan_of(text: &str) -> SegmentPlan {
    SegmentPlan::parse(&Source::new("rover.toml", text)).unwrap_or_else(|refused| panic!("{refused}"))
}

/// What a test changes of a cluster that is as planned.
#[derive(Clone, Default)]
pub(crate) struct Changes {
    /// Positions of the nodes that host a broker.
    pub(crate) brokers: Vec<usize>,
    /// Only the first node may be time master.
    pub(crate) one_master: bool,
    /// Nodes that are built with another TxNode or UID.
    pub(crate) ids: Vec<(usize, TxNode, u64)>,
    /// The calendar in the image of one node.
    pub(crate) calendar: Option<(usize, Calendar)>,
    /// What is wrong on the bus.
    pub(crate) faults: Option<FaultModel>,
}

/// What tests tell the applications while they run.
#[derive(Default)]
pub(crate) struct Orders {
    /// This channel is published so many times as often.
    pub(crate) babble: Option<(usize, u64)>,
    /// This channel is published on no more.
    pub(crate) mute: Option<usize>,
}

pub(crate) struct Bed {
    pub(crate) plan: SegmentPlan,
    pub(crate) cluster: Cluster<Services>,
    pub(crate) monitor: Monitor,
    pub(crate) nodes: Vec<StationId>,
    /// Does what nobody planned.
    pub(crate) stranger: StationId,
    /// The listener's own controller.
    pub(crate) listener: StationId,
    pub(crate) orders: Rc<RefCell<Orders>>,
    /// All frames, with the ends of their transmissions.
    pub(crate) log: Vec<(VirtualInstant, WireFrame)>,
    trace: Vec<TraceEvent>,
}

impl Bed {
    /// The rover, as planned.
    pub(crate) fn rover() -> Self {
        Self::new(ROVER, &Changes::default())
    }

    pub(crate) fn new(text: &str, changes: &Changes) -> Self {
        let plan = plan_of(text);
        let monitor = Monitor::with_plan(plan.clone(), Instant::EPOCH);
        let mut bus = Bus::new(plan.bit_rate(), changes.faults.clone().unwrap_or_else(FaultModel::none));
        bus.record_trace(true);
        let (stranger, listener) = (bus.attach("stranger"), bus.attach("listener"));
        let mut cluster = Cluster::new(bus, 1);
        let orders = Rc::<RefCell<Orders>>::default();
        let add = |at: usize| cluster.add(node(&plan, at, changes, &orders));
        let nodes: Vec<StationId> = (0..plan.cluster().nodes.len()).map(add).collect();
        let (log, trace) = (Vec::new(), Vec::new());
        Self { plan, cluster, monitor, nodes, stranger, listener, orders, log, trace }
    }

    /// Switches all nodes on, one after the other.
    pub(crate) fn power_on(mut self) -> Self {
        for station in self.nodes.clone() {
            self.cluster.power_on(station);
            self.run(3);
        }
        self
    }

    /// Lets so many milliseconds pass; the monitor hears what the listener would.
    pub(crate) fn run(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.step(1_000_000);
        }
    }

    /// As [`run`](Self::run), for a tenth of a millisecond.
    pub(crate) fn run_for_a_tenth(&mut self) {
        self.step(100_000);
    }

    fn step(&mut self, nanoseconds: u64) {
        let now = VirtualInstant::from_ticks(self.cluster.now().as_ticks() + nanoseconds);
        self.cluster.run_until(now);
        self.cluster.bus().take_trace(&mut self.trace);
        for event in std::mem::take(&mut self.trace) {
            self.hear(&event);
        }
    }

    fn hear(&mut self, event: &TraceEvent) {
        let at = instant(event.at);
        match &event.kind {
            TraceKind::FrameEnd { frame, station, .. } => {
                self.log.push((event.at, *frame));
                // A controller does not receive what it sends itself.
                match Frame::try_from(*frame) {
                    _ if *station == self.listener => {}
                    Ok(frame) => self.monitor.on_frame(&frame, at),
                    Err(_) => self.monitor.on_foreign(Some(frame), at),
                }
            }
            TraceKind::ErrorState { station, state } if *station == self.listener => {
                if state.level() == cosmic_bus::ErrorLevel::BusOff {
                    self.monitor.on_bus_off(at);
                }
                let byte = |count: u16| count.min(255) as u8;
                let errors = ErrorCounters {
                    transmit: byte(state.transmit_errors),
                    receive: byte(state.receive_errors),
                };
                self.monitor.on_errors(errors, at);
            }
            _ => {}
        }
    }

    /// A station sends a frame, if one of its mailboxes is free.
    pub(crate) fn send(&mut self, station: StationId, frame: Frame) {
        let now = self.cluster.now();
        for mailbox in 0..cosmic_bus::MAILBOXES {
            if self.cluster.bus().load(now, station, mailbox, frame.into()).is_ok() {
                return;
            }
        }
    }

    pub(crate) fn now(&self) -> Instant {
        instant(self.cluster.now())
    }

    pub(crate) fn findings(&mut self) -> Vec<Finding> {
        let now = self.now();
        self.monitor.doctor(now)
    }

    /// The rules that apply, each once.
    pub(crate) fn rules(&mut self) -> Vec<Rule> {
        let mut rules: Vec<Rule> = self.findings().iter().map(|finding| finding.rule).collect();
        rules.dedup();
        rules
    }
}

pub(crate) fn instant(at: VirtualInstant) -> Instant {
    Instant::from_epoch(Duration::from_ticks(at.as_ticks()))
}

fn node(
    plan: &SegmentPlan,
    at: usize,
    changes: &Changes,
    orders: &Rc<RefCell<Orders>>,
) -> NodeConfig<Services> {
    let planned = plan.cluster().nodes[at].clone();
    let other = changes.ids.iter().find(|(node, ..)| *node == at);
    let (tx_node, uid) = other.map_or((planned.tx_node, planned.uid), |(_, tx_node, uid)| (*tx_node, *uid));
    let uid = NodeUid::new(uid).unwrap();
    let calendar =
        changes.calendar.filter(|(node, _)| *node == at).map_or(plan.calendar(), |(_, calendar)| calendar);
    let calendar: &'static Calendar = Box::leak(Box::new(calendar));
    let rank = planned.rank.filter(|_| at == 0 || !changes.one_master);
    let sync = plan.cluster().sync().unwrap_or(SyncConfig::DEFAULT);
    let clock = SyncConfig { rank, calendar_digest: calendar.digest(), ..sync };
    let hosts = changes.brokers.contains(&at);
    let (plan, orders) = (plan.clone(), Rc::clone(orders));
    NodeConfig {
        name: planned.name.clone(),
        tx_node: Some(tx_node),
        calendar,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(10_000 * at as i32 - 20_000)),
        services: Box::new(move |now| {
            let config = services::NodeConfig {
                tx_node: Some(tx_node),
                noise: 7 * at as u64 + 1,
                clock,
                ..services::NodeConfig::new(uid)
            };
            let broker =
                hosts.then(|| Broker::new(uid, BrokerTiming::DEFAULT, Nodes::new(), Subjects::new()));
            Services::new(&config, calendar, broker, now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            Box::new(App {
                plan: plan.clone(),
                node: at,
                orders: Rc::clone(&orders),
                channels: Vec::new(),
                messages: Vec::new(),
                subscriptions: Vec::new(),
            })
        }),
    }
}

/// Publishes on all its channels at their periods, and swallows what it subscribes to.
struct App {
    plan: SegmentPlan,
    node: usize,
    orders: Rc<RefCell<Orders>>,
    channels: Vec<Sender>,
    messages: Vec<(usize, MessagePublisher<256>, Instant)>,
    subscriptions: Vec<Swallow>,
}

struct Sender {
    channel: usize,
    publish: Publish,
    next: Instant,
    number: u64,
}

/// Takes all events of a subscription.
type Swallow = Box<dyn Fn(&mut Access<'_, Services>)>;

fn subscribes(
    node: &mut Access<'_, Services>,
    declared: &Channel<Payload>,
    plan: &SegmentPlan,
    channel: usize,
) -> Swallow {
    let planned = plan.channel(channel);
    match (declared.attributes(), planned.length) {
        (Attributes::Hard(_), 5) => swallows(node, &typed::<5>(declared, planned.etag.unwrap())),
        (Attributes::Hard(_), 7) => swallows(node, &typed::<7>(declared, planned.etag.unwrap())),
        (Attributes::Hard(_), 8) => swallows(node, &typed::<8>(declared, planned.etag.unwrap())),
        _ => swallows(node, declared),
    }
}

fn swallows<C: Content + 'static>(node: &mut Access<'_, Services>, channel: &Channel<C>) -> Swallow {
    let policy = Policy::Fifo(Depth::new(8).unwrap());
    let subscription = node.subscribe(channel, Filter::ALL, policy).unwrap();
    Box::new(move |node| while node.next(&subscription).is_some() {})
}

/// A channel of hard real-time, whose slot has room for so many bytes.
fn typed<const LEN: usize>(declared: &Channel<Payload>, etag: Etag) -> Channel<[u8; LEN]> {
    let Attributes::Hard(attributes) = declared.attributes() else { panic!("it is none of hard real-time") };
    Channel::hard(declared.subject(), etag, attributes)
}

type Publish = Box<dyn Fn(&mut Access<'_, Services>, Payload)>;

/// Announces a channel. One of hard real-time has a slot for so many bytes as its content has, and no more.
fn publishes(
    node: &mut Access<'_, Services>,
    declared: &Channel<Payload>,
    plan: &SegmentPlan,
    channel: usize,
) -> Publish {
    let planned = plan.channel(channel);
    match (declared.attributes(), planned.length) {
        (Attributes::Hard(_), 5) => exactly::<5>(node, declared, planned.etag.unwrap()),
        (Attributes::Hard(_), 7) => exactly::<7>(node, declared, planned.etag.unwrap()),
        (Attributes::Hard(_), 8) => exactly::<8>(node, declared, planned.etag.unwrap()),
        _ => {
            let publication = node.announce(declared).unwrap();
            Box::new(move |node, content| {
                let _ = node.publish(&publication, &Event::new(content));
            })
        }
    }
}

fn exactly<const LEN: usize>(
    node: &mut Access<'_, Services>,
    declared: &Channel<Payload>,
    etag: Etag,
) -> Publish {
    let Attributes::Hard(attributes) = declared.attributes() else { panic!("it is none of hard real-time") };
    let publication =
        node.announce(&Channel::<[u8; LEN]>::hard(declared.subject(), etag, attributes)).unwrap();
    Box::new(move |node, content| {
        let bytes: [u8; LEN] = content.as_slice().try_into().unwrap();
        let _ = node.publish(&publication, &Event::new(bytes));
    })
}

impl App {
    fn declared(&self, at: usize) -> Channel<Payload> {
        self.plan.declare(at).unwrap()
    }
}

impl Application<Services> for App {
    fn start(&mut self, node: &mut Access<'_, Services>) -> Instant {
        let planned = self.plan.cluster().nodes[self.node].clone();
        for (turn, channel) in planned.publishes.into_iter().enumerate() {
            let declared = self.declared(channel);
            // Not all at once.
            let next = node.now + Duration::from_micros(300_000 + 700 * turn as u64);
            if self.plan.channel(channel).length > 8 {
                let publication = node.announce(&declared).unwrap();
                self.messages.push((channel, MessagePublisher::new(publication), next));
            } else {
                let publish = publishes(node, &declared, &self.plan, channel);
                self.channels.push(Sender { channel, publish, next, number: 0 });
            }
        }
        for channel in planned.subscribes {
            self.subscriptions.push(subscribes(node, &self.declared(channel), &self.plan, channel));
        }
        node.now + Duration::from_millis(1)
    }

    fn wake(&mut self, node: &mut Access<'_, Services>) -> Instant {
        let (orders, now) = (self.orders.borrow(), node.now);
        for sender in self.channels.iter_mut().filter(|sender| sender.next <= now) {
            let planned = self.plan.channel(sender.channel);
            let mut period = planned.recurrence.span();
            if let Some((_, times)) = orders.babble.filter(|(channel, _)| *channel == sender.channel) {
                period = Duration::from_ticks(period.as_ticks() / times);
            }
            sender.next = node.now + period;
            sender.number += 1;
            if orders.mute != Some(sender.channel) {
                let content = content(&self.plan, sender.channel, sender.number);
                (sender.publish)(node, content);
            }
        }
        for (channel, message, next) in &mut self.messages {
            if *next <= node.now {
                *next = node.now + self.plan.channel(*channel).recurrence.span();
                let length = usize::from(self.plan.channel(*channel).length);
                let _ = message.start(&vec![0; length]);
            }
            let _ = node.send_message(message);
        }
        let times = self.channels.iter().map(|sender| sender.next);
        times.min().unwrap_or(node.now + Duration::from_millis(5)).min(node.now + Duration::from_millis(1))
    }

    fn notified(&mut self, node: &mut Access<'_, Services>) {
        while node.half().services_mut().take_news().is_some() {}
        for subscription in &self.subscriptions {
            subscription(node);
        }
        while node.take_exception().is_some() {}
    }
}

/// The `number`th content of a channel: what the plan describes, with values that change.
fn content(plan: &SegmentPlan, channel: usize, number: u64) -> Payload {
    let planned = plan.channel(channel);
    let swing = |scale: f64, by: f64| ((number % 200) as f64 / 100.0 - 1.0).abs() * scale + by;
    let decimal = |value: f64, digits: usize| format!("{value:.digits$}");
    let values: Vec<(&str, String)> = match planned.name.as_str() {
        "drive" => vec![
            ("speed", decimal(swing(0.5, 0.5), 3)),
            ("turn", decimal(swing(10.0, -5.0), 1)),
            ("mode", "drive".to_owned()),
            ("lights", "true".to_owned()),
        ],
        "left_wheel" | "right_wheel" => vec![
            ("distance", decimal(number as f64 * 0.02, 4)),
            ("speed", decimal(swing(0.5, 0.5), 3)),
            ("stalled", "false".to_owned()),
        ],
        "attitude" => vec![
            ("roll", decimal(swing(4.0, -2.0), 2)),
            ("pitch", decimal(swing(2.0, -1.0), 2)),
            ("yaw", decimal(swing(90.0, 0.0), 2)),
            ("quality", "9".to_owned()),
            ("calibrated", "true".to_owned()),
        ],
        "joint" => vec![("number", "2".to_owned()), ("angle", decimal(swing(1.0, 0.0), 2))],
        "gripper" => vec![("state", "holding".to_owned()), ("force", decimal(12.5, 2))],
        "battery" => vec![
            ("voltage", decimal(25.2 - number as f64 * 0.001, 3)),
            ("current", decimal(-3.5, 2)),
            ("temperature", "31".to_owned()),
            ("charge", "87".to_owned()),
        ],
        _ => Vec::new(),
    };
    let layout = plan.cluster().layout_of(planned).filter(|_| !values.is_empty());
    let Some(layout) = layout else {
        return Payload::truncated(number.to_be_bytes(), usize::from(planned.length));
    };
    let values: Vec<(&str, &str)> = values.iter().map(|(name, value)| (*name, value.as_str())).collect();
    let bytes = layout.encode_text(&values).unwrap_or_else(|why| panic!("{}: {why}", planned.name));
    Payload::new(&bytes).unwrap()
}

/// The position of a channel of the plan.
pub(crate) fn channel_named(plan: &SegmentPlan, name: &str) -> usize {
    plan.channel_named(name).unwrap()
}

pub(crate) fn subject(number: u64) -> Subject {
    Subject::new(number).unwrap()
}
