//! The example cluster without processors: the core's own code on the host, for runs of milliseconds.

use std::cell::RefCell;
use std::rc::Rc;

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, FaultModel, StationId, VirtualInstant, WireFrame};
use cosmic_core::Subject;
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Event, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy, Publication,
    SoftAttributes, Subscription,
};
use cosmic_core::protocol::Rank;
use cosmic_core::services::ClockService;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_demo::bus_log::BusLog;
use cosmic_demo::clock::NodeClock;
use cosmic_demo::example::{self, EXAMPLE, Promise};
use cosmic_demo::journal::Journal;
use cosmic_demo::load::BackgroundLog;
use cosmic_demo::record::{Digest, Queue, Record, RecordKind};

/// As long as the hard real-time channel allows.
type Content = [u8; 7];
type Records = Rc<RefCell<Vec<(TxNode, Record)>>>;

/// A node of the example: publishes on its channels with these periods, takes what it subscribes to.
struct Node {
    me: TxNode,
    publishes: Vec<(Etag, Duration)>,
    publications: Vec<(Etag, Publication<Content>, Duration, Instant, u32)>,
    subscriptions: Vec<(Etag, Subscription<Content>)>,
    records: Records,
}

impl Node {
    fn write(&self, etag: Option<Etag>, at: Instant, kind: RecordKind) {
        let channel = etag.and_then(|etag| EXAMPLE.channel(etag)).map(|channel| channel.number);
        self.records.borrow_mut().push((self.me, Record { channel, at, kind }));
    }
}

impl Application<ClockService> for Node {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        let fifo = Policy::Fifo(Depth::new(16).unwrap());
        for channel in &EXAMPLE.channels {
            if channel.subscribers.contains(&self.me) {
                let subscription = node.subscribe(&declared(channel), Filter::ALL, fifo).unwrap();
                self.subscriptions.push((channel.etag, subscription));
                let kind = RecordKind::Subscribed { queue: Queue::Fifo(16), filtered: false };
                self.write(Some(channel.etag), node.now, kind);
            }
        }
        for (etag, period) in &self.publishes {
            let publication = node.announce(&declared(EXAMPLE.channel(*etag).unwrap())).unwrap();
            self.publications.push((*etag, publication, *period, node.now + *period, 0));
        }
        self.publications.iter().map(|it| it.3).min().unwrap_or(Instant::FAR_FUTURE)
    }

    fn wake(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        let mut written = Vec::new();
        for (etag, publication, period, next, sequence) in &mut self.publications {
            if *next > node.now {
                continue;
            }
            let content = content(*sequence);
            let taken = node.publish(publication, &Event::new(content)).is_ok();
            let digest = Digest::of(&content);
            let published = RecordKind::Published { len: 7, digest };
            let refused = RecordKind::Refused { digest, queue_full: true };
            written.push((*etag, if taken { published } else { refused }));
            *sequence += 1;
            *next = *next + *period;
        }
        written.into_iter().for_each(|(etag, kind)| self.write(Some(etag), node.now, kind));
        self.publications.iter().map(|it| it.3).min().unwrap_or(Instant::FAR_FUTURE)
    }

    fn notified(&mut self, node: &mut Access<'_, ClockService>) {
        for (etag, subscription) in &self.subscriptions {
            while let Some(event) = node.next(subscription) {
                let digest = Digest::of(&event.content);
                let (publisher, visible_at) = (event.publisher, event.received_at);
                let kind = RecordKind::Delivered { digest, publisher, visible_at };
                self.write(Some(*etag), node.now, kind);
            }
        }
        while let Some(exception) = node.take_exception() {
            let etag = exception.subject.and_then(|it| Etag::new(it.get() as u16));
            self.write(etag, exception.at, RecordKind::Exception(exception.kind));
        }
    }
}

/// The content of the event with this number.
pub(crate) fn content(number: u32) -> Content {
    let mut content = [0xA5; 7];
    content[..4].copy_from_slice(&number.to_be_bytes());
    content
}

fn declared(channel: &example::Channel) -> Channel<Content> {
    let subject = Subject::new(u64::from(channel.etag.get())).unwrap();
    match channel.class {
        Promise::Hard => {
            let slot = EXAMPLE.calendar.slots().iter().find(|slot| slot.etag == channel.etag).unwrap();
            let attributes = HardAttributes {
                period: slot.period,
                periodic: slot.periodic,
                omission_degree: slot.omission_degree,
            };
            Channel::hard(subject, channel.etag, attributes)
        }
        Promise::Soft { deadline, validity } => {
            Channel::soft(subject, SoftAttributes { deadline, validity }).with_etag(channel.etag)
        }
        Promise::NonRealTime { .. } => {
            let attributes = NonRealTimeAttributes { importance: Importance::LEAST, validity: None };
            Channel::non_real_time(subject, attributes).with_etag(channel.etag)
        }
    }
}

/// What happens on the bus, and when.
pub(crate) type Meddling = (VirtualInstant, fn(&mut Bus));

