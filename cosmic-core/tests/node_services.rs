//! A whole node with all services and a broker, frame by frame: what crosses from the event half into the
//! services, and what does not.

use cosmic_core::admission::{AdmissionPlan, Reservations, Unplanned};
use cosmic_core::broker::{Broker, BrokerEvent, BrokerRole, BrokerTiming, Nodes, Subjects};
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Outcome, Payload, TxNode};
use cosmic_core::client::OnDuplicate;
use cosmic_core::event_layer::{
    AnnounceError, Channel, Event, EventRate, Exception, ExceptionKind, Filter, HardAttributes, Policy,
    PublishError, SoftAttributes,
};
use cosmic_core::network::hard::{CalendarStep, Dispatcher, HrtBuffers};
use cosmic_core::services::{NodeConfig, NodeServices, PlannedServices, Services};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::{Due, EventHalf, Input, NodeUid, Step, Subject};

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
        for frame in frames {
            self.half.on_input(&Input::Frame(from_candump(frame)), now);
        }
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

const STRANGER: &str = "1F404007#0000000000000001";

/// What a node publishes under its fixed id while another one may have it would be taken for the other's.
#[test]
fn a_node_publishes_under_its_fixed_id_only_once_it_has_it() {
    let mut node = plain(&config());
    let publication = node.half.announce(&SOFT).unwrap();
    let publish = |node: &mut Node<Plain>, now| {
        let due = node.half.publish(at(now), &publication, &Event::new(7)).map(|due| due.command());
        // The command of an idle mailbox.
        due.map(|due| due.is_some())
    };
    // Claiming: the node says so on the bus, and listens.
    assert_eq!(publish(&mut node, 0), Err(PublishError::NotBound));
    let mut sent: Vec<_> = (0..20).flat_map(|now| node.poll(at(now))).collect();
    assert_eq!(sent.pop(), Some(from_candump("1F404007#000000000000FFFF")));
    // Another one works with this id: the claim is lost, and nothing is sent for its pause, of about two seconds.
    let _ = node.hear(at(20), &[STRANGER]);
    for now in 21..1_500 {
        assert_eq!(node.poll(at(now)), [], "at {now} ms");
        assert_eq!(publish(&mut node, now), Err(PublishError::NotBound));
    }
    assert_eq!(node.half.exceptions(ExceptionKind::DuplicateTxNode), 1);
    // The other one has gone: the second claim succeeds.
    node.run(1_500..4_500);
    assert_eq!(node.half.services().tx_node(), Some(PUBLISHER));
    assert_eq!(publish(&mut node, 4_500), Ok(true));
}

/// A hard real-time event that waits for its slot bears the node's id, as the others do.
#[test]
fn what_waits_for_a_slot_is_not_sent_under_an_id_that_is_lost() {
    let mut node = plain(&NodeConfig { on_duplicate: Some(OnDuplicate::Yield), ..config() });
    let publication = node.half.announce(&HARD).unwrap();
    let publish = |node: &mut Node<Plain>, now| node.half.publish(at(now), &publication, &Event::new(7));
    assert_eq!(publish(&mut node, 0), Err(PublishError::NotBound), "it still claims its id");
    node.run(0..200);
    assert_eq!(publish(&mut node, 200), Ok(Due::NOTHING));
    assert_eq!(next_slot(&mut node, 201), 1);
    assert_eq!(publish(&mut node, 230), Ok(Due::NOTHING));
    for now in 231..235 {
        let _ = node.hear(at(now), &[STRANGER]);
    }
    assert_eq!(node.half.services().tx_node(), None);
    assert_eq!(node.half.exceptions(ExceptionKind::IdentifierLost), 1);
    assert_eq!(next_slot(&mut node, 240), 0, "nothing is sent");
    assert_eq!(publish(&mut node, 300), Err(PublishError::NotBound));
    // With its id it has its slot again.
    node.run(300..5_000);
    assert_eq!(node.half.services().tx_node(), Some(PUBLISHER));
    assert_eq!(publish(&mut node, 5_000), Ok(Due::NOTHING));
    assert_eq!(next_slot(&mut node, 5_001), 1);
}

