//! Whole clusters on the bus: the three classes side by side, under load and faults.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, Chance, FaultModel, StationId, VirtualInstant};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Event, Exception, ExceptionKind, Filter, HardAttributes, Importance,
    NonRealTimeAttributes, Policy, Publication, SoftAttributes, Subscription,
};
use cosmic_core::protocol::Rank;
use cosmic_core::services::ClockService;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use std::cell::RefCell;
use std::rc::Rc;

const PERIOD: Duration = Duration::from_millis(10);

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(5),
    },
    PERIOD,
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: TxNode::new(1).unwrap(),
        len: 4,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(2),
    }],
);

const SPEED: Channel<u32> = Channel::hard(
    Subject::new(0x5EED).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 },
);
const TEMPERATURE: Channel<u64> = Channel::soft(
    Subject::new(0x7E39).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
)
.with_etag(Etag::BOUND_LAST);
const LOG: Channel<[u8; 8]> = Channel::non_real_time(
    Subject::new(0x106).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::new(0x3FFE).unwrap());

#[derive(Default)]
struct Journal {
    speeds: Vec<(u32, VirtualInstant)>,
    temperatures: Vec<u64>,
    logs: usize,
    exceptions: Vec<(u8, Exception)>,
}

type Shared = Rc<RefCell<Journal>>;

#[derive(Default)]
struct Sensor {
    journal: Shared,
    speed: Option<Publication<u32>>,
    temperature: Option<Publication<u64>>,
    log: Option<Publication<[u8; 8]>>,
    count: u32,
}

impl Application<ClockService> for Sensor {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        self.speed = Some(node.announce(&SPEED).unwrap());
        self.temperature = Some(node.announce(&TEMPERATURE).unwrap());
        self.log = Some(node.announce(&LOG).unwrap());
        node.now + Duration::from_millis(1)
    }

    fn wake(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        self.count += 1;
        if self.count.is_multiple_of(10) {
            let event = Event::new(self.count / 10);
            node.publish(self.speed.as_ref().unwrap(), &event).unwrap();
        }
        node.publish(self.temperature.as_ref().unwrap(), &Event::new(u64::from(self.count))).unwrap();
        let _ = node.publish(self.log.as_ref().unwrap(), &Event::new([0xAA; 8]));
        node.now + Duration::from_millis(1)
    }

    fn notified(&mut self, node: &mut Access<'_, ClockService>) {
        while let Some(exception) = node.take_exception() {
            self.journal.borrow_mut().exceptions.push((1, exception));
        }
    }
}

#[derive(Default)]
struct Brake {
    journal: Shared,
    speed: Option<Subscription<u32>>,
    temperature: Option<Subscription<u64>>,
    log: Option<Subscription<[u8; 8]>>,
}

impl Application<ClockService> for Brake {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        let fifo = Policy::Fifo(Depth::new(16).unwrap());
        self.speed = Some(node.subscribe(&SPEED, Filter::ALL, Policy::Latest).unwrap());
        self.temperature = Some(node.subscribe(&TEMPERATURE, Filter::ALL, fifo).unwrap());
        self.log = Some(node.subscribe(&LOG, Filter::ALL, fifo).unwrap());
        Instant::FAR_FUTURE
    }

    fn wake(&mut self, _: &mut Access<'_, ClockService>) -> Instant {
        Instant::FAR_FUTURE
    }

    fn notified(&mut self, node: &mut Access<'_, ClockService>) {
        let mut journal = self.journal.borrow_mut();
        while let Some(event) = node.next(self.speed.as_ref().unwrap()) {
            journal.speeds.push((event.content, node.true_now));
        }
        while let Some(event) = node.next(self.temperature.as_ref().unwrap()) {
            journal.temperatures.push(event.content);
        }
        while node.next(self.log.as_ref().unwrap()).is_some() {
            journal.logs += 1;
        }
        while let Some(exception) = node.take_exception() {
            journal.exceptions.push((2, exception));
        }
    }
}

fn cluster(faults: FaultModel, journal: &Shared) -> (Cluster<ClockService>, StationId, StationId) {
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, faults), 1);
    let node = |number: u8, drift: i32, journal: Shared| NodeConfig {
        name: format!("node {number}"),
        tx_node: TxNode::new(number),
        calendar: &CALENDAR,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(drift)),
        services: Box::new(move |now| {
            let config = SyncConfig { rank: Rank::new(number - 1), ..SyncConfig::DEFAULT };
            ClockService::new(config, &CALENDAR, TxNode::new(number), now).unwrap()
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: if number == 1 {
            Box::new(move || Box::new(Sensor { journal: journal.clone(), ..Sensor::default() }))
        } else {
            Box::new(move || Box::new(Brake { journal: journal.clone(), ..Brake::default() }))
        },
    };
    let sensor = cluster.add(node(1, 50_000, journal.clone()));
    let brake = cluster.add(node(2, -50_000, journal.clone()));
    (cluster, sensor, brake)
}

fn at(seconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(seconds * 1_000_000_000)
}

#[test]
fn all_classes_arrive_on_a_quiet_bus() {
    let journal = Shared::default();
    let (mut cluster, sensor, brake) = cluster(FaultModel::none(), &journal);
    cluster.power_on(sensor);
    cluster.run_until(VirtualInstant::from_ticks(3_333_333));
    cluster.power_on(brake);
    cluster.run_until(at(5));
    let journal = journal.borrow();
    // The clock needs about two seconds; after that every slot brings an event.
    assert!(journal.speeds.len() > 290, "{}", journal.speeds.len());
    let spans = journal.speeds.windows(2).map(|pair| pair[1].1 - pair[0].1);
    for (span, pair) in spans.zip(journal.speeds.windows(2)) {
        assert_eq!(pair[1].0, pair[0].0 + 1);
        let jitter = span.as_ticks().abs_diff(10_000_500);
        assert!(jitter < 12_000, "{span}");
    }
    assert!(journal.temperatures.len() > 4_900);
    assert!(journal.logs > 4_900);
    // The first slot comes before the first publication; then the clocks are not synchronised yet.
    let mut kinds: Vec<_> = journal.exceptions.iter().map(|(_, exception)| exception.kind).collect();
    kinds.dedup();
    assert_eq!(kinds, [ExceptionKind::NothingPublished, ExceptionKind::ClockOutOfBound]);
}

#[test]
fn faults_within_the_omission_degree_are_not_noticed() {
    let journal = Shared::default();
    let faults = FaultModel::seeded(7).with_inversion(Chance::new(0.02).unwrap());
    let (mut cluster, sensor, brake) = cluster(faults, &journal);
    cluster.power_on(sensor);
    cluster.power_on(brake);
    cluster.run_until(at(20));
    let journal = journal.borrow();
    assert!(journal.speeds.len() > 1_700, "{}", journal.speeds.len());
    for pair in journal.speeds.windows(2) {
        assert!(pair[1].0 > pair[0].0, "{pair:?}");
    }
}
