//! Each row of the threat model in `docs/security.md`: what a hostile or broken node reaches in an open cluster, and
//! in a sealed one; who is told, and that a sealed node answers by no frame.

use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Outcome, Payload, Priority, TxNode, TxNodes};
use cosmic_core::event_half::receive;
use cosmic_core::event_layer::{
    AnnounceError, Channel, ExceptionKind, Filter, HardAttributes, Policy, SoftAttributes, SubscribeError,
};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::protocol::*;
use cosmic_core::seal::{Contradiction, Seal, SealedChannel, SealedNode};
use cosmic_core::services::{ClockService, NodeConfig, NodeServices, PlannedServices, Services};
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant};
use cosmic_core::{EventHalf, Input, NodeUid, Step, Subject};

type Node = NodeServices<4, 8, 4, 8>;
type Half<S> = EventHalf<4, 4, 4, 8, 8, 8, S>;

/// This node, which publishes in the calendar; the master and broker; one that publishes on the soft channel; and one
/// that is not in the plan.
const ME: TxNode = TxNode::new(1).unwrap();
const MASTER: TxNode = TxNode::new(2).unwrap();
const SENSOR: TxNode = TxNode::new(3).unwrap();
const STRANGER: TxNode = TxNode::new(9).unwrap();

const fn uid(uid: u64) -> NodeUid {
    NodeUid::new(uid).unwrap()
}

const MY_UID: NodeUid = uid(0xFFFF);

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(10),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: ME,
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(0),
    }],
);

const HARD: Channel<u16> = Channel::hard(
    Subject::new(0x1122_3344_5566_7788).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
);

const HEAT_ETAG: Etag = Etag::new(0x3FFD).unwrap();
const HEAT: Channel<u16> = soft(0xB, HEAT_ETAG);

const fn soft(subject: u64, etag: Etag) -> Channel<u16> {
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) };
    Channel::soft(Subject::new(subject).unwrap(), attributes).with_etag(etag)
}

static SEAL: Seal = Seal {
    nodes: &[
        SealedNode { uid: MY_UID, tx_node: ME, rank: Rank::new(1) },
        SealedNode { uid: uid(0xB2), tx_node: MASTER, rank: Rank::new(0) },
        SealedNode { uid: uid(0xB3), tx_node: SENSOR, rank: None },
    ],
    channels: &[
        SealedChannel {
            subject: HARD.subject(),
            etag: Etag::HARD_FIRST,
            class: Class::Hard,
            publishers: TxNodes::of(&[ME]),
        },
        SealedChannel {
            subject: HEAT.subject(),
            etag: HEAT_ETAG,
            class: Class::Soft,
            publishers: TxNodes::of(&[SENSOR]),
        },
    ],
    brokers: &[uid(0xB2)],
};

fn at(milliseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_millis(milliseconds))
}

struct Bench<S: Services> {
    half: Half<S>,
}

impl<S: Services> Bench<S> {
    fn new(services: S) -> Self {
        let hard = HrtBuffers::new(GlobalClock::unsynchronised());
        Self { half: Half::new(Some(ME), &CALENDAR, services, hard) }
    }

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

    fn hear(&mut self, now: Instant, frame: Frame) -> Vec<Frame> {
        if let Some(input) = receive(&frame, now, self.half.hard_mut()) {
            self.half.on_input(&input, now);
        }
        self.poll(now)
    }

    fn told(&mut self) -> Vec<(Option<Subject>, ExceptionKind)> {
        core::iter::from_fn(|| self.half.take_exception()).map(|told| (told.subject, told.kind)).collect()
    }
}

fn config(seal: Option<&'static Seal>) -> NodeConfig {
    NodeConfig { tx_node: Some(ME), seal, ..NodeConfig::new(MY_UID) }
}

/// A node that works, and subscribes to the soft channel, at 200 ms. What it sends of itself is over for a while.
fn node(seal: Option<&'static Seal>) -> Bench<Node> {
    let mut node = Bench::new(Node::new(&config(seal), &CALENDAR, (), at(0)).unwrap());
    node.half.subscribe(&HEAT, Filter::ALL, Policy::Latest).unwrap();
    for now in 0..200 {
        node.poll(at(now));
    }
    assert_eq!(node.half.services().tx_node(), Some(ME));
    assert_eq!(node.told(), []);
    node
}

