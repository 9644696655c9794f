//! How fast a large cluster is simulated: many nodes on a saturated bus, on one core of the host.
//!
//! Each node is a whole one: both halves of the core, services, an application that publishes and subscribes in
//! all three classes, and acceptance filters for what it wants. Hard and soft real-time events take some four
//! fifths of the bus; non real-time events the rest, for every node always has one to send.

use crate::nodes::hardware_filters;
use crate::output::{self, Conclusion, Results};
use crate::random::Random;
use anyhow::{Context as _, anyhow};
use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, FaultModel, StationId, TrafficClass};
use cosmic_commands::experiment::{Extent, Scale as Options};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::filter_banks::{Fifo, Wanted};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Event, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy, Publication,
    SoftAttributes, Subscription,
};
use cosmic_core::protocol::Rank;
use cosmic_core::services::{self, ClockService, NodeServices, Services};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use cpu_time::ProcessTime;
use serde::Serialize;
use std::cell::Cell;
use std::fmt;
use std::rc::Rc;

#[derive(Serialize)]
struct Report<'o> {
    options: &'o Options,
    /// Virtual seconds in a second of processor time, and of the wall clock.
    virtual_seconds_per_processor_second: f64,
    virtual_seconds_per_second: f64,
    /// The share of the bus that was busy.
    bus_load: f64,
    frames_per_virtual_second: Frames,
    /// Events that subscribers fetched, per virtual second.
    events_per_virtual_second: f64,
    processor_microseconds_per_frame: f64,
}

/// By class.
#[derive(Serialize)]
struct Frames {
    hard: f64,
    soft: f64,
    non_real_time: f64,
}

/// Does what `experiment scale` is to do.
pub(crate) fn run(options: &Options) -> anyhow::Result<Conclusion> {
    let results = Results::open(options.json.as_deref())?;
    let fetched = Rc::new(Cell::new(0));
    let report = match options.services {
        Extent::Clock => measure(options, cluster(options, &fetched, clock_service)?, &fetched),
        Extent::All => measure(options, cluster(options, &fetched, all_services)?, &fetched),
    };
    results.show(&report)?;
    let ratio = report.virtual_seconds_per_processor_second;
    Ok(match options.at_least.filter(|least| ratio < *least) {
        Some(least) => {
            Conclusion::Fails(format!("{ratio:.1} virtual seconds a second are fewer than {least}"))
        }
        None => Conclusion::Holds,
    })
}

fn measure<'o, S: Services>(
    options: &'o Options,
    mut cluster: Cluster<S>,
    fetched: &Cell<u64>,
) -> Report<'o> {
    let second = Duration::from_secs(1);
    cluster.run_until(cluster.now() + second * WARM_UP);
    let (before, fetched_before) = (cluster.bus().accounting().clone(), fetched.get());
    let (processor, wall) = (ProcessTime::now(), std::time::Instant::now());
    let progress = output::progress(options.seconds, "virtual seconds");
    for _ in 0..options.seconds {
        cluster.run_until(cluster.now() + second);
        progress.inc(1);
    }
    progress.finish_and_clear();
    let (processor, wall) = (processor.elapsed().as_secs_f64(), wall.elapsed().as_secs_f64());
    let seconds = options.seconds as f64;
    let after = cluster.bus().accounting();
    let frames = |class| (after.frames(class) - before.frames(class)) as f64 / seconds;
    let frames = Frames {
        hard: frames(TrafficClass::Hard),
        soft: frames(TrafficClass::Soft),
        non_real_time: frames(TrafficClass::NonRealTime),
    };
    let bits = (after.busy_bits() - before.busy_bits()) as f64;
    Report {
        options,
        virtual_seconds_per_processor_second: seconds / processor,
        virtual_seconds_per_second: seconds / wall,
        bus_load: bits / seconds / f64::from(BitRate::MAX.bits_per_second()),
        processor_microseconds_per_frame: processor * 1e6 / (frames.total() * seconds),
        frames_per_virtual_second: frames,
        events_per_virtual_second: (fetched.get() - fetched_before) as f64 / seconds,
    }
}

impl Frames {
    fn total(&self) -> f64 {
        self.hard + self.soft + self.non_real_time
    }
}

/// Makes the services of the node with this number, at this local time.
type MakeServices<S> = fn(u8, &'static Calendar, Instant) -> S;

/// All nodes, switched on one after the other.
fn cluster<S: Services + 'static>(
    options: &Options,
    fetched: &Rc<Cell<u64>>,
    services: MakeServices<S>,
) -> anyhow::Result<Cluster<S>> {
    let mut random = Random::new(options.seed);
    let calendar: &'static Calendar = Box::leak(Box::new(calendar()?));
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()), random.bits());
    let mut stations: Vec<StationId> = Vec::new();
    for number in 0..options.nodes {
        let drift = Rate::from_parts_per_billion(random.below(100_001) as i32 - 50_000);
        let duty = Duty::of(number, options.nodes, calendar);
        let filters = hardware_filters(&duty.wanted(options.services))?;
        let station = cluster.add(node(duty, drift, calendar, fetched, services));
        cluster.set_filters(station, filters);
        stations.push(station);
    }
    for station in stations {
        cluster.power_on(station);
        cluster.run_until(cluster.now() + Duration::from_ticks(random.below(2_000_000)));
    }
    Ok(cluster)
}