/// What the run is to be like.
pub(crate) struct Run {
    pub(crate) faults: FaultModel,
    pub(crate) until: VirtualInstant,
    /// Frames of a foreign station, so many microseconds apart; 0 for none.
    pub(crate) load_interval: u64,
    /// What happens on the bus at these instants.
    pub(crate) meddle: Vec<Meddling>,
}

impl Run {
    pub(crate) fn quiet(until_ms: u64) -> Self {
        let until = VirtualInstant::from_ticks(until_ms * 1_000_000);
        Self { faults: FaultModel::none(), until, load_interval: 0, meddle: Vec::new() }
    }

    /// Runs the example.
    pub(crate) fn journal(self) -> Journal {
        let records = Records::default();
        let mut cluster = Cluster::new(Bus::new(BitRate::MAX, self.faults), 1);
        cluster.bus().record_trace(true);
        let [wheel, temperature, force, suspension, logbook] =
            [0, 1, 2, 3, 4].map(|n| EXAMPLE.channels[n].etag);
        let ms = Duration::from_millis;
        let nodes = [
            (vec![(wheel, ms(10)), (temperature, ms(20))], 40_000, 0),
            (vec![(force, ms(10))], -35_000, 3),
            (vec![(suspension, ms(1)), (logbook, ms(4))], 20_000, 7),
        ];
        let (mut clocks, mut stations) = (Vec::new(), Vec::new());
        let mut starts = Vec::new();
        for (node, (publishes, drift, start)) in EXAMPLE.nodes.iter().zip(nodes) {
            let station = add(&mut cluster, node, publishes, drift, &records);
            let at = VirtualInstant::from_ticks(start * 1_000_000);
            starts.push((at, station));
            stations.push((node.tx_node, station));
            let second = 1_000_000_000 + i64::from(drift);
            let later = (Instant::EPOCH.offset_by(second), at + ms(1_000));
            clocks.push((node.tx_node, NodeClock::through((Instant::EPOCH, at), later).unwrap()));
        }
        let foreign = cluster.bus().attach("foreign");
        drive(&mut cluster, starts, foreign, self.load_interval, self.meddle, self.until);
        let mut trace = Vec::new();
        cluster.bus().take_trace(&mut trace);
        let mut bus = BusLog::default();
        trace.iter().for_each(|event| bus.take(event));
        Journal {
            cluster: &EXAMPLE,
            bit_rate: BitRate::MAX,
            bus,
            accounting: cluster.bus().accounting().clone(),
            records: records.take(),
            clocks,
            stations,
            background: BackgroundLog::default(),
            handlers: Vec::new(),
            errors: Vec::new(),
            end: self.until,
        }
    }
}

fn add(
    cluster: &mut Cluster<ClockService>,
    node: &'static example::Node,
    publishes: Vec<(Etag, Duration)>,
    drift: i32,
    records: &Records,
) -> StationId {
    let (me, records) = (node.tx_node, records.clone());
    cluster.add(NodeConfig {
        name: node.name.to_owned(),
        tx_node: Some(me),
        calendar: EXAMPLE.calendar,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(drift)),
        services: Box::new(move |now| {
            let (rank, period) = (Rank::new(me.get() - 1), Duration::from_millis(25));
            let config = SyncConfig { rank, period, ..SyncConfig::DEFAULT };
            ClockService::new(config, EXAMPLE.calendar, Some(me), now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            Box::new(Node {
                me,
                publishes: publishes.clone(),
                publications: Vec::new(),
                subscriptions: Vec::new(),
                records: records.clone(),
            })
        }),
    })
}

fn drive(
    cluster: &mut Cluster<ClockService>,
    mut starts: Vec<(VirtualInstant, StationId)>,
    foreign: StationId,
    load_interval: u64,
    mut meddle: Vec<Meddling>,
    until: VirtualInstant,
) {
    let step = Duration::from_micros(if load_interval == 0 { 1_000 } else { load_interval });
    let mut now = VirtualInstant::from_ticks(0);
    let mut number = 0_u32;
    while now < until {
        cluster.run_until(now);
        starts.retain(|(at, station)| {
            if *at <= now {
                cluster.power_on(*station);
            }
            *at > now
        });
        meddle.retain(|(at, act)| {
            if *at <= now {
                act(cluster.bus());
            }
            *at > now
        });
        if load_interval > 0 {
            number += 1;
            let priority = if number.is_multiple_of(3) { 40 } else { 251 + (number % 5) as u8 };
            let etag = Etag::new(0x2000 + (number % 97) as u16).unwrap();
            let id = Id::new(Priority::new(priority), TxNode::new(0x30).unwrap(), etag);
            let payload = Payload::full(u64::from(number).wrapping_mul(0x9E37_79B9_7F4A_7C15).to_be_bytes());
            let mailbox = if priority < 250 { 1 } else { 2 };
            // If the mailbox is occupied, this frame is not sent.
            let _ = cluster.bus().load(now, foreign, mailbox, WireFrame::from(Frame::new(id, payload)));
        }
        // Nodes are switched on when they are to be.
        let start = starts.iter().map(|(at, _)| *at).min().unwrap_or(until);
        now = (now + step).min(until).min(start);
    }
    cluster.run_until(until);
}
