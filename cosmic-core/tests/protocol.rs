//! Every control message as a literal frame, in both directions; the table of them in the manual; and
//! that no frame at all makes a decoder panic.

use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::protocol::*;
use cosmic_core::time::{Duration, GlobalInstant};
use cosmic_core::{NodeUid, Subject};
use proptest::prelude::*;

const UID: NodeUid = NodeUid::new(0x0123_4567_89AB_CDEF).unwrap();
const SUBJECT: Subject = Subject::new(0x1122_3344_5566_7788).unwrap();
const NODE: TxNode = TxNode::new(0x2A).unwrap();
const ETAG: Etag = Etag::new(0x3FFE).unwrap();

/// One message: what it says in words, its value, and the frame as `candump` and `cansend` write it.
struct Example {
    says: &'static str,
    message: ControlMessage,
    wire: &'static str,
}

fn examples() -> Vec<Example> {
    let mut examples = configuration_examples();
    examples.extend(binding_examples());
    examples.extend(identity_examples());
    examples.extend(membership_examples());
    examples.extend(admission_examples());
    examples
}

fn stage(stage: u8) -> Stage {
    Stage::new(stage).unwrap()
}

fn configuration_examples() -> Vec<Example> {
    let request = |at| ControlMessage::ConfigurationRequest(ConfigurationRequest::new(UID, stage(at)));
    let prefix = |at| {
        ControlMessage::ConfigurationReply(ConfigurationReply::Prefix(Prefix::new(UID.get(), at).unwrap()))
    };
    let assigned = ConfigurationReply::Assigned { uid: UID, tx_node: NODE };
    vec![
        Example {
            says: "Configuration request, stage 15: a UID that begins with 0?",
            message: request(15),
            wire: "1F7C0001#",
        },
        Example {
            says: "Configuration request, stage 14: a UID that goes on with 1?",
            message: request(14),
            wire: "1F784001#",
        },
        Example {
            says: "Configuration request, stage 7: a UID that goes on with 8?",
            message: request(7),
            wire: "1F5E0001#",
        },
        Example {
            says: "Configuration request, stage 0: a UID that ends in F?",
            message: request(0),
            wire: "1F43C001#",
        },
        Example {
            says: "Configuration reply, stage 15: prefix 0",
            message: prefix(stage(15)),
            wire: "1F5FC000#000000000000000F",
        },
        Example {
            says: "Configuration reply, stage 12: prefix 0123",
            message: prefix(stage(12)),
            wire: "1F5FC000#012300000000000C",
        },
        Example {
            says: "Configuration reply, stage 1: prefix 0123456789ABCDE",
            message: prefix(stage(1)),
            wire: "1F5FC000#0123456789ABCDE1",
        },
        Example {
            says: "Configuration reply, the end: UID 0123456789ABCDEF has TxNode 0x2A",
            message: ControlMessage::ConfigurationReply(assigned),
            wire: "1F4A8000#0123456789ABCDEF",
        },
        Example {
            says: "Configuration reply, restart: all begin again",
            message: ControlMessage::ConfigurationReply(ConfigurationReply::Restart),
            wire: "1F5FC000#0000000000000000",
        },
        Example {
            says: "Configuration refusal: no TxNode left for UID 0123456789ABCDEF",
            message: ControlMessage::ConfigurationRefusal(ConfigurationRefusal { uid: UID }),
            wire: "1F5FC005#0123456789ABCDEF",
        },
        Example {
            says: "Release: node 0x2A gives its TxNode back",
            message: ControlMessage::Release(Release { tx_node: NODE, uid: UID }),
            wire: "1F4A8006#0123456789ABCDEF",
        },
    ]
}

