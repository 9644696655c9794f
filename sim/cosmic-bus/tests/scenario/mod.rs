//! Random clusters: nodes, calendar, traffic, faults and disruptions, all from one seed.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::trace::TraceEvent;
use cosmic_bus::{Bus, Chance, FaultModel, StationId, VirtualInstant};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Event, Exception, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy,
    Publication, SoftAttributes, Subscription,
};
use cosmic_core::network::hard::Counters;
use cosmic_core::protocol::Rank;
use cosmic_core::services::ClockService;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::cell::RefCell;
use std::rc::Rc;

/// Numbers drawn from a seed.
pub(crate) struct Dice(Pcg64Mcg);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    pub(crate) fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }

    pub(crate) fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len() as u64) as usize]
    }
}

/// How bad it is going to be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hardships {
    pub(crate) inversion: f64,
    pub(crate) omission: f64,
    /// Nodes that crash, restart, or are cut off, in the whole run.
    pub(crate) disruptions: u64,
}

/// An event that a subscriber got.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Delivery {
    pub(crate) node: u8,
    pub(crate) etag: Etag,
    pub(crate) index: u32,
    pub(crate) at: VirtualInstant,
    pub(crate) global: GlobalInstant,
}

/// What all applications saw.
#[derive(Default)]
pub(crate) struct Journal {
    pub(crate) hard: Vec<Delivery>,
    pub(crate) soft_published: u64,
    pub(crate) soft_refused: u64,
    pub(crate) soft_delivered: u64,
    pub(crate) exceptions: Vec<(u8, VirtualInstant, Exception)>,
    /// When a node was on and its clock within bounds, by its millisecond.
    pub(crate) healthy: Vec<Vec<bool>>,
    /// What each node counted in each slot, until it was switched off or the run ended.
    pub(crate) counters: Vec<(u8, Etag, Counters)>,
}

type Shared = Rc<RefCell<Journal>>;

pub(crate) struct Scenario {
    pub(crate) cluster: Cluster<ClockService>,
    pub(crate) calendar: &'static Calendar,
    pub(crate) journal: Shared,
    pub(crate) stations: Vec<StationId>,
    pub(crate) trace: Vec<TraceEvent>,
    pub(crate) dice: Dice,
}

const MILLISECOND: u64 = 1_000_000;

impl Scenario {
    pub(crate) fn new(seed: u64, hardships: Hardships) -> Self {
        let mut dice = Dice::new(seed);
        let nodes = 2 + dice.below(5) as u8;
        let calendar: &'static Calendar = Box::leak(Box::new(random_calendar(&mut dice, nodes)));
        let faults = FaultModel::seeded(seed)
            .with_inversion(Chance::new(hardships.inversion).unwrap())
            .with_omission(Chance::new(hardships.omission).unwrap());
        let mut bus = Bus::new(BitRate::MAX, faults);
        bus.record_trace(true);
        let mut cluster = Cluster::new(bus, seed);
        let journal = Shared::default();
        journal.borrow_mut().healthy.resize(usize::from(nodes) + 1, Vec::new());
        let mut stations = Vec::new();
        for number in 1..=nodes {
            let drift = dice.below(200_001) as i32 - 100_000;
            let soft_period = Duration::from_millis(1 + dice.below(8));
            stations.push(cluster.add(node(number, calendar, drift, soft_period, &journal)));
        }
        for station in &stations {
            cluster.power_on(*station);
            let pause = VirtualInstant::from_ticks(cluster.now().as_ticks() + dice.below(5 * MILLISECOND));
            cluster.run_until(pause);
        }
        Self { cluster, calendar, journal, stations, trace: Vec::new(), dice }
    }

