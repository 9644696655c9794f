//! What clocks and hard real-time channels promise at 1 Mbit/s holds at the slow bit rates, where a bit is as
//! long as all errors of the time-stamps together.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, FaultModel, StationId, VirtualInstant};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, Event, ExceptionKind, Filter, HardAttributes, Policy, Publication, Subscription,
};
use cosmic_core::protocol::Rank;
use cosmic_core::services::ClockService;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use std::cell::RefCell;
use std::rc::Rc;

const PERIOD: Duration = Duration::from_millis(20);
const ACCURACY: Duration = Duration::from_micros(50);
const RELEASE_JITTER: Duration = Duration::from_micros(20);
/// How late an interrupt may be, as in the firmware, and a timer of 4 MHz.
const LATENCY: Duration = Duration::from_micros(10);
const TICK: Duration = Duration::from_ticks(250);
const NODES: u8 = 3;
const MILLISECOND: u64 = 1_000_000;

const SPEED: Channel<u32> = Channel::hard(
    Subject::new(0x5EED).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 },
);

fn calendar(bit_rate: BitRate) -> &'static Calendar {
    let slots = Box::leak(Box::new([Slot {
        etag: Etag::HARD_FIRST,
        publisher: TxNode::new(1).unwrap(),
        len: 4,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(2),
    }]));
    let segment = Segment { bit_rate, accuracy: ACCURACY, release_jitter: RELEASE_JITTER };
    Box::leak(Box::new(Calendar::new(segment, PERIOD, slots).unwrap()))
}

/// Contents with the instants of their delivery.
type Journal = Rc<RefCell<Vec<(u32, VirtualInstant)>>>;

/// Node 1 publishes the speed in each period, the others subscribe to it.
#[derive(Default)]
struct Node {
    number: u8,
    journal: Journal,
    publication: Option<Publication<u32>>,
    subscription: Option<Subscription<u32>>,
    count: u32,
}

impl Application<ClockService> for Node {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        if self.number == 1 {
            self.publication = Some(node.announce(&SPEED).unwrap());
            return node.now + PERIOD;
        }
        self.subscription = Some(node.subscribe(&SPEED, Filter::ALL, Policy::Latest).unwrap());
        Instant::FAR_FUTURE
    }

    fn wake(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        // Once a slot, whatever global time is: well before the next one.
        self.count += 1;
        let _ = node.publish(self.publication.as_ref().unwrap(), &Event::new(self.count));
        let since = node.global.since_epoch().as_ticks() % PERIOD.as_ticks();
        node.now + Duration::from_ticks(PERIOD.as_ticks() + 15 * MILLISECOND - since)
    }

    fn notified(&mut self, node: &mut Access<'_, ClockService>) {
        while let Some(event) = self.subscription.as_ref().and_then(|it| node.next(it)) {
            self.journal.borrow_mut().push((event.content, node.true_now));
        }
    }
}

fn cluster(bit_rate: BitRate, journals: &[Journal]) -> (Cluster<ClockService>, Vec<StationId>) {
    let mut cluster = Cluster::new(Bus::new(bit_rate, FaultModel::none()), 3);
    let calendar = calendar(bit_rate);
    let stations = (1..=NODES).zip(journals).map(|(number, journal)| {
        let journal = journal.clone();
        cluster.add(NodeConfig {
            name: format!("node {number}"),
            tx_node: TxNode::new(number),
            calendar,
            clock: ClockErrors {
                drift: Rate::from_parts_per_billion(40_000 * (i32::from(number) - 2)),
                starts_at: Instant::EPOCH + Duration::from_secs(number.into()),
                tick: TICK,
                stamp_delay: LATENCY,
                release_delay: Duration::from_micros(5),
            },
            services: Box::new(move |now| {
                let config = SyncConfig {
                    rank: Rank::new(number - 1),
                    stamp_error: SyncConfig::stamp_error_for(bit_rate, LATENCY + TICK),
                    ..SyncConfig::DEFAULT
                };
                ClockService::new(config, calendar, TxNode::new(number), now).unwrap()
            }),
            global_clock: GlobalClock::unsynchronised(),
            application: Box::new(move || {
                Box::new(Node { number, journal: journal.clone(), ..Node::default() })
            }),
        })
    });
    let stations = stations.collect();
    (cluster, stations)
}

/// Global time on a node, and how far it may be off, in nanoseconds.
fn sample(cluster: &mut Cluster<ClockService>, station: StationId) -> (i64, u64) {
    let read = cluster.visit(station, |node| {
        let (clock, now) = (*node.hard().clock(), node.exact_now);
        (clock.to_global(now).since_epoch().as_ticks().cast_signed(), clock.accuracy(now).as_ticks())
    });
    read.expect("the node is on")
}

fn check(bit_rate: BitRate) {
    let journals: Vec<Journal> = (0..NODES).map(|_| Journal::default()).collect();
    let (mut cluster, stations) = cluster(bit_rate, &journals);
    for station in &stations {
        cluster.power_on(*station);
    }
    // Eight periods until there is a master, six until it is trusted.
    let settled = 3_000;
    for millisecond in settled..13_000 {
        cluster.run_until(VirtualInstant::from_ticks(millisecond * MILLISECOND));
        let (master, exact) = sample(&mut cluster, stations[0]);
        assert_eq!(exact, 0);
        for station in &stations[1..] {
            let (global, accuracy) = sample(&mut cluster, *station);
            let off = global.abs_diff(master);
            assert!(off <= accuracy, "{bit_rate:?}, {millisecond} ms: {off} ns, said to be {accuracy} ns");
            assert!(accuracy <= ACCURACY.as_ticks(), "{bit_rate:?}, {millisecond} ms: {accuracy} ns");
        }
    }
    for journal in &journals[1..] {
        let journal = journal.borrow();
        let after = journal.iter().filter(|(_, at)| at.as_ticks() > settled * MILLISECOND);
        let after: Vec<_> = after.collect();
        assert!((498..=501).contains(&after.len()), "{bit_rate:?}: {}", after.len());
        let most = 2 * ACCURACY.as_ticks() + RELEASE_JITTER.as_ticks();
        for pair in after.windows(2) {
            assert_eq!(pair[1].0, pair[0].0 + 1, "{bit_rate:?}");
            let span = (pair[1].1 - pair[0].1).as_ticks();
            assert!(span.abs_diff(PERIOD.as_ticks()) <= most, "{bit_rate:?}: {span} ns");
        }
    }
    for station in stations {
        let omitted =
            cluster.visit(station, |node| node.half().exceptions(ExceptionKind::OmissionDegreeExceeded));
        assert_eq!(omitted, Some(0));
    }
}

#[test]
fn clocks_keep_their_bounds_and_events_their_instants_at_every_bit_rate() {
    for kilobits in [50, 125, 250, 500, 1_000] {
        check(BitRate::new(kilobits * 1_000).unwrap());
    }
}