/// What 100 ms of these frames, one a millisecond, make an open and a sealed node send, and of which it tells.
struct Effect {
    node: Bench<Node>,
    sent: usize,
    told: Vec<(Option<Subject>, ExceptionKind)>,
}

fn flood(seal: Option<&'static Seal>, frames: &[Frame]) -> Effect {
    let mut node = node(seal);
    let mut sent = 0;
    for now in 200..300 {
        for frame in frames {
            sent += node.hear(at(now), *frame).len();
        }
    }
    let told = node.told();
    Effect { node, sent, told }
}

/// A sealed node sends nothing and tells once of each kind, with all of them counted and the last one named.
fn refused(frames: &[Frame], contradiction: Contradiction) -> Bench<Node> {
    let Effect { node, sent, told } = flood(Some(&SEAL), frames);
    assert_eq!((sent, told), (0, vec![(None, contradiction.exception())]));
    let refusals = *node.half.services().refusals().unwrap();
    assert_eq!(refusals.count(contradiction), 100 * frames.len() as u32);
    let last = refusals.last.unwrap();
    assert_eq!((last.id, last.at), (frames.last().unwrap().id, at(299)));
    node
}

#[test]
fn a_false_broker() {
    let status = BrokerStatus { tx_node: STRANGER, uid: uid(1) }.encode();
    let open = flood(None, &[status]);
    assert_eq!((open.sent, open.told), (0, vec![]), "an open node knows of no other broker");
    refused(&[status], Contradiction::Broker);
    // Nor one of the plan that is not the broker; but the broker is believed.
    refused(&[BrokerStatus { tx_node: SENSOR, uid: uid(0xB3) }.encode()], Contradiction::Broker);
    let right = BrokerStatus { tx_node: MASTER, uid: uid(0xB2) }.encode();
    assert_eq!(flood(Some(&SEAL), &[right]).told, []);
}

#[test]
fn a_false_binding() {
    let other = Etag::new(0x3FF0).unwrap();
    let halves = |subject, etag| {
        SupplyEtag::pair(TxNode::BROKER, ME, subject, Answer::Bound(etag)).map(|half| half.encode())
    };
    let false_one = halves(HEAT.subject(), other);
    let open = flood(None, &false_one);
    assert_eq!(open.told, [(Some(HEAT.subject()), ExceptionKind::BindingRefused)], "it is fixed");
    refused(&false_one, Contradiction::Binding);
    refused(&halves(Subject::new(0x77).unwrap(), HEAT_ETAG)[1..], Contradiction::Binding);
    let refusal =
        SupplyEtag::pair(TxNode::BROKER, ME, HEAT.subject(), Answer::Refused).map(|half| half.encode());
    refused(&refusal, Contradiction::Binding);
    assert_eq!(flood(Some(&SEAL), &halves(HEAT.subject(), HEAT_ETAG)).told, []);
}

/// The master of the plan has sent two pairs, and the node follows it. Then a false one with a better rank does.
fn follow_up_pair(sender: TxNode, rank: u8, sequence: u8, instant: u64) -> [Frame; 2] {
    let sequence = SyncSequence::new(sequence);
    let sync = SyncMessage {
        sequence,
        rank: Rank::new(rank).unwrap(),
        predecessor: sender,
        accuracy: Duration::from_ticks(0),
        calendar_digest: CALENDAR.digest(),
    };
    let sent_at = GlobalInstant::from_epoch(Duration::from_millis(instant));
    [sync.encode(sender), FollowUp { sequence, sent_at }.encode(sender)]
}