/// How many frames the calendar task loads within two periods from this millisecond on.
fn next_slot(node: &mut Node<Plain>, from: u64) -> usize {
    let buffers = node.half.hard_mut();
    buffers.set_clock(GlobalClock::free_running());
    let mut dispatcher = Dispatcher::new(&CALENDAR);
    let mut loaded = 0;
    for now in from * 1_000..(from + 20) * 1_000 {
        let now = Instant::from_epoch(Duration::from_micros(now));
        if let CalendarStep::Command(command) = dispatcher.poll(now, buffers) {
            loaded += usize::from(matches!(command, Command::Load(..)));
            if let Command::Withdraw(_) = command {
                let _ = buffers.on_outcome(Outcome::Withdrawn, now);
            }
        }
    }
    loaded
}

/// The slots of the calendar belong to a TxNode, not to a node: one that gets another id has no slot any more.
#[test]
fn a_node_that_gets_another_id_does_not_go_on_in_the_slots_of_the_old_one() {
    // Asks for its first nibble; the broker knows all but the last one, and then assigns an id.
    let configure = |node: &mut Node<Plain>, from: u64, assigned: &str| {
        let asks = (from..from + 5_000).find(|now| !node.poll(at(*now)).is_empty()).unwrap();
        let _ = node.hear(at(asks), &["1F5FC000#000000000000FFF1"]);
        let _ = node.hear(at(asks), &[assigned]);
        node.run(asks..asks + 200);
        asks + 200
    };
    let mut node = plain(&NodeConfig::new(uid(0xFFFF)));
    let now = configure(&mut node, 0, "1F404000#000000000000FFFF");
    assert_eq!(node.half.services().tx_node(), Some(PUBLISHER));
    let publication = node.half.announce(&HARD).unwrap();
    let publish = |node: &mut Node<Plain>, now| node.half.publish(at(now), &publication, &Event::new(7));
    assert_eq!(publish(&mut node, now), Ok(Due::NOTHING));
    assert_eq!(next_slot(&mut node, now + 1), 1);
    for now in now + 30..now + 34 {
        let _ = node.hear(at(now), &[STRANGER]);
    }
    assert_eq!(node.half.services().tx_node(), None);
    let now = configure(&mut node, now + 40, "1F408000#000000000000FFFF");
    assert_eq!(node.half.services().tx_node(), TxNode::new(2));
    assert_eq!(publish(&mut node, now), Err(PublishError::NotAnnounced));
    assert_eq!(next_slot(&mut node, now + 1), 0);
    let told = core::iter::from_fn(|| node.half.take_exception());
    let lost =
        |told: &Exception| told.kind == ExceptionKind::IdentifierLost && told.subject == Some(HARD.subject());
    assert_eq!(told.into_iter().filter(lost).count(), 1);
}

static ASKING: AdmissionPlan = AdmissionPlan {
    unplanned: Unplanned::Ask,
    planned: &[],
    reservations: Reservations::nothing(BitRate::MAX, Duration::from_micros(160), Duration::from_micros(5)),
};

#[test]
fn services_that_ask_for_no_channel_refuse_one_that_has_to_be_asked_for() {
    let config = NodeConfig { admission: Some(&ASKING), ..config() };
    let channel = SOFT.with_rate(EventRate::periodic(Duration::from_millis(10)));
    let planned = PlannedServices::<4, 8, 4, 8>::new(&config, &CALENDAR, (), at(0)).unwrap();
    assert_eq!(Node::new(planned).half.announce(&channel).err(), Some(AnnounceError::NotAskable));
    assert!(plain(&config).half.announce(&channel).is_ok());
}