fn binding_examples() -> Vec<Example> {
    let pair =
        |sender, answer| SupplyEtag::pair(sender, NODE, SUBJECT, answer).map(ControlMessage::SupplyEtag);
    let [bound_0, bound_1] = pair(TxNode::BROKER, Answer::Bound(ETAG));
    let [refused_0, refused_1] = pair(TxNode::BROKER, Answer::Refused);
    let [claim_0, claim_1] = pair(NODE, Answer::Bound(ETAG));
    vec![
        Example {
            says: "Get etag: node 0x2A asks for subject 1122334455667788",
            message: ControlMessage::GetEtag(GetEtag { requester: NODE, subject: SUBJECT }),
            wire: "1F4A8002#1122334455667788",
        },
        Example {
            says: "Supply etag, first half: the subject has etag 0x3FFE",
            message: bound_0,
            wire: "1F5FC004#2A003FFE11223344",
        },
        Example { says: "Supply etag, second half", message: bound_1, wire: "1F5FC004#2A013FFE55667788" },
        Example {
            says: "Supply etag, refusal, first half: no etag left",
            message: refused_0,
            wire: "1F5FC004#2A02000011223344",
        },
        Example {
            says: "Supply etag, refusal, second half",
            message: refused_1,
            wire: "1F5FC004#2A03000055667788",
        },
        Example {
            says: "Supply etag, claim of node 0x2A, first half",
            message: claim_0,
            wire: "1F4A8004#2A043FFE11223344",
        },
        Example {
            says: "Supply etag, claim of node 0x2A, second half",
            message: claim_1,
            wire: "1F4A8004#2A053FFE55667788",
        },
    ]
}

fn identity_examples() -> Vec<Example> {
    vec![
        Example {
            says: "Node identity: TxNode 0x2A belongs to UID 0123456789ABCDEF",
            message: ControlMessage::NodeIdentity(NodeIdentity { tx_node: NODE, uid: UID }),
            wire: "1F4A8007#0123456789ABCDEF",
        },
        Example {
            says: "Probe: who is there, and what do you use?",
            message: ControlMessage::Probe(Probe { tx_node: NODE }),
            wire: "1F4A8008#",
        },
        Example {
            says: "Broker status: node 0x2A hosts the active broker",
            message: ControlMessage::BrokerStatus(BrokerStatus { tx_node: NODE, uid: UID }),
            wire: "1F4A8009#0123456789ABCDEF",
        },
    ]
}

fn membership_examples() -> Vec<Example> {
    let interest = Interest {
        tx_node: NODE,
        etag: ETAG,
        side: Side::Publisher,
        class: Class::Soft,
        layout: LayoutHash::new(0xDEAD_BEEF),
        lease: Lease::new(Duration::from_secs(3)).unwrap(),
    };
    let ended = Interest {
        side: Side::Subscriber,
        lease: Lease::WITHDRAWN,
        layout: LayoutHash::UNSTATED,
        ..interest
    };
    let hard = Interest {
        etag: Etag::HARD_FIRST,
        side: Side::Subscriber,
        class: Class::Hard,
        lease: Lease::MAX,
        ..interest
    };
    let status = NodeStatus {
        state: NodeState::HardInhibited,
        transmit_errors: 0x80,
        receive_errors: 0x05,
        sequence: 7,
        exceptions: 0x0102,
        uptime: Uptime::new(Duration::from_secs(3600)),
        ..NodeStatus::first(NODE, NodeState::Operational)
    };
    let by_watchdog =
        NodeStatus { reset_cause: ResetCause::Watchdog, ..NodeStatus::first(NODE, NodeState::Operational) };
    vec![
        Example {
            says: "Interest: node 0x2A announces etag 0x3FFE, SRT, for 3.0 s, layout DEADBEEF",
            message: ControlMessage::Interest(interest),
            wire: "1F4A8012#BFFE401EDEADBEEF",
        },
        Example {
            says: "Interest: node 0x2A subscribes to etag 100, HRT, for 1638.3 s, layout DEADBEEF",
            message: ControlMessage::Interest(hard),
            wire: "1F4A8012#00643FFFDEADBEEF",
        },
        Example {
            says: "Interest: node 0x2A withdraws its SRT subscription to etag 0x3FFE",
            message: ControlMessage::Interest(ended),
            wire: "1F4A8012#3FFE400000000000",
        },
        Example {
            says: "Node status: node 0x2A has started",
            message: ControlMessage::NodeStatus(NodeStatus::first(NODE, NodeState::Starting)),
            wire: "1F4A8013#0000000000000000",
        },
        Example {
            says: "Node status: HRT inhibited, TEC 128, REC 5, sequence 7, 258 exceptions, up for an hour",
            message: ControlMessage::NodeStatus(status),
            wire: "1F4A8013#0280050701020E10",
        },
        Example {
            says: "Node status: node 0x2A was reset by its watchdog, and is operational",
            message: ControlMessage::NodeStatus(by_watchdog),
            wire: "1F4A8013#5100000000000000",
        },
    ]
}