fn master_of(seal: Option<&'static Seal>) -> (Option<u8>, Vec<ExceptionKind>) {
    let config = SyncConfig { rank: Rank::new(1), ..SyncConfig::DEFAULT };
    let mut service = <ClockService>::new(config, &CALENDAR, Some(ME), at(0)).unwrap().sealed(seal);
    let mut followed = None;
    let mut told = Vec::new();
    for (turn, now) in (1..8).map(|turn| (turn, u64::from(turn) * 100)) {
        // 1 ms later a master that is 5 s ahead, with the rank of the first.
        let pairs = [follow_up_pair(MASTER, 0, turn, now), follow_up_pair(TxNode::MIN, 0, turn, now + 5_000)];
        for frame in pairs.as_flattened() {
            service.on_frame(frame, at(now + u64::from(frame.id.tx_node() == TxNode::MIN)));
            while let Some(request) = service.poll(at(now + 2), &Default::default()) {
                if let cosmic_core::services::Request::Exception(_, kind) = request {
                    told.push(kind);
                }
            }
        }
        if let Some(cosmic_core::sync::ClockEvent::MasterChanged { master, .. }) = service.take_event() {
            followed = Some(master.get());
        }
    }
    (followed, told)
}

#[test]
fn a_false_master() {
    assert_eq!(master_of(None), (Some(0), vec![]), "the lower TxNode wins");
    assert_eq!(master_of(Some(&SEAL)), (Some(2), vec![ExceptionKind::FalseMaster]));
    // One of the plan with a rank that is another's, and one that has none.
    refused(&follow_up_pair(MASTER, 3, 1, 0)[..1], Contradiction::Master);
    refused(&follow_up_pair(SENSOR, 0, 1, 0), Contradiction::Master);
}

#[test]
fn identities_of_a_lower_uid() {
    let identity = |tx_node, of| NodeIdentity { tx_node, uid: uid(of) }.encode();
    let open = flood(None, &[identity(ME, 1)]);
    assert!(open.sent > 0, "it answers");
    assert_eq!(open.told, [(None, ExceptionKind::DuplicateTxNode)]);
    let sealed = refused(&[identity(ME, 1)], Contradiction::OwnTxNode);
    assert_eq!(sealed.half.services().tx_node(), Some(ME));
    // Of another node, and of one that is not in the plan.
    refused(&[identity(SENSOR, 1)], Contradiction::Node);
    refused(&[identity(STRANGER, 1)], Contradiction::Node);
    assert_eq!(flood(Some(&SEAL), &[identity(SENSOR, 0xB3)]).told, []);
}

/// A node that starts is kept out by whoever uses its id already, or says so; not in a sealed cluster.
#[test]
fn identities_while_it_starts() {
    let starts = |seal| {
        let mut node = Bench::new(Node::new(&config(seal), &CALENDAR, (), at(0)).unwrap());
        for now in 0..1000 {
            node.hear(at(now), NodeIdentity { tx_node: ME, uid: uid(1) }.encode());
        }
        node.half.services().tx_node()
    };
    assert_eq!((starts(None), starts(Some(&SEAL))), (None, Some(ME)));
}

#[test]
fn a_spoofed_hard_real_time_frame() {
    // In the slot of this node, under its name: no protocol can keep it from the wire. The publisher is told.
    let frame = Frame::new(Id::new(Priority::HARD, ME, Etag::HARD_FIRST), Payload::new(&[0, 0]).unwrap());
    for seal in [None, Some(&SEAL)] {
        let mut node = node(seal);
        node.half.announce(&HARD).unwrap();
        let _ = node.poll(at(200));
        assert!(node.hear(at(201), frame).is_empty() || seal.is_none());
        assert_eq!(node.told()[0], (None, ExceptionKind::DuplicateTxNode));
    }
    // Under another name it belongs to no slot, and is nobody's.
    let frame = Frame::new(Id::new(Priority::HARD, STRANGER, Etag::HARD_FIRST), frame.payload);
    for seal in [None, Some(&SEAL)] {
        let mut node = node(seal);
        let subscription = node.half.subscribe(&HARD, Filter::ALL, Policy::Latest).unwrap();
        let _ = node.poll(at(200));
        let _ = node.hear(at(201), frame);
        assert_eq!((node.half.next(&subscription), node.half.foreign_frames()), (None, 1));
    }
}

