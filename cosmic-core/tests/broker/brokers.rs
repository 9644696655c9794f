//! The broker alone, frame by frame.

use cosmic_core::Subject;
use cosmic_core::broker::*;
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::protocol::*;
use cosmic_core::time::{Duration, Instant};

use crate::ether::{at, from_candump, subject, tx_node, uid};

const TIMING: BrokerTiming = BrokerTiming::DEFAULT;
const HOST: u8 = 1;

type SmallBroker = Broker<2, 2>;

fn frames(broker: &mut SmallBroker, now: Instant) -> Vec<Frame> {
    let outputs = core::iter::from_fn(|| broker.poll(now));
    let sent = outputs.filter_map(|output| match output {
        Output::Send(frame) => Some(frame),
        Output::Withdraw(_) | Output::Event(_) => None,
    });
    sent.collect()
}

fn probe() -> Frame {
    Probe { tx_node: tx_node(HOST) }.encode()
}

fn question() -> Frame {
    GetEtag { requester: tx_node(HOST), subject: Subject::RESERVED }.encode()
}

fn status(of: u64, id: u8) -> Frame {
    BrokerStatus { tx_node: tx_node(id), uid: uid(of) }.encode()
}

fn listening() -> SmallBroker {
    let mut broker = Broker::new(uid(0xB1), TIMING, Nodes::new(), Subjects::new());
    assert_eq!(
        (broker.role(), broker.poll(at(0)), broker.next_wakeup()),
        (BrokerRole::Off, None, Instant::FAR_FUTURE)
    );
    broker.set_tx_node(at(0), Some(tx_node(HOST)));
    broker
}

/// A broker that becomes active at 302 ms, after it has heard `heard`.
fn active(heard: &[Frame]) -> SmallBroker {
    let mut broker = listening();
    for frame in heard {
        broker.on_frame(frame, at(10));
    }
    let sent: Vec<Frame> = (0..=302).flat_map(|now| frames(&mut broker, at(now))).collect();
    let restart = ConfigurationReply::Restart.encode();
    assert_eq!(
        sent,
        [probe(), question(), probe(), question(), probe(), question(), status(0xB1, HOST), restart]
    );
    assert_eq!(broker.role(), BrokerRole::Active);
    broker
}

fn search(broker: &mut SmallBroker, now: Instant, of: u64) -> Vec<Frame> {
    let stages = (0..16).rev().map(|stage| Stage::new(stage).unwrap());
    stages.for_each(|stage| broker.on_frame(&ConfigurationRequest::new(uid(of), stage).encode(), now));
    frames(broker, now)
}

fn get(broker: &mut SmallBroker, now: Instant, of: u64) -> Vec<Frame> {
    broker.on_frame(&GetEtag { requester: tx_node(9), subject: subject(of) }.encode(), now);
    frames(broker, now)
}

fn supply(sender: TxNode, of: u64, answer: Answer) -> [Frame; 2] {
    SupplyEtag::pair(sender, tx_node(9), subject(of), answer).map(|half| half.encode())
}

const TOP: Etag = Etag::BOUND_LAST;
const BELOW: Etag = Etag::new(0x3FFE).unwrap();

#[test]
fn a_search_and_its_refusal() {
    let mut broker = active(&[]);
    let now = at(310);
    let replies = search(&mut broker, now, 0x77);
    assert_eq!(replies.len(), 16);
    let assigned = ConfigurationReply::Assigned { uid: uid(0x77), tx_node: TxNode::MAX };
    assert_eq!(replies[15], assigned.encode());
    assert_eq!(search(&mut broker, now, 0x77)[15], assigned.encode(), "it keeps its id");
    assert_eq!(search(&mut broker, now, 0x78).len(), 16);
    // Both are seen at work, so no id is left.
    for (of, id) in [(0x77, TxNode::MAX), (0x78, tx_node(0x7D))] {
        broker.on_frame(&NodeIdentity { tx_node: id, uid: uid(of) }.encode(), now);
    }
    assert_eq!(search(&mut broker, now, 0x79)[15], ConfigurationRefusal { uid: uid(0x79) }.encode());
    assert_eq!(broker.counters().no_id_left, 1);
    // Those that do not know a refusal are freed after a pause.
    let mut later = (0..1100).map(|more| at(310 + more));
    let restart = later.find(|now| frames(&mut broker, *now).contains(&ConfigurationReply::Restart.encode()));
    assert_eq!(restart, Some(now + TIMING.silence));
    assert!(broker.release_node(uid(0x77)) && !broker.release_node(uid(0x77)));
    let assigned = ConfigurationReply::Assigned { uid: uid(0x79), tx_node: TxNode::MAX };
    assert_eq!(search(&mut broker, at(1400), 0x79)[15], assigned.encode());
}

