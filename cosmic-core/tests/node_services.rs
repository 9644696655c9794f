//! A whole node with all services and a broker, frame by frame: what crosses from the event half into the
//! services, and what does not.

use cosmic_core::broker::{Broker, BrokerEvent, BrokerRole, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Outcome, Payload, TxNode};
use cosmic_core::client::OnDuplicate;
use cosmic_core::event_layer::{Channel, ExceptionKind, Filter, HardAttributes, Policy, SoftAttributes};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::services::{NodeConfig, NodeServices, Services};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::{EventHalf, Input, NodeUid, Step, Subject};

type Hosting = NodeServices<4, 8, 4, 8, Broker<4, 4>>;
type Plain = NodeServices<4, 8, 4, 8>;
type Half<S> = EventHalf<4, 4, 4, 8, 8, 8, S>;

const PUBLISHER: TxNode = TxNode::new(1).unwrap();
const ATTRIBUTES: HardAttributes =
    HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 };

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: PUBLISHER,
        len: 2,
        omission_degree: ATTRIBUTES.omission_degree,
        periodic: ATTRIBUTES.periodic,
        period: ATTRIBUTES.period,
        phase: Duration::from_millis(0),
    }],
);

const HARD: Channel<u16> =
    Channel::hard(Subject::new(0x1122_3344_5566_7788).unwrap(), Etag::HARD_FIRST, ATTRIBUTES);
/// Its etag is fixed, and no broker knows of it.
const SOFT: Channel<u16> = Channel::soft(
    Subject::new(0xB).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
)
.with_etag(Etag::new(0x3FFD).unwrap());

fn uid(uid: u64) -> NodeUid {
    NodeUid::new(uid).unwrap()
}

fn at(milliseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_millis(milliseconds))
}

/// A frame as `candump` writes it: identifier, `#`, data.
fn from_candump(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let id = Id::from_raw(u32::from_str_radix(id, 16).unwrap()).unwrap();
    let digits = |at: usize| u8::from_str_radix(&data[at..at + 2], 16).unwrap();
    let bytes: Vec<u8> = (0..data.len()).step_by(2).map(digits).collect();
    Frame::new(id, Payload::new(&bytes).unwrap())
}

struct Node<S> {
    half: Half<S>,
}

impl<S: Services> Node<S> {
    fn new(services: S) -> Self {
        let hard = HrtBuffers::new(GlobalClock::unsynchronised());
        Self { half: Half::new(Some(PUBLISHER), &CALENDAR, services, hard) }
    }

    /// All that the node sends at this time; the bus is idle.
    fn poll(&mut self, now: Instant) -> Vec<Frame> {
        let mut sent = Vec::new();
        while let Step::Command(command) = self.half.poll(now) {
            if let Command::Load(mailbox, frame) = command {
                sent.push(frame);
                self.half.on_input(&Input::Outcome(mailbox, Outcome::Sent), now);
            }
        }
        sent
    }

    /// Takes frames at this time, and returns what is sent then.
    fn hear(&mut self, now: Instant, frames: &[&str]) -> Vec<Frame> {
        frames.iter().for_each(|frame| self.half.on_input(&Input::Frame(from_candump(frame)), now));
        self.poll(now)
    }

    fn run(&mut self, milliseconds: core::ops::Range<u64>) {
        milliseconds.for_each(|now| _ = self.poll(at(now)));
    }
}

fn config() -> NodeConfig {
    NodeConfig { tx_node: Some(PUBLISHER), ..NodeConfig::new(uid(0xFFFF)) }
}

fn hosting() -> Node<Hosting> {
    let broker = Broker::new(uid(0xFFFF), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
    Node::new(Hosting::new(&config(), &CALENDAR, broker, at(0)).unwrap())
}

fn plain(config: &NodeConfig) -> Node<Plain> {
    Node::new(Plain::new(config, &CALENDAR, (), at(0)).unwrap())
}

#[test]
fn the_broker_of_a_node_hears_the_events_of_foreign_channels() {
    let mut node = hosting();
    node.half.subscribe(&SOFT, Filter::ALL, Policy::Latest).unwrap();
    node.run(0..1000);
    assert_eq!(node.half.services().broker().role(), BrokerRole::Active);
    // Node 0x7E uses 0x3FFF, in which this node takes no part, and node 0x7D publishes what it subscribes to.
    let _ = node.hear(at(1000), &["021FBFFF#AA", "021F7FFD#0001"]);
    assert_eq!(node.half.foreign_frames(), 1);
    let broker = node.half.services().broker();
    assert_eq!((broker.nodes().unnamed(), broker.nodes().free()), (2, 2));
    // 0x3FFD is this node's own: it has told its broker.
    let answer = node.hear(at(1001), &["1F424002#0000000000000007"]);
    assert_eq!(answer, ["1F5FC004#09003FFE00000000", "1F5FC004#09013FFE00000007"].map(from_candump));
    let answer = node.hear(at(1002), &["1F424002#0000000000000008"]);
    assert_eq!(answer, ["1F5FC004#09003FFC00000000", "1F5FC004#09013FFC00000008"].map(from_candump));
    let news = core::iter::from_fn(|| node.half.services_mut().take_news());
    let used_up = |news: &cosmic_core::services::News| {
        matches!(news, cosmic_core::services::News::Broker(BrokerEvent::EtagsUsedUp { .. }))
    };
    assert!(news.into_iter().any(|news| used_up(&news)), "the table has four places");
}

#[test]
fn a_publisher_of_the_calendar_is_not_silenced_by_identities_of_a_lower_uid() {
    let silenced = |config: NodeConfig| {
        let mut node = plain(&config);
        node.run(0..200);
        assert_eq!(node.half.services().tx_node(), Some(PUBLISHER));
        for now in 200..231 {
            let _ = node.hear(at(now), &["1F404007#0000000000000001"]);
        }
        let told = node.half.exceptions(ExceptionKind::DuplicateTxNode);
        assert_eq!(told, 1, "once in a second");
        node.half.services().tx_node().is_none()
    };
    assert!(!silenced(config()));
    assert!(silenced(NodeConfig { on_duplicate: Some(OnDuplicate::Yield), ..config() }));
    // The calendar does not name this one.
    let other = NodeConfig { tx_node: TxNode::new(2), ..config() };
    assert_eq!(other.on_duplicate, None);
    let mut node = plain(&other);
    node.run(0..200);
    for now in 200..231 {
        let _ = node.hear(at(now), &["1F408007#0000000000000001"]);
    }
    assert_eq!(node.half.services().tx_node(), None);
}

/// A hard real-time channel has its etag from the calendar, and two forged frames do not change it.
#[test]
fn a_forged_binding_does_not_move_a_hard_channel() {
    let mut node = plain(&config());
    node.half.subscribe(&HARD, Filter::ALL, Policy::Latest).unwrap();
    node.run(0..200);
    let _ = node.hear(at(200), &["1F5FC004#2A003FFE11223344", "1F5FC004#2A013FFE55667788"]);
    assert_eq!(node.half.services().etag_of(HARD.subject()), Some(Etag::HARD_FIRST));
    let told = node.half.take_exception().unwrap();
    assert_eq!((told.subject, told.kind), (Some(HARD.subject()), ExceptionKind::BindingRefused));
}