fn admission_examples() -> Vec<Example> {
    let ms = |ms| CoarseSpan::floor(Duration::from_millis(ms));
    let number = AskNumber::new(3);
    let request = AdmissionRequest {
        tx_node: NODE,
        etag: ETAG,
        number,
        held: false,
        len: 8,
        interval: ms(10),
        tolerance: CoarseSpan::floor(Duration::from_micros(500)),
        deadline: ms(5),
    };
    let reply = |verdict| {
        ControlMessage::AdmissionReply(AdmissionReply { requester: NODE, etag: ETAG, number, verdict })
    };
    let refused = |reason, fits_at, suffers| {
        reply(AdmissionVerdict::Refused(AdmissionRefusal { reason, fits_at, suffers }))
    };
    vec![
        Example {
            says: "Admission request 3: etag 0x3FFE, 8 bytes every 10 ms, 0.5 ms jitter, deadline 5 ms?",
            message: ControlMessage::AdmissionRequest(request),
            wire: "1F4A8014#38FFF8A7107D0871",
        },
        Example {
            says: "Admission request 3 again: it was admitted, and is published",
            message: ControlMessage::AdmissionRequest(AdmissionRequest { held: true, ..request }),
            wire: "1F4A8014#B8FFF8A7107D0871",
        },
        Example {
            says: "Admission reply to it: admitted, for 10.0 s",
            message: reply(AdmissionVerdict::Admitted(Lease::new(Duration::from_secs(10)).unwrap())),
            wire: "1F5FC015#2A033FFE00640000",
        },
        Example {
            says: "Admission reply: refused, the bus is full; every 20 ms would do",
            message: refused(RefusalReason::Utilisation, Some(ms(20)), None),
            wire: "1F5FC015#2A133FFE0C710000",
        },
        Example {
            says: "Admission reply: refused, etag 0x0400 would be late",
            message: refused(RefusalReason::OtherLate, None, Some(Etag::BOUND_FIRST)),
            wire: "1F5FC015#2A433FFE00000400",
        },
        Example {
            says: "Admission reply: refused, the table is full",
            message: refused(RefusalReason::Full, None, None),
            wire: "1F5FC015#2A633FFE00000000",
        },
    ]
}