#[test]
fn bindings_and_their_refusal() {
    let mut broker = active(&[]);
    let now = at(310);
    assert_eq!(get(&mut broker, now, 1), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
    assert_eq!(get(&mut broker, now, 2), supply(TxNode::BROKER, 2, Answer::Bound(BELOW)));
    assert_eq!(get(&mut broker, now, 1), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
    assert_eq!(get(&mut broker, now, 3), supply(TxNode::BROKER, 3, Answer::Refused));
    assert_eq!(broker.counters().no_etag_left, 1);
}

#[test]
fn names_whose_use_is_heard_are_not_handed_out() {
    let event = Frame::new(Id::new(Priority::new(9), TxNode::MAX, TOP), Payload::EMPTY);
    let mut broker = active(&[event]);
    let reply = ConfigurationReply::decode(&search(&mut broker, at(310), 0x77)[15]);
    assert_eq!(reply, Some(ConfigurationReply::Assigned { uid: uid(0x77), tx_node: tx_node(0x7D) }));
    assert_eq!(get(&mut broker, at(310), 1), supply(TxNode::BROKER, 1, Answer::Bound(BELOW)));
    // An interest is a use, too.
    let (etag, side) = (TOP, Side::Publisher);
    let (layout, lease) = (LayoutHash::UNSTATED, Lease::MIN);
    let interest = Interest { tx_node: tx_node(3), etag, side, class: Class::Soft, layout, lease };
    let mut broker = active(&[interest.encode()]);
    assert_eq!(get(&mut broker, at(310), 1), supply(TxNode::BROKER, 1, Answer::Bound(BELOW)));
}

#[test]
fn a_search_that_nobody_continues_is_given_up() {
    let mut broker = active(&[]);
    broker.on_frame(&ConfigurationRequest::new(uid(7), Stage::FIRST).encode(), at(310));
    let _ = frames(&mut broker, at(310));
    assert!(!frames(&mut broker, at(559)).contains(&ConfigurationReply::Restart.encode()));
    assert!(frames(&mut broker, at(560)).contains(&ConfigurationReply::Restart.encode()));
    assert_eq!(broker.counters().searches_given_up, 1);
}

#[test]
fn more_requests_than_replies_fit_are_counted() {
    let mut broker = active(&[]);
    for _ in 0..20 {
        broker.on_frame(&GetEtag { requester: tx_node(9), subject: subject(1) }.encode(), at(310));
    }
    let sent = frames(&mut broker, at(310)).len();
    assert_eq!(sent % 2, 0, "no half goes alone");
    assert_eq!(usize::from(broker.counters().replies_dropped), 20 - sent / 2);
}

#[test]
fn a_node_that_uses_a_wrong_etag_is_told_the_right_one() {
    let mut broker = active(&[]);
    assert_eq!(get(&mut broker, at(310), 1), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
    let mut claim = |of, etag| {
        supply(tx_node(9), of, Answer::Bound(etag)).iter().for_each(|half| broker.on_frame(half, at(311)));
        frames(&mut broker, at(311))
    };
    assert_eq!(claim(1, TOP), [], "that is right");
    assert_eq!(claim(1, BELOW), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
    assert_eq!(claim(2, TOP), supply(TxNode::BROKER, 2, Answer::Bound(BELOW)), "it belongs to subject 1");
    assert_eq!(claim(2, BELOW), []);
    assert_eq!(broker.counters().contradictions, 2);
}

#[test]
fn the_lower_uid_stays_active() {
    let mut broker = active(&[]);
    let _ = frames(&mut broker, at(400));
    broker.on_frame(&status(0xB2, 2), at(400));
    assert_eq!(frames(&mut broker, at(400)), [status(0xB1, HOST)], "it tells the other at once");
    assert!(frames(&mut broker, at(700)).contains(&probe()), "and compares its table");
    broker.on_frame(&status(0xB0, 3), at(710));
    assert_eq!(broker.role(), BrokerRole::Standby);
    assert_eq!(frames(&mut broker, at(710)), [probe()]);
    assert_eq!(get(&mut broker, at(711), 1), [], "a standby does not answer");
}

#[test]
fn a_standby_waits_the_longer_the_higher_its_id_is() {
    for id in [1, 100] {
        let mut broker = listening();
        broker.set_tx_node(at(0), Some(tx_node(id)));
        broker.on_frame(&status(0xC0, 3), at(5));
        let probes = (5..1000)
            .flat_map(|now| frames(&mut broker, at(now)))
            .filter(|frame| *frame == Probe { tx_node: tx_node(id) }.encode());
        assert_eq!(probes.count(), 3);
        broker.on_frame(&status(0xC0, 3), at(1000));
        let takeover = at(1000) + TIMING.silence + TIMING.rank_step * u32::from(id);
        assert_eq!(broker.next_wakeup(), takeover);
        let _ = frames(&mut broker, takeover.saturating_sub(Duration::from_ticks(1)));
        assert_eq!(broker.role(), BrokerRole::Standby);
        let _ = frames(&mut broker, takeover);
        assert_eq!(broker.role(), BrokerRole::Active);
    }
}

#[test]
fn beside_the_old_broker_only_a_request_without_an_answer_counts() {
    let mut broker = listening();
    let reply = ConfigurationReply::Assigned { uid: uid(5), tx_node: tx_node(0x7D) };
    broker.on_frame(&reply.encode(), at(5));
    assert_eq!(broker.role(), BrokerRole::Standby);
    let _ = frames(&mut broker, at(100_000));
    assert_eq!(broker.role(), BrokerRole::Standby);
    assert_eq!(get(&mut broker, at(100_001), 1), []);
    supply(TxNode::BROKER, 1, Answer::Bound(TOP)).iter().for_each(|half| broker.on_frame(half, at(100_002)));
    let _ = frames(&mut broker, at(200_000));
    assert_eq!(broker.role(), BrokerRole::Standby, "it was answered");
    assert_eq!(get(&mut broker, at(200_001), 2), []);
    let _ = frames(&mut broker, at(201_003));
    assert_eq!(broker.role(), BrokerRole::Active);
    assert_eq!(broker.nodes().uid_of(tx_node(0x7D)), Some(uid(5)));
    assert_eq!(broker.subjects().etag_of(subject(1)), Some(TOP));
}

#[test]
fn a_broker_whose_node_loses_its_id_is_off() {
    let mut broker = active(&[]);
    broker.set_tx_node(at(400), None);
    assert_eq!(get(&mut broker, at(400), 1), []);
    assert_eq!((broker.role(), broker.next_wakeup()), (BrokerRole::Off, Instant::FAR_FUTURE));
}

#[test]
fn zero_is_no_uid() {
    let mut broker = active(&[]);
    for stage in (0..16).rev() {
        let id = 0x7D << 22 | stage << 18 | 1; // nibble 0
        broker.on_frame(&Frame::new(Id::from_raw(id).unwrap(), Payload::EMPTY), at(310));
    }
    assert_eq!(frames(&mut broker, at(310)).last(), Some(&ConfigurationReply::Restart.encode()));
}

fn events(broker: &mut SmallBroker, now: Instant) -> Vec<BrokerEvent> {
    let outputs = core::iter::from_fn(|| broker.poll(now));
    let events = outputs.filter_map(|output| match output {
        Output::Event(event) => Some(event),
        Output::Send(_) | Output::Withdraw(_) => None,
    });
    events.collect()
}

fn hear(broker: &mut SmallBroker, now: Instant, frames: &[&str]) {
    frames.iter().for_each(|frame| broker.on_frame(&from_candump(frame), now));
}

#[test]
fn a_broker_that_sends_nothing_unasked_is_noticed_by_its_answer() {
    let mut broker = listening();
    assert_eq!(frames(&mut broker, at(0)), ["1F404008#", "1F404002#FFFFFFFFFFFFFFFF"].map(from_candump));
    // It has handed out one etag before; this is the next.
    hear(&mut broker, at(1), &["1F5FC004#01003FFEFFFFFFFF", "1F5FC004#01013FFEFFFFFFFF"]);
    assert_eq!(broker.role(), BrokerRole::Standby);
    let used_up = BrokerEvent::EtagsUsedUp { unnamed: 2 };
    assert_eq!(events(&mut broker, at(1)), [BrokerEvent::Became(BrokerRole::Standby), used_up]);
    assert_eq!(events(&mut broker, at(1000)), []);
    assert_eq!(broker.next_wakeup(), at(1001));
    assert_eq!(events(&mut broker, at(1001)), [BrokerEvent::ForeignBroker]);
    assert_eq!(events(&mut broker, at(50_000)), [], "told once");
    // It dies; nobody answers the next request.
    assert_eq!(get(&mut broker, at(50_000), 1), []);
    assert_eq!(events(&mut broker, at(51_002)), [BrokerEvent::Became(BrokerRole::Active)]);
    // All that it had handed out, or may have, is kept for a minute.
    let _ = frames(&mut broker, at(60_000));
    assert_eq!(get(&mut broker, at(60_000), 1), supply(TxNode::BROKER, 1, Answer::Refused));
    let assigned = ConfigurationReply::Assigned { uid: uid(0x77), tx_node: tx_node(0x7D) };
    assert_eq!(search(&mut broker, at(60_000), 0x77).last(), Some(&assigned.encode()));
    assert_eq!(get(&mut broker, at(60_001), 1), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
    assert!(broker.subjects().entries().eq([(subject(1), TOP)]), "the reserved subject has no place");
}

#[test]
fn an_active_broker_answers_the_question_for_brokers_with_its_status() {
    let mut broker = active(&[]);
    let _ = frames(&mut broker, at(400));
    hear(&mut broker, at(400), &["1F408002#FFFFFFFFFFFFFFFF"]);
    assert_eq!(frames(&mut broker, at(400)), [status(0xB1, HOST)]);
    assert_eq!(broker.subjects().entries().count(), 0);
    // A claim of it binds nothing either.
    hear(&mut broker, at(401), &["1F408004#02043FFFFFFFFFFF", "1F408004#02053FFFFFFFFFFF"]);
    assert_eq!((frames(&mut broker, at(401)), broker.subjects().entries().count()), (vec![], 0));
}

#[test]
fn a_foreign_broker_beside_an_active_one_is_told_and_answered_slowly() {
    let mut broker = active(&[]);
    let _ = events(&mut broker, at(400));
    let (mut told, mut sent) = (Vec::new(), Vec::new());
    for now in 400..2400 {
        hear(&mut broker, at(now), &["1F5FC000#0000000000000000"]);
        for output in core::iter::from_fn(|| broker.poll(at(now))) {
            match output {
                Output::Event(event) => told.push((now, event)),
                Output::Send(frame) => sent.push(frame),
                Output::Withdraw(_) => {}
            }
        }
    }
    assert_eq!(told, [(1400, BrokerEvent::ForeignBroker)]);
    assert!(sent.len() <= 2 * 20 && sent.iter().all(|frame| *frame == status(0xB1, HOST)), "{}", sent.len());
    // The status of another broker of this kind is answered no faster.
    let mut answers = 0;
    for now in 2400..3400 {
        broker.on_frame(&status(0xB2, 2), at(now));
        answers += frames(&mut broker, at(now)).len();
    }
    assert!(answers <= 20, "{answers}");
    assert_eq!(events(&mut broker, at(3400)), [], "it has said who it is");
}

#[test]
fn withdrawn_interest_takes_no_etag() {
    let mut broker = active(&[]);
    hear(&mut broker, at(310), &["1F4A8012#3FFF400000000000", "1F4A8012#BFFE400000000000"]);
    assert_eq!(broker.subjects().free(), 2);
    assert_eq!(get(&mut broker, at(310), 1), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
}

#[test]
fn etags_and_ids_whose_use_has_ended_are_handed_out_when_no_other_is_left() {
    let mut broker = active(&[]);
    let _ = events(&mut broker, at(310));
    // Interest for a tenth of a second in one, an event in the other, from the two ids of the table.
    hear(&mut broker, at(310), &["1F5F8012#3FFF400100000000", "021F7FFE#"]);
    let told = [BrokerEvent::IdsUsedUp { unnamed: 2 }, BrokerEvent::EtagsUsedUp { unnamed: 2 }];
    let mut all = events(&mut broker, at(310));
    all.sort_by_key(|event| matches!(event, BrokerEvent::EtagsUsedUp { .. }));
    assert_eq!(all, told);
    let _ = frames(&mut broker, at(311));
    // The interest was an event of its node, too, which counts for a minute.
    assert_eq!(get(&mut broker, at(311), 1), supply(TxNode::BROKER, 1, Answer::Refused));
    assert_eq!(get(&mut broker, at(410), 1), supply(TxNode::BROKER, 1, Answer::Bound(TOP)));
    let _ = frames(&mut broker, at(60_309));
    assert_eq!(get(&mut broker, at(60_309), 2), supply(TxNode::BROKER, 2, Answer::Refused));
    assert_eq!(
        search(&mut broker, at(60_309), 0x77).last(),
        Some(&ConfigurationRefusal { uid: uid(0x77) }.encode())
    );
    assert_eq!(get(&mut broker, at(60_310), 2), supply(TxNode::BROKER, 2, Answer::Bound(BELOW)));
    let assigned = ConfigurationReply::Assigned { uid: uid(0x77), tx_node: TxNode::MAX };
    assert_eq!(search(&mut broker, at(60_310), 0x77).last(), Some(&assigned.encode()));
}

/// The host does not hear itself defend its id, so its broker would give it away again and again.
#[test]
fn the_hosts_own_id_is_never_given_away() {
    let mut broker = listening();
    broker.set_tx_node(at(0), Some(TxNode::MAX));
    for now in 0..700 {
        let _ = frames(&mut broker, at(now));
    }
    assert_eq!(broker.role(), BrokerRole::Active);
    hear(
        &mut broker,
        at(700),
        &[
            "1F5F8007#0000000000000005", // another node states that id,
            "1F480007#00000000000000B1", // or the host's UID with another one,
            "1F5FC007#00000000000000B1", // or with the broker's,
            "1F5F8006#00000000000000B1", // or gives it back,
            "1F5F8000#0000000000000005", // or a broker assigns it,
            "1F480009#00000000000000B1", // or there is a broker of this name
        ],
    );
    assert_eq!(broker.nodes().uid_of(TxNode::MAX), Some(uid(0xB1)));
}

/// Two of one UID by mistake: the one with the lower TxNode stays, and both owners are told. That both go and come
/// back for ever would leave nobody to answer.
#[test]
fn of_two_active_brokers_with_one_uid_one_stays() {
    let mut broker = active(&[]);
    while broker.poll(at(303)).is_some() {}
    broker.on_frame(&status(0xB1, HOST + 1), at(400));
    let told = Output::Event(BrokerEvent::Namesake(tx_node(HOST + 1)));
    assert_eq!((broker.role(), broker.poll(at(400))), (BrokerRole::Active, Some(told)));
    for now in 401..1_000 {
        broker.on_frame(&status(0xB1, HOST + 1), at(now));
        let outputs: Vec<_> = core::iter::from_fn(|| broker.poll(at(now))).collect();
        assert!(!outputs.contains(&told), "told once");
    }
    assert_eq!(broker.role(), BrokerRole::Active);
    broker.on_frame(&status(0xB1, HOST - 1), at(1_000));
    assert_eq!(broker.role(), BrokerRole::Standby);
}

/// 32 at once, and then one every 4 ms: from whomever they come, and even if the clock is set back.
#[test]
fn a_flood_of_get_etag_is_answered_so_many_times_a_second() {
    let flood = |broker: &mut SmallBroker, span: core::ops::Range<u64>| {
        let mut answers = 0;
        for (request, now) in span.flat_map(|now| (0..10).map(move |request| (request, now))) {
            let requester = tx_node(1 + (request % 100) as u8);
            broker.on_frame(&GetEtag { requester, subject: subject(1) }.encode(), at(now));
            let sent = frames(broker, at(now));
            answers += sent.iter().filter(|frame| frame.id.etag() == Etag::SUPPLY_ETAG).count();
        }
        answers
    };
    let mut broker = active(&[]);
    let repeated = 2 * 1000 / 250;
    let answers = flood(&mut broker, 1_000..2_000);
    assert!((2 * 280..=2 * 283 + repeated).contains(&answers), "{answers}");
    assert!(broker.counters().replies_dropped > 9_000);
    // Back at the start, the bucket is empty and fills again.
    let answers = flood(&mut broker, 400..500);
    assert!((2 * 24..=2 * 26 + repeated).contains(&answers), "{answers}");
}
