//! What no protocol can keep from the wire, in an open cluster and in a sealed one: who starves is told so, and all goes
//! on when it is over. The rows of `docs/security.md` that need a bus; the others are in `cosmic-core/tests/sealed.rs`.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{BitPosition, Bus, Fault, FaultModel, Filter as Ids, Rule, StationId, WireFrame};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode, TxNodes};
use cosmic_core::event_layer::{
    Channel, Depth, Event, ExceptionKind, Filter, HardAttributes, Policy, Publication, SoftAttributes,
    Subscription,
};
use cosmic_core::protocol::{Class, Rank};
use cosmic_core::seal::{Seal, SealedChannel, SealedNode};
use cosmic_core::services::{self, NodeServices};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use cosmic_core::{NodeUid, Subject};
use embedded_can::ExtendedId;

type Services = NodeServices<4, 8, 4, 8>;
type Node<'n> = Access<'n, Services>;

const PUBLISHER: TxNode = TxNode::new(1).unwrap();
const SUBSCRIBER: TxNode = TxNode::new(2).unwrap();
const SOFT_ETAG: Etag = Etag::new(5_000).unwrap();
const PERIOD: Duration = Duration::from_millis(10);

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(50),
        release_jitter: Duration::from_micros(10),
    },
    PERIOD,
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: PUBLISHER,
        len: 4,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(2),
    }],
);

const HARD: Channel<u32> = Channel::hard(
    Subject::new(0xA).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 },
);
const SOFT: Channel<u32> = Channel::soft(
    Subject::new(0xB).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(2), validity: Duration::from_millis(4) },
)
.with_etag(SOFT_ETAG);

const fn uid(tx_node: TxNode) -> NodeUid {
    NodeUid::new(0xF0 + tx_node.get() as u64).unwrap()
}

static SEAL: Seal = Seal {
    nodes: &[
        SealedNode { uid: uid(PUBLISHER), tx_node: PUBLISHER, rank: Rank::new(0) },
        SealedNode { uid: uid(SUBSCRIBER), tx_node: SUBSCRIBER, rank: None },
    ],
    channels: &[
        SealedChannel {
            subject: HARD.subject(),
            etag: Etag::HARD_FIRST,
            class: Class::Hard,
            publishers: TxNodes::of(&[PUBLISHER]),
        },
        SealedChannel {
            subject: SOFT.subject(),
            etag: SOFT_ETAG,
            class: Class::Soft,
            publishers: TxNodes::of(&[PUBLISHER]),
        },
    ],
    brokers: &[],
};

/// Publishes on both channels in each period.
#[derive(Default)]
struct Publishing(Option<(Publication<u32>, Publication<u32>)>);

impl Application<Services> for Publishing {
    fn start(&mut self, node: &mut Node<'_>) -> Instant {
        node.now + Duration::from_millis(1_400)
    }

    fn wake(&mut self, node: &mut Node<'_>) -> Instant {
        let (hard, soft) =
            self.0.get_or_insert_with(|| (node.announce(&HARD).unwrap(), node.announce(&SOFT).unwrap()));
        // Even a node that is off the bus takes events; what becomes of them it tells.
        node.publish(hard, &Event::new(1)).unwrap();
        let _ = node.publish(soft, &Event::new(2));
        node.now + PERIOD
    }

    fn notified(&mut self, _: &mut Node<'_>) {}
}

#[derive(Default)]
struct Subscribing(Option<(Subscription<u32>, Subscription<u32>)>);

impl Application<Services> for Subscribing {
    fn start(&mut self, node: &mut Node<'_>) -> Instant {
        node.now + Duration::from_millis(1_450)
    }

    fn wake(&mut self, node: &mut Node<'_>) -> Instant {
        let policy = Policy::Fifo(Depth::new(4).unwrap());
        let mut subscribe = |channel| node.subscribe(channel, Filter::ALL, policy).unwrap();
        self.0 = Some((subscribe(&HARD), subscribe(&SOFT)));
        Instant::FAR_FUTURE
    }