/// Clock synchronisation has its own tests; here it is for the table.
fn sync_examples() -> [(&'static str, Frame); 2] {
    let sync = SyncMessage {
        sequence: SyncSequence::new(9),
        rank: Rank::FIRST,
        predecessor: NODE,
        accuracy: Duration::from_ticks(0),
        calendar_digest: 0xDEAD_BEEF,
    };
    let sent_at = GlobalInstant::from_epoch(Duration::from_secs(1));
    let follow_up = FollowUp { sequence: sync.sequence, sent_at };
    [
        ("Sync: number 9 of the first master, calendar DEADBEEF", sync.encode(NODE)),
        ("Follow-up: sync number 9 was sent at 1.000000000 s", follow_up.encode(NODE)),
    ]
}

fn as_candump(frame: &Frame) -> String {
    let data: String = frame.payload.as_slice().iter().map(|byte| format!("{byte:02X}")).collect();
    format!("{:08X}#{data}", frame.id.raw())
}

fn from_candump(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let bytes: Vec<u8> =
        (0..data.len() / 2).map(|at| u8::from_str_radix(&data[2 * at..][..2], 16).unwrap()).collect();
    Frame::new(Id::from_raw(u32::from_str_radix(id, 16).unwrap()).unwrap(), Payload::new(&bytes).unwrap())
}

#[test]
fn literal_frames() {
    for Example { says, message, wire } in examples() {
        assert_eq!(as_candump(&message.encode()), wire, "encode: {says}");
        assert_eq!(ControlMessage::decode(&from_candump(wire)), Some(message), "decode: {says}");
    }
}

#[test]
fn literal_frames_that_are_no_messages() {
    for (why, wire) in [
        ("a request has no data", "1F7C0001#00"),
        ("0x7C is not the priority of configuration", "1F3C0001#"),
        ("stage 0 has no prefix", "1F5FC000#0123456789ABCD00"),
        ("nibbles behind the stage are zero", "1F5FC000#012340000000000C"),
        ("a UID is not zero", "1F4A8000#0000000000000000"),
        ("a short reply", "1F5FC000#00000000000000"),
        ("only the broker refuses", "1F4A8005#0123456789ABCDEF"),
        ("a subject is not zero", "1F4A8002#0000000000000000"),
        ("the broker claims nothing", "1F5FC004#2A043FFE11223344"),
        ("there are six codes", "1F5FC004#2A063FFE11223344"),
        ("only the broker binds", "1F4A8004#2A003FFE11223344"),
        ("only the broker refuses a subject", "1F4A8004#2A02000011223344"),
        ("an etag has 14 bits", "1F5FC004#2A00FFFE11223344"),
        ("a TxNode has 7 bits", "1F5FC004#AA003FFE11223344"),
        ("a probe has no data", "1F4A8008#00"),
        ("bit 14 of an interest is zero", "1F4A8012#7FFE401EDEADBEEF"),
        ("there are three classes", "1F4A8012#BFFEC01EDEADBEEF"),
        ("there are four states", "1F4A8013#0480050701020E10"),
        ("only a node asks for admission", "1F5FC014#38FFF8A7107D0871"),
        ("an event has eight bytes at most", "1F4A8014#39FFF8A7107D0871"),
        ("an interval of zero", "1F4A8014#38FFF800007D0871"),
        ("a deadline of zero", "1F4A8014#38FFF8A7107D0000"),
        ("a hard real-time channel is planned", "1F4A8014#380190A7107D0871"),
        ("only the broker admits", "1F4A8015#2A033FFE00640000"),
        ("nobody is admitted for no time", "1F5FC015#2A033FFE00000000"),
        ("nobody suffers from what is admitted", "1F5FC015#2A033FFE00640400"),
        ("there are seven verdicts", "1F5FC015#2A733FFE00000000"),
        ("bit 3 of a verdict is zero", "1F5FC015#2A0B3FFE00640000"),
        ("the broker asks nobody", "1F5FC015#7F033FFE00640000"),
        ("no message has etag 3", "1F5FC003#2A003FFE11223344"),
        ("an event is no message", "03EA8400#0102"),
    ] {
        assert_eq!(ControlMessage::decode(&from_candump(wire)), None, "{why}");
    }
}

/// The old broker answers with the request's own identifier, in which it overwrites all fields but
/// bit 21: that still holds the top bit of the stage.
#[test]
fn bit_21_of_the_old_brokers_replies_is_ignored() {
    let reply = ControlMessage::decode(&from_candump("1F7FC000#000000000000000F"));
    let prefix = Prefix::new(0, Stage::FIRST).unwrap();
    assert_eq!(reply, Some(ControlMessage::ConfigurationReply(ConfigurationReply::Prefix(prefix))));
}

/// What the old client makes of the messages that are new, told in its own terms (FAMOUSO, CAN
/// configuration and etag binding clients): it looks at replies with etags 0 and 4 only, and for a
/// binding at the halves whose number times four, in eight bits, is 0 or 4.
#[test]
fn old_clients_ignore_what_is_new() {
    for Example { says, message, .. } in examples() {
        let frame = message.encode();
        match message {
            ControlMessage::ConfigurationReply(_)
            | ControlMessage::ConfigurationRequest(_)
            | ControlMessage::GetEtag(_) => {}
            ControlMessage::SupplyEtag(supply)
                if !supply.is_claim() && supply.answer() != Answer::Refused => {}
            ControlMessage::SupplyEtag(_) => {
                let index = frame.payload.padded()[1].wrapping_shl(2);
                assert!(index != 0 && index != 4, "{says}");
            }
            _ => assert!(![0, 1, 2, 4].contains(&frame.id.etag().get()), "{says}"),
        }
    }
}

/// Compares the table in the manual with the code; `UPDATE_DOCS=1` writes it instead.
#[test]
fn the_manual_has_the_table() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/protocol.md");
    let mut table = String::from("\n| message | frame |\n|---|---|\n");
    let rows = examples().into_iter().map(|Example { says, message, .. }| (says, message.encode()));
    for (says, frame) in rows.chain(sync_examples()) {
        table += &format!("| {says} | `{}` |\n", as_candump(&frame));
    }
    let manual = std::fs::read_to_string(path).unwrap();
    let (head, rest) =
        manual.split_once(TABLE_BEGINS).expect("docs/protocol.md: no marker where the table begins");
    let (old, tail) = rest.split_once(TABLE_ENDS).expect("docs/protocol.md: no marker where the table ends");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(path, format!("{head}{TABLE_BEGINS}{table}{TABLE_ENDS}{tail}")).unwrap();
    } else {
        assert_eq!(old, table, "docs/protocol.md is out of date; run this test with UPDATE_DOCS=1");
    }
}

