//! Messages longer than a frame, from several publishers at once, on a bus with errors.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, Chance, FaultModel, StationId, VirtualInstant};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Etag, Payload, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Filter, Importance, MessagePublisher, MessageSubscriber, NonRealTimeAttributes, Policy,
};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use std::cell::RefCell;
use std::rc::Rc;

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[],
);

const LOGBOOK: Channel<Payload> = Channel::non_real_time(
    Subject::new(0x106).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::BOUND_LAST);

/// Messages as they were started, and as they arrived, with their publisher.
#[derive(Default)]
struct Journal {
    started: Vec<(u8, Vec<u8>)>,
    arrived: Vec<(u8, Vec<u8>)>,
    dropped: u32,
}

type Shared = Rc<RefCell<Journal>>;

/// Publishes message after message, each of another length.
struct Writer {
    number: u8,
    journal: Shared,
    publisher: Option<MessagePublisher<100>>,
    count: usize,
}

impl Application<()> for Writer {
    fn start(&mut self, node: &mut Access<'_, ()>) -> Instant {
        self.publisher = Some(MessagePublisher::new(node.announce(&LOGBOOK).unwrap()));
        node.now
    }

    fn wake(&mut self, node: &mut Access<'_, ()>) -> Instant {
        let publisher = self.publisher.as_mut().unwrap();
        if publisher.is_idle() {
            let len = self.count * 7 % 101;
            let content: Vec<u8> = (0..len).map(|at| self.number ^ self.count as u8 ^ at as u8).collect();
            publisher.start(&content).unwrap();
            self.journal.borrow_mut().started.push((self.number, content));
            self.count += 1;
        }
        node.send_message(publisher).unwrap();
        node.now + Duration::from_millis(5)
    }

    fn notified(&mut self, node: &mut Access<'_, ()>) {
        if let Some(publisher) = &mut self.publisher {
            node.send_message(publisher).unwrap();
        }
    }
}

struct Reader {
    journal: Shared,
    subscriber: Option<MessageSubscriber<4, 100>>,
}

impl Application<()> for Reader {
    fn start(&mut self, node: &mut Access<'_, ()>) -> Instant {
        let fifo = Policy::Fifo(Depth::new(16).unwrap());
        let subscription = node.subscribe(&LOGBOOK, Filter::ALL, fifo).unwrap();
        self.subscriber = Some(MessageSubscriber::new(subscription, Duration::from_millis(100)));
        Instant::FAR_FUTURE
    }

    fn wake(&mut self, _: &mut Access<'_, ()>) -> Instant {
        Instant::FAR_FUTURE
    }

    fn notified(&mut self, node: &mut Access<'_, ()>) {
        let Some(subscriber) = &mut self.subscriber else { return };
        let mut journal = self.journal.borrow_mut();
        node.receive_messages(subscriber, |message| {
            journal.arrived.push((message.publisher.get(), message.content.to_vec()));
        });
        let counters = subscriber.counters();
        journal.dropped = counters.incomplete + counters.corrupt;
    }
}

fn cluster(faults: FaultModel) -> (Cluster<()>, Vec<StationId>, Shared) {
    let journal = Shared::default();
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, faults), 1);
    let mut stations = Vec::new();
    for number in 1..=4 {
        let journal = journal.clone();
        stations.push(cluster.add(NodeConfig {
            name: format!("node {number}"),
            tx_node: TxNode::new(number),
            calendar: &CALENDAR,
            clock: ClockErrors::NONE,
            services: Box::new(|_| ()),
            global_clock: GlobalClock::free_running(),
            application: Box::new(move || {
                let journal = journal.clone();
                match number {
                    4 => Box::new(Reader { journal, subscriber: None }),
                    _ => Box::new(Writer { number, journal, publisher: None, count: 0 }),
                }
            }),
        }));
    }
    for station in &stations {
        cluster.power_on(*station);
    }
    (cluster, stations, journal)
}

fn milliseconds(count: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(count * 1_000_000)
}

fn of(journal: &[(u8, Vec<u8>)], publisher: u8) -> Vec<&Vec<u8>> {
    journal.iter().filter(|(from, _)| *from == publisher).map(|(_, content)| content).collect()
}

#[test]
fn messages_of_three_publishers_arrive_whole_and_in_order() {
    let faults = FaultModel::seeded(9).with_inversion(Chance::new(0.02).unwrap());
    let (mut cluster, _, journal) = cluster(faults);
    cluster.run_until(milliseconds(3_000));
    let journal = journal.borrow();
    for publisher in 1..=3 {
        let (started, arrived) = (of(&journal.started, publisher), of(&journal.arrived, publisher));
        assert!(arrived.len() > 100, "{}", arrived.len());
        // All but what is under way.
        assert!(started.len() - arrived.len() <= 1);
        assert!(started.iter().zip(&arrived).all(|(started, arrived)| started == arrived));
    }
    assert_eq!(journal.dropped, 0);
}

#[test]
fn repeated_fragments_are_one_and_a_publisher_that_dies_leaves_nothing() {
    let faults = FaultModel::seeded(4).with_omission(Chance::new(0.05).unwrap());
    let (mut cluster, stations, journal) = cluster(faults);
    for round in 1..=20 {
        cluster.run_until(milliseconds(round * 103));
        cluster.power_on(stations[0]);
    }
    cluster.run_until(milliseconds(3_000));
    let journal = journal.borrow();
    for (publisher, content) in &journal.arrived {
        assert!(journal.started.contains(&(*publisher, content.clone())));
    }
    // The two that live have lost nothing.
    for publisher in 2..=3 {
        let (started, arrived) = (of(&journal.started, publisher), of(&journal.arrived, publisher));
        assert!(started.len() - arrived.len() <= 1, "{} of {}", arrived.len(), started.len());
    }
}