/// A slot each for the first ten nodes, every ten milliseconds.
fn calendar() -> anyhow::Result<Calendar> {
    let segment = Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(3),
    };
    let slot = |number: u8| {
        Ok(Slot {
            etag: Etag::new(Etag::HARD_FIRST.get() + u16::from(number)).context("an etag of 14 bits")?,
            publisher: TxNode::new(number).context("a TxNode of 7 bits")?,
            len: 8,
            omission_degree: 1,
            periodic: true,
            period: CYCLE,
            phase: Duration::from_millis(number.into()),
        })
    };
    let slots = (0..SLOTS).map(slot).collect::<anyhow::Result<Vec<Slot>>>()?;
    Calendar::new(segment, CYCLE, slots.leak()).map_err(|error| anyhow!("the calendar: {error:?}"))
}

fn node<S: Services + 'static>(
    duty: Duty,
    drift: Rate,
    calendar: &'static Calendar,
    fetched: &Rc<Cell<u64>>,
    services: MakeServices<S>,
) -> NodeConfig<S> {
    let fetched = Rc::clone(fetched);
    let number = duty.number;
    NodeConfig {
        name: format!("node {number}"),
        tx_node: TxNode::new(number),
        calendar,
        clock: ClockErrors::realistic(drift),
        services: Box::new(move |now| services(number, calendar, now)),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            Box::new(Peer {
                duty: duty.clone(),
                fetched: Rc::clone(&fetched),
                publications: None,
                subscriptions: Vec::new(),
                wakes: 0,
            })
        }),
    }
}

fn sync_config(number: u8) -> SyncConfig {
    SyncConfig { rank: Rank::new(number), ..SyncConfig::DEFAULT }
}

fn clock_service(number: u8, calendar: &'static Calendar, now: Instant) -> ClockService {
    let service = ClockService::new(sync_config(number), calendar, TxNode::new(number), now);
    service.expect("the usual settings are right")
}

fn all_services(number: u8, calendar: &'static Calendar, now: Instant) -> AllServices {
    let uid = NodeUid::new(FIRST_UID + u64::from(number)).expect("not zero");
    let config = services::NodeConfig {
        tx_node: TxNode::new(number),
        clock: sync_config(number),
        ..services::NodeConfig::new(uid)
    };
    NodeServices::new(&config, calendar, (), now).expect("the usual settings are right")
}

/// What a node publishes and subscribes to.
#[derive(Clone)]
struct Duty {
    number: u8,
    /// The span between two soft real-time events.
    soft_period: Duration,
    own_hard: Option<Channel<u64>>,
    own_soft: Channel<u64>,
    own_bulk: Channel<u64>,
    /// The channels it subscribes to, and what of them the controller is to accept.
    others: Vec<(Channel<u64>, Wanted)>,
}

impl Duty {
    /// It subscribes to soft channels of the three nodes behind it, to the bulk of the next, and to a hard
    /// channel.
    fn of(number: u8, nodes: u8, calendar: &Calendar) -> Self {
        let behind = |distance: u8| ((u16::from(number) + u16::from(distance)) % u16::from(nodes)) as u8;
        let soft = (1..=3).map(|distance| soft(behind(distance)));
        let mut others: Vec<_> = soft.chain([bulk(behind(1))]).collect();
        let heard = calendar.slots().iter().find(|slot| slot.publisher.get() == number % SLOTS);
        others.extend(heard.map(|slot| (hard(slot), Wanted::hard(slot.etag, slot.publisher))));
        let own = calendar.slots().iter().find(|slot| slot.publisher.get() == number);
        Self {
            number,
            soft_period: SOFT_SPACING * nodes.into(),
            own_hard: own.map(hard),
            own_soft: self::soft(number).0,
            own_bulk: bulk(number).0,
            others,
        }
    }

    /// What the controller is to accept.
    fn wanted(&self, services: Extent) -> Vec<Wanted> {
        let mut wanted: Vec<Wanted> = self.others.iter().map(|(_, wanted)| *wanted).collect();
        wanted.extend([Etag::SYNC, Etag::FOLLOW_UP].map(|etag| Wanted::etag(Fifo::Urgent, etag)));
        if services == Extent::All {
            wanted.extend(MEMBERSHIP.map(|etag| Wanted::etag(Fifo::Other, etag)));
        }
        wanted
    }
}

fn hard(slot: &Slot) -> Channel<u64> {
    let attributes = HardAttributes {
        period: slot.period,
        periodic: slot.periodic,
        omission_degree: slot.omission_degree,
    };
    Channel::hard(subject(slot.etag), slot.etag, attributes)
}