const TABLE_BEGINS: &str = "<!-- table of messages, written by cosmic-core/tests/protocol.rs: begin -->";
const TABLE_ENDS: &str = "<!-- table of messages: end -->";

fn any_frame() -> impl Strategy<Value = Frame> {
    // Half of the frames are near a message: control priority, reserved etag.
    let id = prop_oneof![
        (0..1u32 << 29).prop_map(|raw| Id::from_raw(raw).unwrap()),
        (250..=251u8, 0..=127u8, 0..=22u16).prop_map(|(priority, node, etag)| Id::new(
            Priority::new(priority),
            TxNode::new(node).unwrap(),
            Etag::new(etag).unwrap()
        )),
    ];
    let payload =
        prop_oneof![proptest::collection::vec(any::<u8>(), 0..=8), proptest::collection::vec(0..=3u8, 8),];
    (id, payload).prop_map(|(id, payload)| Frame::new(id, Payload::new(&payload).unwrap()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    /// Any frame is decoded without a panic, and what was decoded survives the way to the wire and back.
    #[test]
    fn decoded_messages_round_trip(frame in any_frame()) {
        if let Some(message) = ControlMessage::decode(&frame) {
            prop_assert_eq!(ControlMessage::decode(&message.encode()), Some(message));
        }
    }

    #[test]
    fn interests_round_trip(
        node in 0..=127u8, etag in 0..=0x3FFFu16, publisher: bool, class in 0..3usize, hash: u32,
        lease in proptest::option::of(1..=16_383u64),
    ) {
        let interest = Interest {
            tx_node: TxNode::new(node).unwrap(),
            etag: Etag::new(etag).unwrap(),
            side: if publisher { Side::Publisher } else { Side::Subscriber },
            class: [Class::Hard, Class::Soft, Class::NonRealTime][class],
            layout: LayoutHash::new(hash),
            lease: lease.map_or(Lease::WITHDRAWN, |steps| Lease::new(Duration::from_millis(100 * steps)).unwrap()),
        };
        prop_assert_eq!(Interest::decode(&interest.encode()), Some(interest));
    }

    #[test]
    fn admission_round_trips(
        node in 0..=126u8, etag in 1024..=0x3FFFu16, number in 0..=7u8, held: bool, len in 0..=8u8,
        interval in 1..1u64 << 40, tolerance in 0..1u64 << 40, deadline in 1..1u64 << 40,
        refusal in proptest::option::of((0..6usize, any::<bool>(), any::<bool>())), lease in 1..=16_383u64,
    ) {
        let [interval, tolerance, deadline] =
            [interval, tolerance, deadline].map(|us| CoarseSpan::floor(Duration::from_micros(us)));
        let (tx_node, etag) = (TxNode::new(node).unwrap(), Etag::new(etag).unwrap());
        let number = AskNumber::new(number);
        let request = AdmissionRequest { tx_node, etag, number, held, len, interval, tolerance, deadline };
        prop_assert_eq!(AdmissionRequest::decode(&request.encode()), Some(request));
        const REASONS: [RefusalReason; 6] = [
            RefusalReason::Utilisation, RefusalReason::Blocking, RefusalReason::Late, RefusalReason::OtherLate,
            RefusalReason::LessUrgentLate, RefusalReason::Full,
        ];
        let verdict = match refusal {
            Some((reason, fits, suffers)) => AdmissionVerdict::Refused(AdmissionRefusal {
                reason: REASONS[reason],
                fits_at: fits.then_some(interval),
                suffers: suffers.then_some(etag),
            }),
            None => AdmissionVerdict::Admitted(Lease::new(Duration::from_millis(100 * lease)).unwrap()),
        };
        let reply = AdmissionReply { requester: tx_node, etag, number, verdict };
        prop_assert_eq!(AdmissionReply::decode(&reply.encode()), Some(reply));
    }

    #[test]
    fn configuration_round_trips(uid in 1..=u64::MAX, at in 0..=15u8, node in 0..=126u8) {
        let uid = NodeUid::new(uid).unwrap();
        let request = ConfigurationRequest::new(uid, stage(at));
        prop_assert_eq!(ConfigurationRequest::decode(&request.encode()), Some(request));
        let reply = match Prefix::new(uid.get(), stage(at)) {
            Some(prefix) => ConfigurationReply::Prefix(prefix),
            None => ConfigurationReply::Assigned { uid, tx_node: TxNode::new(node).unwrap() },
        };
        prop_assert_eq!(ConfigurationReply::decode(&reply.encode()), Some(reply));
    }

    #[test]
    fn bindings_round_trip(subject in 1..=u64::MAX, node in 0..=127u8, etag in 0..=0x3FFFu16, refused: bool) {
        let (subject, node) = (Subject::new(subject).unwrap(), TxNode::new(node).unwrap());
        let answer = if refused { Answer::Refused } else { Answer::Bound(Etag::new(etag).unwrap()) };
        let halves = SupplyEtag::pair(TxNode::BROKER, node, subject, answer);
        let claim = SupplyEtag::pair(node, node, subject, answer);
        prop_assert_eq!(claim.map(|half| SupplyEtag::decode(&half.encode()).unwrap()), claim);
        let received = halves.map(|half| SupplyEtag::decode(&half.encode()).unwrap());
        prop_assert_eq!(received, halves);
        prop_assert_eq!(received[0].joined(&received[1]), Some(subject));
        let request = GetEtag { requester: node, subject };
        prop_assert_eq!(GetEtag::decode(&request.encode()), Some(request));
    }
}