#[test]
fn a_false_event_of_a_soft_channel() {
    let event = |from| {
        let id = Id::new(Priority::new(20), from, HEAT_ETAG);
        Frame::new(id, Payload::new(&[0, 7]).unwrap())
    };
    let received = |seal, from| {
        let mut node = Bench::new(Node::new(&config(seal), &CALENDAR, (), at(0)).unwrap());
        let subscription = node.half.subscribe(&HEAT, Filter::ALL, Policy::Latest).unwrap();
        let _ = node.hear(at(1), event(from));
        let got = node.half.next(&subscription).map(|event| event.content);
        (got, node.told(), node.half.channel_counters(HEAT.subject()).unwrap().unplanned)
    };
    assert_eq!(received(None, STRANGER), (Some(7), vec![], 0));
    let told = vec![(Some(HEAT.subject()), ExceptionKind::UnplannedPublisher)];
    assert_eq!(received(Some(&SEAL), STRANGER), (None, told, 1));
    assert_eq!(received(Some(&SEAL), SENSOR), (Some(7), vec![], 0));
}

#[test]
fn a_false_leaving_and_withdrawn_interest() {
    let interest = |lease| {
        let (etag, side, class) = (HEAT_ETAG, Side::Publisher, Class::Soft);
        Interest { tx_node: SENSOR, etag, side, class, layout: LayoutHash::UNSTATED, lease }.encode()
    };
    let status = |state| NodeStatus::first(SENSOR, state).encode();
    let knows = |seal| {
        let mut node = node(seal);
        for frame in [status(NodeState::Operational), interest(Lease::MAX)] {
            let _ = node.hear(at(200), frame);
        }
        let _ = node.hear(at(201), status(NodeState::Leaving));
        let _ = node.hear(at(202), interest(Lease::WITHDRAWN));
        let services = node.half.services();
        let publishers = services.interests().nodes(HEAT_ETAG, Side::Publisher).count();
        let ignored = services.refusals().map_or(0, |refusals| refusals.ignored);
        (services.members().status_of(SENSOR).is_some(), publishers, ignored, node.told())
    };
    assert_eq!(knows(None), (false, 0, 0, vec![]));
    assert_eq!(knows(Some(&SEAL)), (true, 1, 2, vec![]));
    // The node in whose name it is said hears it.
    refused(&[NodeStatus::first(ME, NodeState::Leaving).encode()], Contradiction::OwnTxNode);
    // A sealed node that is really gone is missed when it is silent.
    let mut node = node(Some(&SEAL));
    let _ = node.hear(at(200), status(NodeState::Operational));
    let _ = node.poll(at(200 + 1750));
    assert!(node.half.services().members().status_of(SENSOR).is_none());
}

#[test]
fn false_interest() {
    let interest = |tx_node, etag, side| {
        let (class, layout) = (Class::Soft, LayoutHash::UNSTATED);
        Interest { tx_node, etag, side, class, layout, lease: Lease::MAX }.encode()
    };
    refused(&[interest(MASTER, HEAT_ETAG, Side::Publisher)], Contradiction::Publisher);
    refused(&[interest(STRANGER, HEAT_ETAG, Side::Subscriber)], Contradiction::Node);
    refused(&[interest(SENSOR, Etag::BOUND_FIRST, Side::Subscriber)], Contradiction::Binding);
    assert_eq!(flood(Some(&SEAL), &[interest(MASTER, HEAT_ETAG, Side::Subscriber)]).told, []);
}

#[test]
fn floods_of_probes() {
    let probe = |tx_node| Probe { tx_node }.encode();
    let open = flood(None, &[probe(STRANGER)]);
    // Identity, a binding in two halves, and interest: put off, and once for all.
    assert!((4..=12).contains(&open.sent), "{}", open.sent);
    refused(&[probe(STRANGER)], Contradiction::Broker);
    // In the name of the broker they are answered, as seldom as in an open cluster.
    let by_name = flood(Some(&SEAL), &[probe(MASTER)]);
    assert_eq!((by_name.sent, by_name.told), (open.sent, vec![]));
}