    /// Lets the cluster run, with disruptions at random instants.
    pub(crate) fn run(&mut self, until: VirtualInstant, disruptions: u64) {
        for _ in 0..disruptions {
            let left = until.as_ticks() - self.cluster.now().as_ticks();
            self.advance(left / (disruptions + 1));
            let station = self.dice.one_of(&self.stations);
            match self.dice.below(3) {
                0 => self.cluster.power_on(station),
                1 => {
                    self.cluster.power_off(station);
                    self.advance(left / (disruptions + 1) / 4);
                    self.cluster.power_on(station);
                }
                _ => {
                    self.cluster.disconnect(station);
                    self.advance(left / (disruptions + 1) / 4);
                    self.cluster.connect(station);
                }
            }
        }
        let left = until.as_ticks() - self.cluster.now().as_ticks();
        self.advance(left);
        for (index, station) in self.stations.clone().into_iter().enumerate() {
            self.cluster.visit(station, |node| {
                for slot in self.calendar.slots() {
                    let hard = node.hard();
                    let buffer = hard.find(slot.etag, slot.publisher);
                    if let Some(counters) = buffer.and_then(|buffer| hard.counters(buffer)) {
                        let number = index as u8 + 1;
                        self.journal.borrow_mut().counters.push((number, slot.etag, counters));
                    }
                }
            });
        }
    }

    fn advance(&mut self, span: u64) {
        let until = VirtualInstant::from_ticks(self.cluster.now().as_ticks() + span);
        self.cluster.run_until(until);
        self.cluster.bus().take_trace(&mut self.trace);
    }
}

fn random_calendar(dice: &mut Dice, nodes: u8) -> Calendar {
    let segment = Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(3),
    };
    let cycle = Duration::from_millis(20);
    let mut slots: Vec<Slot> = Vec::new();
    let mut calendar = Calendar::new(segment, cycle, &[]).unwrap();
    for number in 0..1 + dice.below(6) as u16 {
        for _ in 0..100 {
            let period = Duration::from_millis(dice.one_of(&[5, 10, 20]));
            slots.push(Slot {
                etag: Etag::new(100 + number).unwrap(),
                publisher: TxNode::new(1 + dice.below(nodes.into()) as u8).unwrap(),
                len: 4,
                omission_degree: dice.below(3) as u8,
                periodic: dice.below(4) > 0,
                period,
                phase: Duration::from_micros(dice.below(period.as_micros())),
            });
            match Calendar::new(segment, cycle, slots.clone().leak()) {
                Ok(larger) => {
                    calendar = larger;
                    break;
                }
                Err(_) => drop(slots.pop()),
            }
        }
    }
    calendar
}

fn hard_channel(slot: &Slot) -> Channel<u32> {
    let attributes = HardAttributes {
        period: slot.period,
        periodic: slot.periodic,
        omission_degree: slot.omission_degree,
    };
    Channel::hard(Subject::new(u64::from(slot.etag.get())).unwrap(), slot.etag, attributes)
}

fn soft_channel() -> Channel<u32> {
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(4), validity: Duration::from_millis(30) };
    Channel::soft(Subject::new(0x50F7).unwrap(), attributes).with_etag(Etag::BOUND_LAST)
}

fn bulk_channel() -> Channel<[u8; 8]> {
    let attributes = NonRealTimeAttributes { importance: Importance::MOST, validity: None };
    Channel::non_real_time(Subject::new(0xB01C).unwrap(), attributes).with_etag(Etag::BOUND_FIRST)
}

fn node(
    number: u8,
    calendar: &'static Calendar,
    drift: i32,
    soft_period: Duration,
    journal: &Shared,
) -> NodeConfig<ClockService> {
    let journal = journal.clone();
    NodeConfig {
        name: format!("node {number}"),
        tx_node: TxNode::new(number),
        calendar,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(drift)),
        services: Box::new(move |now| {
            let config = SyncConfig { rank: Rank::new(number - 1), ..SyncConfig::DEFAULT };
            ClockService::new(config, calendar, TxNode::new(number), now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            Box::new(App {
                number,
                calendar,
                soft_period,
                journal: journal.clone(),
                hard_publications: Vec::new(),
                hard_subscriptions: Vec::new(),
                soft: None,
                bulk: None,
                soft_subscription: None,
                next_soft: Instant::EPOCH,
            })
        }),
    }
}