fn soft(number: u8) -> (Channel<u64>, Wanted) {
    let etag = bound(u16::from(number));
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(50) };
    (Channel::soft(subject(etag), attributes).with_etag(etag), Wanted::etag(Fifo::Other, etag))
}

fn bulk(number: u8) -> (Channel<u64>, Wanted) {
    let etag = bound(BULK + u16::from(number));
    let attributes = NonRealTimeAttributes { importance: Importance::MOST, validity: None };
    (Channel::non_real_time(subject(etag), attributes).with_etag(etag), Wanted::etag(Fifo::Other, etag))
}

fn bound(offset: u16) -> Etag {
    Etag::new(Etag::BOUND_FIRST.get() + offset).unwrap_or(Etag::BOUND_LAST)
}

fn subject(etag: Etag) -> Subject {
    Subject::new(u64::from(etag.get())).unwrap_or(ANY_SUBJECT)
}

/// The application.
struct Peer {
    duty: Duty,
    /// Events that all nodes fetched.
    fetched: Rc<Cell<u64>>,
    publications: Option<Publications>,
    subscriptions: Vec<Subscription<u64>>,
    wakes: u64,
}

struct Publications {
    hard: Option<Publication<u64>>,
    soft: Publication<u64>,
    bulk: Publication<u64>,
}

impl<S: Services> Application<S> for Peer {
    fn start(&mut self, node: &mut Access<'_, S>) -> Instant {
        let duty = &self.duty;
        self.publications = Some(Publications {
            hard: duty.own_hard.map(|channel| node.announce(&channel).expect("it is in the calendar")),
            soft: node.announce(&duty.own_soft).expect("there is room"),
            bulk: node.announce(&duty.own_bulk).expect("there is room"),
        });
        let fifo = Policy::Fifo(Depth::new(8).expect("not zero"));
        let subscribe = |(channel, _): &(Channel<u64>, Wanted)| {
            node.subscribe(channel, Filter::ALL, fifo).expect("there is room")
        };
        self.subscriptions = duty.others.iter().map(subscribe).collect();
        node.now
    }

    fn wake(&mut self, node: &mut Access<'_, S>) -> Instant {
        self.wakes += 1;
        let Some(publications) = &self.publications else { return Instant::FAR_FUTURE };
        let event = Event::new(self.wakes << 8 | u64::from(self.duty.number));
        if let Some(hard) = &publications.hard {
            // Refused or overwritten only while the clocks are not synchronised.
            let _ = node.publish(hard, &event);
        }
        // A full queue is no matter here: what is not published is not sent.
        if self.wakes.is_multiple_of(2) {
            let _ = node.publish(&publications.soft, &event);
        }
        while node.half().waiting() < KEPT_WAITING && node.publish(&publications.bulk, &event).is_ok() {}
        node.now + Duration::from_ticks(self.duty.soft_period.as_ticks() / 2)
    }

    fn notified(&mut self, node: &mut Access<'_, S>) {
        for subscription in &self.subscriptions {
            while node.next(subscription).is_some() {
                self.fetched.set(self.fetched.get() + 1);
            }
        }
        while node.take_exception().is_some() {}
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Frames { hard, soft, non_real_time } = &self.frames_per_virtual_second;
        writeln!(
            f,
            "{} nodes at 1 Mbit/s, {} virtual seconds, bus load {:.1} %",
            self.options.nodes,
            self.options.seconds,
            self.bus_load * 100.0
        )?;
        writeln!(
            f,
            "  {:.0} frames a virtual second: {hard:.0} hard, {soft:.0} soft, {non_real_time:.0} non real-time",
            self.frames_per_virtual_second.total()
        )?;
        writeln!(f, "  {:.0} events fetched a virtual second", self.events_per_virtual_second)?;
        writeln!(
            f,
            "  {:.1} virtual seconds a second of one core ({:.1} by the wall clock), {:.1} \u{b5}s a frame",
            self.virtual_seconds_per_processor_second,
            self.virtual_seconds_per_second,
            self.processor_microseconds_per_frame
        )
    }
}

/// Room for the channels of the application, for the other nodes, and for what they want and offer.
type AllServices = NodeServices<64, 128, 128, 1024>;

const WARM_UP: u32 = 2;
/// Hard real-time slots in a cycle.
const SLOTS: u8 = 10;
const CYCLE: Duration = Duration::from_millis(10);
/// On average, between the soft real-time events of all nodes: 67 % of the bus.
const SOFT_SPACING: Duration = Duration::from_micros(200);
/// Etags of the bulk channels are so much larger than those of the soft ones.
const BULK: u16 = 1_000;
/// Soft and non real-time events that a node has waiting, so that the bus never falls idle.
const KEPT_WAITING: usize = 4;
/// What every node hears of every other.
const MEMBERSHIP: [Etag; 4] = [Etag::NODE_IDENTITY, Etag::PROBE, Etag::INTEREST, Etag::NODE_STATUS];
const FIRST_UID: u64 = 0xC05_0000;
const ANY_SUBJECT: Subject = Subject::new(1).unwrap();