    fn notified(&mut self, node: &mut Node<'_>) {
        if let Some((hard, soft)) = &self.0 {
            while node.next(hard).or_else(|| node.next(soft)).is_some() {}
        }
    }
}

struct Bench {
    cluster: Cluster<Services>,
    publisher: StationId,
    subscriber: StationId,
    attacker: StationId,
}

impl Bench {
    /// A cluster that has worked for so long, and of which nobody has told anything.
    fn new(seal: Option<&'static Seal>) -> Self {
        let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()), 1);
        let node =
            |tx_node: TxNode, application: Box<dyn Fn() -> Box<dyn Application<Services>>>| NodeConfig {
                name: format!("node {}", tx_node.get()),
                tx_node: Some(tx_node),
                calendar: &CALENDAR,
                clock: ClockErrors::realistic(Rate::from_parts_per_billion(0)),
                services: Box::new(move |now| {
                    let rank = Rank::new(0).filter(|_| tx_node == PUBLISHER);
                    let config = services::NodeConfig {
                        clock: SyncConfig { rank, ..SyncConfig::DEFAULT },
                        tx_node: Some(tx_node),
                        seal,
                        ..services::NodeConfig::new(uid(tx_node))
                    };
                    Services::new(&config, &CALENDAR, (), now).unwrap()
                }),
                global_clock: GlobalClock::unsynchronised(),
                application,
            };
        let publisher = cluster.add(node(PUBLISHER, Box::new(|| Box::new(Publishing::default()))));
        let subscriber = cluster.add(node(SUBSCRIBER, Box::new(|| Box::new(Subscribing::default()))));
        let attacker = cluster.bus().attach("attacker");
        cluster.power_on(publisher);
        cluster.power_on(subscriber);
        let mut bench = Self { cluster, publisher, subscriber, attacker };
        bench.pass(2_000);
        assert_eq!(bench.told(), Told::default());
        assert!(bench.delivered().iter().all(|events| *events > 40), "{:?}", bench.delivered());
        bench
    }

    fn pass(&mut self, milliseconds: u64) {
        let until = self.cluster.now() + Duration::from_millis(milliseconds);
        self.cluster.run_until(until);
    }

    fn told(&mut self) -> Told {
        let count = |cluster: &mut Cluster<Services>, station, kind| {
            cluster.visit(station, |node| node.half().exceptions(kind)).unwrap()
        };
        let mut of = |station, kind| count(&mut self.cluster, station, kind);
        Told {
            bus_off: of(self.publisher, ExceptionKind::BusOff),
            omitted: of(self.publisher, ExceptionKind::OmissionDegreeExceeded),
            late: of(self.publisher, ExceptionKind::MissedDeadline),
            missed: of(self.subscriber, ExceptionKind::MissedEvent),
        }
    }

    fn delivered(&mut self) -> [u32; 2] {
        [HARD.subject(), SOFT.subject()].map(|subject| {
            let counters = self.cluster.visit(self.subscriber, |node| node.half().channel_counters(subject));
            counters.flatten().unwrap().delivered
        })
    }

    /// So long all works again, and nobody tells of anything more.
    fn works_again(&mut self) {
        self.pass(100);
        let (told, [hard, soft]) = (self.told(), self.delivered());
        self.pass(200);
        assert_eq!((self.told(), self.delivered()), (told, [hard + 20, soft + 20]));
    }
}

/// Exceptions of the publisher; the last one is of the subscriber.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
struct Told {
    bus_off: u32,
    omitted: u32,
    late: u32,
    missed: u32,
}

#[test]
fn a_flood_at_priority_0() {
    for seal in [None, Some(&SEAL)] {
        let mut bench = Bench::new(seal);
        let id = Id::new(Priority::HARD, TxNode::MIN, Etag::HARD_FIRST);
        let frame = WireFrame::from(Frame::new(id, Payload::new(&[0xA5; 8]).unwrap()));
        let end = bench.cluster.now() + Duration::from_millis(200);
        let before = bench.delivered();
        while bench.cluster.now() < end {
            let now = bench.cluster.now();
            for mailbox in 0..3 {
                // Those that still wait are taken.
                let _ = bench.cluster.bus().load(now, bench.attacker, mailbox, frame);
            }
            bench.cluster.run_until(now + Duration::from_micros(100));
        }
        let told = bench.told();
        assert_eq!(bench.delivered(), before, "nothing gets through");
        assert!(told.omitted >= 19 && told.missed >= 19 && told.late >= 19, "{told:?}");
        assert_eq!(told.bus_off, 0);
        bench.works_again();
    }
}

#[test]
fn frames_that_are_destroyed_until_their_sender_is_off_the_bus() {
    for seal in [None, Some(&SEAL)] {
        let mut bench = Bench::new(seal);
        let of_publisher = ExtendedId::new(u32::from(PUBLISHER.get()) << 14).unwrap();
        let frames = Ids::new(of_publisher.into(), false, u32::from(TxNode::MAX.get()) << 14);
        let fault = Fault::Inverted(BitPosition::FromStart(40));
        bench.cluster.bus().faults_mut().add_rule(Rule { frames, skip: 0, count: u32::MAX, fault });
        bench.pass(200);
        let told = bench.told();
        assert!(told.bus_off > 0 && told.omitted >= 19 && told.missed >= 19, "{told:?}");
        bench.cluster.bus().faults_mut().clear_rules();
        bench.works_again();
    }
}