struct App {
    number: u8,
    calendar: &'static Calendar,
    soft_period: Duration,
    journal: Shared,
    hard_publications: Vec<(&'static Slot, Publication<u32>, u64)>,
    hard_subscriptions: Vec<(Etag, Subscription<u32>)>,
    soft: Option<Publication<u32>>,
    bulk: Option<Publication<[u8; 8]>>,
    soft_subscription: Option<Subscription<u32>>,
    next_soft: Instant,
}

impl Application<ClockService> for App {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        for slot in self.calendar.slots() {
            let channel = hard_channel(slot);
            if slot.publisher.get() == self.number {
                let publication = node.announce(&channel).unwrap();
                self.hard_publications.push((slot, publication, 0));
            }
            // The publisher is one of the subscribers of its own channels, too.
            let fifo = Policy::Fifo(Depth::new(4).unwrap());
            self.hard_subscriptions.push((slot.etag, node.subscribe(&channel, Filter::ALL, fifo).unwrap()));
        }
        self.soft = Some(node.announce(&soft_channel()).unwrap());
        self.bulk = Some(node.announce(&bulk_channel()).unwrap());
        let order = Policy::DeadlineOrder(Depth::new(32).unwrap());
        self.soft_subscription = Some(node.subscribe(&soft_channel(), Filter::ALL, order).unwrap());
        self.next_soft = node.now;
        node.now + Duration::from_millis(1)
    }

    fn wake(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        let bound = self.calendar.segment().accuracy;
        let now = node.now;
        let healthy = node.hard().clock().accuracy(now) <= bound;
        let mut journal = self.journal.borrow_mut();
        let millisecond = (node.true_now.as_ticks() / MILLISECOND) as usize;
        let row = &mut journal.healthy[usize::from(self.number)];
        row.resize(row.len().max(millisecond + 1), false);
        row[millisecond] = healthy;
        for (slot, publication, published) in &mut self.hard_publications {
            // Each occurrence gets its index as content, in good time before its ready instant.
            let since_phase = node.global.since_epoch().as_ticks().saturating_sub(slot.phase.as_ticks());
            let next = since_phase / slot.period.as_ticks() + 1;
            let to_go = next * slot.period.as_ticks() - since_phase;
            // Not so close to a ready instant that it could be the slot before or behind.
            let in_between = MILLISECOND / 2..slot.period.as_ticks() - MILLISECOND / 2;
            if healthy && *published != next && in_between.contains(&to_go) {
                *published = next;
                // Of sporadic channels every third slot is used.
                if slot.periodic || next.is_multiple_of(3) {
                    node.publish(publication, &Event::new(next as u32)).unwrap();
                }
            }
        }
        if node.now >= self.next_soft {
            self.next_soft = node.now + self.soft_period;
            let published = node.publish(self.soft.as_ref().unwrap(), &Event::new(7));
            let _ = node.publish(self.bulk.as_ref().unwrap(), &Event::new([self.number; 8]));
            match published {
                Ok(()) => journal.soft_published += 1,
                Err(_) => journal.soft_refused += 1,
            }
        }
        node.now + Duration::from_millis(1)
    }

    fn notified(&mut self, node: &mut Access<'_, ClockService>) {
        let mut journal = self.journal.borrow_mut();
        for (etag, subscription) in &self.hard_subscriptions {
            while let Some(event) = node.next(subscription) {
                journal.hard.push(Delivery {
                    node: self.number,
                    etag: *etag,
                    index: event.content,
                    at: node.true_now,
                    global: node.global,
                });
            }
        }
        if let Some(subscription) = &self.soft_subscription {
            while node.next(subscription).is_some() {
                journal.soft_delivered += 1;
            }
        }
        while let Some(exception) = node.take_exception() {
            journal.exceptions.push((self.number, node.true_now, exception));
        }
    }
}