#[test]
fn floods_of_get_etag_and_configuration() {
    let get = |requester, subject| GetEtag { requester, subject }.encode();
    refused(&[get(STRANGER, HEAT.subject())], Contradiction::Node);
    refused(&[get(SENSOR, Subject::new(0x77).unwrap())], Contradiction::Binding);
    refused(&[get(SENSOR, Subject::RESERVED)], Contradiction::Broker);
    refused(&[ConfigurationRequest::new(uid(7), Stage::FIRST).encode()], Contradiction::Node);
    refused(&[ConfigurationReply::Restart.encode()], Contradiction::Broker);
    refused(&[Release { tx_node: SENSOR, uid: uid(1) }.encode()], Contradiction::Node);
    // No message at all.
    let id = Id::new(Priority::CONFIGURATION, SENSOR, Etag::NODE_STATUS);
    refused(&[Frame::new(id, Payload::EMPTY)], Contradiction::Node);
}

#[test]
fn contradictions_are_told_once_a_second_each() {
    let mut node = node(Some(&SEAL));
    let mut told = Vec::new();
    for now in (200..2_200).step_by(5) {
        let _ = node.hear(at(now), Probe { tx_node: STRANGER }.encode());
        let _ = node.hear(at(now), NodeIdentity { tx_node: STRANGER, uid: uid(1) }.encode());
        told.extend(node.told());
    }
    let count = |kind| told.iter().filter(|told| told.1 == kind).count();
    assert_eq!((count(ExceptionKind::FalseBroker), count(ExceptionKind::UnplannedNode)), (2, 2));
}

#[test]
fn a_sealed_node_announces_what_its_plan_says() {
    let outside = AnnounceError::OutsidePlan;
    for services in [true, false] {
        let check = |announce: &dyn Fn(&Channel<u16>) -> Result<(), AnnounceError>| {
            assert_eq!(announce(&HARD), Ok(()));
            assert_eq!(announce(&HEAT).unwrap_err(), outside, "it subscribes to it only");
            assert_eq!(announce(&soft(0xC, Etag::BOUND_FIRST)).unwrap_err(), outside);
        };
        if services {
            check(&|channel| node(Some(&SEAL)).half.announce(channel).map(|_| ()));
        } else {
            let service = || <ClockService>::new(SyncConfig::DEFAULT, &CALENDAR, Some(ME), at(0)).unwrap();
            check(&|channel| Bench::new(service().sealed(Some(&SEAL))).half.announce(channel).map(|_| ()));
        }
    }
    let mut sealed = node(Some(&SEAL));
    let error =
        sealed.half.subscribe(&soft(0xC, Etag::BOUND_FIRST), Filter::ALL, Policy::Latest).unwrap_err();
    assert_eq!(error, SubscribeError::Channel(outside));
    let moved = soft(0xB, Etag::BOUND_FIRST);
    let service = <ClockService>::new(SyncConfig::DEFAULT, &CALENDAR, Some(SENSOR), at(0)).unwrap();
    assert_eq!(Bench::new(service.sealed(Some(&SEAL))).half.announce(&moved).unwrap_err(), outside);
    // What was refused has taken no room.
    for _ in 0..8 {
        assert!(sealed.half.announce(&HEAT).is_err());
    }
    sealed.half.announce(&HARD).unwrap();
}

#[test]
fn nobody_announces_the_subject_of_brokers() {
    let channel = soft(u64::MAX, Etag::BOUND_FIRST);
    assert_eq!(node(None).half.announce(&channel).unwrap_err(), AnnounceError::ReservedSubject);
}

#[test]
fn an_image_of_another_plan_keeps_silent_and_says_so() {
    let foreign = NodeConfig { seal: Some(&SEAL), tx_node: Some(ME), ..NodeConfig::new(uid(0xD00D)) };
    let mut node = Bench::new(Node::new(&foreign, &CALENDAR, (), at(0)).unwrap());
    let sent: usize = (0..3_000).map(|now| node.poll(at(now)).len()).sum();
    assert_eq!(sent, 0);
    assert_eq!(node.told(), [(None, ExceptionKind::UnplannedNode)]);
}

#[test]
fn a_node_that_cannot_keep_to_the_seal_is_silent() {
    let services = PlannedServices::<4, 8, 4, 8>::new(&config(Some(&SEAL)), &CALENDAR, (), at(0)).unwrap();
    let mut node = Bench::new(services);
    let sent: usize = (0..3_000).map(|now| node.poll(at(now)).len()).sum();
    assert_eq!(sent, 0);
}
