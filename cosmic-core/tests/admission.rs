//! Admission frame by frame: the client of a node that asks, and control at the broker's node, each alone and then both on
//! an ether that loses frames.

use cosmic_core::admission::{AdmissionControl, AdmissionTiming, Offer, Reservations};
use cosmic_core::broker::{BrokerEvent, BrokerRole};
use cosmic_core::can::{BitRate, Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::client::{AdmissionClient, AdmissionEvent, AdmissionState, CannotAsk};
use cosmic_core::event_layer::EventRate;
use cosmic_core::protocol::*;
use cosmic_core::time::{Duration, Instant};
use cosmic_core::{NodeUid, Subject};
use proptest::prelude::*;

const ME: TxNode = TxNode::new(0x2A).unwrap();
const SUBJECT: Subject = Subject::new(0x1122_3344_5566_7788).unwrap();
const ETAG: Etag = Etag::new(0x3FFE).unwrap();
const TIMING: AdmissionTiming = AdmissionTiming::DEFAULT;

static FREE: Reservations<'static> =
    Reservations::nothing(BitRate::MAX, Duration::from_micros(160), Duration::from_micros(5));

fn at(milliseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_millis(milliseconds))
}

fn frame(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let bytes: Vec<u8> =
        (0..data.len() / 2).map(|at| u8::from_str_radix(&data[2 * at..][..2], 16).unwrap()).collect();
    Frame::new(Id::from_raw(u32::from_str_radix(id, 16).unwrap()).unwrap(), Payload::new(&bytes).unwrap())
}

fn text(frame: &Frame) -> String {
    frame.to_string()
}

fn offer(interval_ms: u64, deadline_ms: u64) -> Offer {
    let rate = EventRate::periodic(Duration::from_millis(interval_ms));
    Offer {
        rate: Some(rate.with_jitter(Duration::from_micros(500))),
        deadline: Duration::from_millis(deadline_ms),
        len: 8,
    }
}

type Client = AdmissionClient<4>;
type Control = AdmissionControl<4>;

/// What a client does now: frames as text, and events.
fn done(client: &mut Client, now: Instant) -> (Vec<String>, Vec<AdmissionEvent>) {
    let (mut frames, mut events) = (Vec::new(), Vec::new());
    while let Some(output) = client.poll(now) {
        match output {
            Output::Send(frame) => frames.push(text(&frame)),
            Output::Event(event) => events.push(event),
            Output::Withdraw(_) => panic!("it withdraws nothing"),
        }
    }
    assert!(client.next_wakeup() > now, "nothing is left to do");
    (frames, events)
}

/// One channel, asked for at 1 ms as number 4.
fn asking() -> Client {
    let mut client = Client::new(2, &TIMING);
    client.set_tx_node(at(0), Some(ME));
    client.announce(at(0), SUBJECT, &offer(10, 5)).unwrap();
    assert_eq!(done(&mut client, at(0)), (vec![], vec![]), "it has no etag yet");
    client.bind(at(1), SUBJECT, Some(ETAG));
    assert_eq!(done(&mut client, at(1)), (vec!["1F4A8014#38FFF8A7107D0871".to_owned()], vec![]));
    client
}

const ADMITTED: &str = "1F5FC015#2A033FFE00640000";
const BUSY: &str = "1F5FC015#2A133FFE0C710000";

#[test]
fn a_channel_is_asked_for_held_and_renewed_with_literal_frames() {
    let mut client = asking();
    assert_eq!(client.state(SUBJECT), Some(AdmissionState::Waiting));
    // Answers to another node, about another channel, to another question.
    for other in ["1F5FC015#2B033FFE00640000", "1F5FC015#2A033FFD00640000", "1F5FC015#2A023FFE00640000"] {
        client.on_frame(&frame(other), at(2));
    }
    assert_eq!(done(&mut client, at(2)), (vec![], vec![]));
    client.on_frame(&frame(ADMITTED), at(3));
    assert_eq!(done(&mut client, at(3)), (vec![], vec![AdmissionEvent::Admitted(SUBJECT)]));
    // The lease counts from the question.
    assert_eq!(client.state(SUBJECT), Some(AdmissionState::Admitted(at(10_001))));
    let third = Instant::from_epoch(Duration::from_ticks(1_000_000 + 10_000_000_000 / 3));
    assert_eq!(client.next_wakeup(), third);
    assert_eq!(done(&mut client, third).0, ["1F4A8014#B8FFF8A7107D0871"], "it is held");
    client.on_frame(&frame(ADMITTED), third);
    assert_eq!(done(&mut client, third), (vec![], vec![]));
    assert!(matches!(client.state(SUBJECT), Some(AdmissionState::Admitted(until)) if until > at(13_000)));
}

#[test]
fn a_question_is_repeated_until_it_is_answered_and_more_seldom_each_time() {
    let mut client = asking();
    let mut asked = Vec::new();
    for now in 2..20_000 {
        asked.extend(done(&mut client, at(now)).0.iter().map(|_| now));
    }
    assert_eq!(asked[0], 101);
    assert!((8..=20).contains(&asked.len()), "{asked:?}");
    // The answer to the first of them is as good as any.
    client.on_frame(&frame(ADMITTED), at(20_000));
    // But its lease is over.
    assert_eq!(done(&mut client, at(20_000)).1, []);
}

#[test]
fn a_refusal_is_told_once_and_the_question_comes_again_later_under_another_number() {
    let mut client = asking();
    client.on_frame(&frame(BUSY), at(5));
    let refusal = AdmissionRefusal {
        reason: RefusalReason::Utilisation,
        fits_at: Some(CoarseSpan::floor(Duration::from_millis(20))),
        suffers: None,
    };
    assert_eq!(done(&mut client, at(5)).1, [AdmissionEvent::Refused(SUBJECT, refusal)]);
    assert_eq!(client.state(SUBJECT), Some(AdmissionState::Refused(refusal)));
    // An answer that was under way to the old question admits nothing.
    client.on_frame(&frame(ADMITTED), at(6));
    assert_eq!(done(&mut client, at(6)), (vec![], vec![]));
    let again = client.next_wakeup();
    assert!(again > at(4_000) && again < at(16_000));
    assert_eq!(done(&mut client, again).0, ["1F4A8014#48FFF8A7107D0871"]);
    client.on_frame(&frame("1F5FC015#2A143FFE0C710000"), again);
    assert_eq!(done(&mut client, again), (vec![], vec![]), "the same refusal");
}

#[test]
fn a_new_broker_is_told_what_is_held_and_a_silent_one_ends_it() {
    let status = |uid: u64, tx_node| {
        let (tx_node, uid) = (TxNode::new(tx_node).unwrap(), NodeUid::new(uid).unwrap());
        BrokerStatus { tx_node, uid }.encode()
    };
    let mut client = asking();
    // The first broker that is heard: the question may have been lost before.
    client.on_frame(&status(1, 1), at(2));
    for now in 2..40 {
        let _ = done(&mut client, at(now));
    }
    client.on_frame(&frame(ADMITTED), at(40));
    assert_eq!(done(&mut client, at(40)).1, [AdmissionEvent::Admitted(SUBJECT)]);
    // The same one goes on: nothing to be said.
    client.on_frame(&status(1, 1), at(250));
    assert_eq!(done(&mut client, at(300)).0, Vec::<String>::new());
    // Another one: within 20 ms it is told.
    client.on_frame(&status(2, 2), at(400));
    assert_eq!(done(&mut client, at(420)).0, ["1F4A8014#B8FFF8A7107D0871"]);
    // It answers nothing, and is alive: the channel ends before it answers others, whatever lease the first one gave.
    let mut events = Vec::new();
    for now in 421..11_000 {
        if now % 250 == 0 {
            client.on_frame(&status(2, 2), at(now));
        }
        events.extend(done(&mut client, at(now)).1.into_iter().map(|event| (now, event)));
    }
    let (lapsed_at, event) = events[0];
    assert_eq!((events.len(), event), (1, AdmissionEvent::Lapsed(SUBJECT)));
    assert_eq!(at(lapsed_at), at(400) + TIMING.claim);
    assert!(TIMING.claim < TIMING.settle);
}

#[test]
fn with_no_broker_what_is_held_goes_on_unless_events_are_late() {
    let mut client = asking();
    client.on_frame(&frame(ADMITTED), at(3));
    for now in 3..60_000 {
        assert_eq!(done(&mut client, at(now)).1.len(), usize::from(now == 3));
    }
    assert!(client.on_late(at(60_000), SUBJECT));
    assert_eq!(done(&mut client, at(60_000)).1, [AdmissionEvent::Lapsed(SUBJECT)]);
    // One that was just confirmed is late for another reason.
    let mut client = asking();
    client.on_frame(&frame(ADMITTED), at(3));
    let _ = done(&mut client, at(3));
    assert!(!client.on_late(at(10), SUBJECT));
}

#[test]
fn another_short_name_is_another_question() {
    let mut client = asking();
    client.on_frame(&frame(ADMITTED), at(3));
    let _ = done(&mut client, at(3));
    client.bind(at(4), SUBJECT, Etag::new(0x3FFD));
    let (frames, events) = done(&mut client, at(4));
    assert_eq!(
        (frames[0].as_str(), &events[..]),
        ("1F4A8014#48FFF4A7107D0871", &[AdmissionEvent::Lapsed(SUBJECT)][..])
    );
    client.set_tx_node(at(5), TxNode::new(7));
    assert_eq!(done(&mut client, at(5)).0, ["1F41C014#58FFF4A7107D0871"]);
    client.forget(SUBJECT);
    assert_eq!((client.state(SUBJECT), client.next_wakeup()), (None, Instant::FAR_FUTURE));
}

#[test]
fn what_cannot_be_asked_for() {
    let mut client = Client::new(0, &TIMING);
    let of = |rate: Option<EventRate>, deadline, len| Offer { rate, deadline, len };
    let rate = EventRate::sporadic(Duration::from_millis(1));
    let long = rate.with_jitter(Duration::from_secs(3600 * 24 * 20));
    let short = EventRate::sporadic(Duration::from_ticks(999));
    let deadline = Duration::from_millis(1);
    for (offer, why) in [
        (of(None, deadline, 8), CannotAsk::NoRate),
        (of(Some(long), deadline, 8), CannotAsk::OutOfRange),
        (of(Some(short), deadline, 8), CannotAsk::OutOfRange),
        (of(Some(rate), Duration::from_ticks(1), 8), CannotAsk::OutOfRange),
        (of(Some(rate), deadline, 9), CannotAsk::OutOfRange),
    ] {
        assert_eq!(client.announce(at(0), SUBJECT, &offer), Err(why));
        assert_eq!(Client::can_ask(&offer), Err(why));
    }
    for number in 1..=4 {
        client.announce(at(0), Subject::new(number).unwrap(), &offer(10, 5)).unwrap();
    }
    assert_eq!(client.announce(at(0), SUBJECT, &offer(10, 5)), Err(CannotAsk::Full));
}

/// What control does from now on for so long, polled as it asks for: frames with their instants in ms, and events.
fn answers(control: &mut Control, from: u64, milliseconds: u64) -> (Vec<(u64, String)>, Vec<BrokerEvent>) {
    let (mut frames, mut events) = (Vec::new(), Vec::new());
    for now in from..from + milliseconds {
        while let Some(output) = control.poll(at(now), |_| None) {
            match output {
                Output::Send(frame) => frames.push((now, text(&frame))),
                Output::Event(event) => events.push(event),
                Output::Withdraw(_) => panic!("it withdraws nothing"),
            }
        }
        assert!(control.next_wakeup() > at(now), "nothing is left to do");
    }
    (frames, events)
}

/// Control of a broker that has been active for long.
fn settled() -> Control {
    let mut control = Control::new(&FREE, TIMING);
    control.set_role(at(0), BrokerRole::Listening);
    control.set_role(at(300), BrokerRole::Active);
    assert_eq!(answers(&mut control, 300, 2_000), (vec![], vec![]));
    control
}

#[test]
fn literal_questions_get_literal_answers() {
    let mut control = settled();
    control.on_frame(&frame("1F4A8014#38FFF8A7107D0871"));
    let (frames, events) = answers(&mut control, 2_300, 20);
    assert_eq!(frames, [(2_300, ADMITTED.to_owned())]);
    assert_eq!(events, [BrokerEvent::Admitted { tx_node: ME, etag: ETAG }]);
    // Renewed, without an event; and given up, by an interest that ends.
    control.on_frame(&frame("1F4A8014#B8FFF8A7107D0871"));
    assert_eq!(answers(&mut control, 2_400, 20), (vec![(2_400, ADMITTED.to_owned())], vec![]));
    assert_eq!(control.table().admitted().count(), 1);
    control.on_frame(&frame("1F4A8012#BFFE400000000000"));
    assert_eq!(control.table().admitted().count(), 0);
    // A frame every 16 us.
    control.on_frame(&frame("1F4A8014#38FFF801007D0871"));
    let (frames, events) = answers(&mut control, 2_500, 100);
    assert_eq!(frames.len(), 1);
    let reply = AdmissionReply::decode(&frame(&frames[0].1)).unwrap();
    let AdmissionVerdict::Refused(refusal) = reply.verdict else { panic!("{reply:?}") };
    assert_eq!(refusal.reason, RefusalReason::Utilisation);
    assert!(matches!(events[..], [BrokerEvent::NotAdmitted { .. }]));
    assert_eq!((control.counters().admitted, control.counters().refused), (1, 1));
}

#[test]
fn a_new_broker_hears_what_is_held_before_it_answers_others() {
    let mut control = Control::new(&FREE, TIMING);
    let held = frame("1F4A8014#B8FFF8A7107D0871");
    let new = frame("1F41C014#38FFF4A7107D0871");
    control.on_frame(&held);
    control.set_role(at(0), BrokerRole::Listening);
    assert_eq!(control.table().admitted().count(), 0, "it was off");
    control.on_frame(&held);
    control.on_frame(&new);
    // While it listens it learns, and says nothing.
    let (frames, events) = answers(&mut control, 0, 300);
    assert_eq!((frames, events.len(), control.table().admitted().count()), (vec![], 1, 1));
    control.set_role(at(300), BrokerRole::Active);
    control.on_frame(&held);
    let (frames, _) = answers(&mut control, 300, 3_000);
    // The one that is held at once, the new one when the time has passed in which others tell.
    assert_eq!(frames, [(300, ADMITTED.to_owned()), (1_800, "1F5FC015#07033FFD00640000".to_owned())]);
    // It listens again: all that tell at once what they hold are taken at once.
    control.set_role(at(3_900), BrokerRole::Listening);
    for renewal in [held, frame("1F41C014#B8FFF4A7107D0871")] {
        control.on_frame(&renewal);
    }
    assert_eq!(answers(&mut control, 3_900, 1), (vec![], vec![]));
    // It stands by, and forgets.
    control.set_role(at(4_000), BrokerRole::Standby);
    assert_eq!((control.table().admitted().count(), control.next_wakeup()), (0, Instant::FAR_FUTURE));
}

#[test]
fn a_lease_ends_and_so_do_all_of_a_node_that_leaves() {
    let mut control = settled();
    for question in ["1F4A8014#38FFF8A7107D0871", "1F41C014#38FFF4A7107D0871"] {
        control.on_frame(&frame(question));
    }
    let _ = answers(&mut control, 2_300, 50);
    assert_eq!(control.table().admitted().count(), 2);
    // "Leaving".
    control.on_frame(&frame("1F41C013#0300000100000000"));
    assert_eq!(control.table().admitted().count(), 1);
    let ends = control.next_wakeup();
    assert_eq!(ends, at(2_300) + TIMING.lease.duration() + TIMING.grace);
    assert_eq!(control.poll(ends, |_| None), None);
    assert_eq!(control.table().admitted().count(), 0);
}

#[test]
fn a_flood_is_answered_within_bounds_and_each_node_has_one_place() {
    let mut control = settled();
    let mut frames = Vec::new();
    for now in 3_000..4_000 {
        for node in 0..40 {
            let request = AdmissionRequest {
                tx_node: TxNode::new(node).unwrap(),
                etag: Etag::new(2_000 + (now % 500) as u16).unwrap(),
                number: AskNumber::new(now as u8),
                held: node % 2 == 0,
                len: 8,
                interval: CoarseSpan::floor(Duration::from_micros(1 + now)),
                tolerance: CoarseSpan::MAX,
                deadline: CoarseSpan::floor(Duration::from_micros(1 + now % 700)),
            };
            control.on_frame(&request.encode());
        }
        frames.extend(answers(&mut control, now, 1).0);
    }
    assert!((10..=201).contains(&frames.len()), "{}", frames.len());
    assert!(control.counters().dropped > 10_000);
}

/// A broker's node and nodes that ask, each frame lost now and then.
fn clusters(seed: u64, loss: u64) {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut draw = move |limit: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % limit
    };
    let mut control = Control::new(&FREE, TIMING);
    control.set_role(at(0), BrokerRole::Active);
    let status = BrokerStatus { tx_node: TxNode::MIN, uid: NodeUid::MIN }.encode();
    let mut clients: Vec<Client> = (0..6).map(|number| Client::new(number, &TIMING)).collect();
    let channel =
        |number: usize| (Subject::new(1 + number as u64).unwrap(), Etag::new(2_000 + number as u16));
    for (number, client) in clients.iter_mut().enumerate() {
        client.set_tx_node(at(0), TxNode::new(1 + number as u8));
    }
    let mut wakes = 0;
    for now in 0..40_000 {
        if now % 250 == 0 && !(15_000..17_000).contains(&now) {
            clients
                .iter_mut()
                .filter(|_| draw(100) >= loss)
                .for_each(|client| client.on_frame(&status, at(now)));
        }
        // The broker falls, and another takes its place.
        match now {
            15_000 => control.set_role(at(now), BrokerRole::Off),
            17_000 => control.set_role(at(now), BrokerRole::Active),
            _ => {}
        }
        if draw(700) == 0 {
            let number = draw(6) as usize;
            let (subject, etag) = channel(number);
            match clients[number].state(subject) {
                None => {
                    clients[number].announce(at(now), subject, &offer(1 + draw(4), 2 + draw(20))).unwrap();
                    clients[number].bind(at(now), subject, etag);
                }
                Some(_) if draw(2) == 0 => {
                    clients[number].forget(subject);
                    let interest = Interest {
                        tx_node: TxNode::new(1 + number as u8).unwrap(),
                        etag: etag.unwrap(),
                        side: Side::Publisher,
                        class: Class::Soft,
                        layout: LayoutHash::UNSTATED,
                        lease: Lease::WITHDRAWN,
                    };
                    if draw(100) >= loss {
                        control.on_frame(&interest.encode());
                    }
                }
                Some(_) => {}
            }
        }
        for client in &mut clients {
            if client.next_wakeup() > at(now) {
                continue;
            }
            wakes += 1;
            while let Some(output) = client.poll(at(now)) {
                if let Output::Send(frame) = output
                    && draw(100) >= loss
                {
                    control.on_frame(&frame);
                }
            }
        }
        while let Some(output) = control.poll(at(now), |_| None) {
            if let Output::Send(frame) = output {
                clients
                    .iter_mut()
                    .filter(|_| draw(100) >= loss)
                    .for_each(|one| one.on_frame(&frame, at(now)));
            }
        }
        let in_table = |tx_node: u8| control.table().admitted().any(|one| one.ask.tx_node.get() == tx_node);
        // But while there is none, and for as long as a new one hears what is held.
        if control.table().admitted().count() > 0 && !(15_000..18_500).contains(&now) {
            for (number, client) in clients.iter().enumerate() {
                let held = matches!(client.state(channel(number).0), Some(AdmissionState::Admitted(_)));
                assert!(!held || in_table(1 + number as u8), "seed {seed}: node {number} at {now} ms");
            }
        }
    }
    assert!(wakes < 20_000, "the clients rest");
}

#[test]
fn whoever_publishes_is_in_the_table_whatever_is_lost() {
    for seed in 1..=40 {
        clusters(seed, [0, 2, 10, 30][seed as usize % 4]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Any frames of any node, at any instant.
    #[test]
    fn no_frame_harms_either(
        frames in proptest::collection::vec((0..=127u8, 18..=21u16, any::<u64>(), 0..5_000_000u64), 1..200),
    ) {
        let mut control = settled();
        let mut client = asking();
        let mut now = at(2_300);
        for (tx_node, etag, bytes, pause) in frames {
                now = now + Duration::from_ticks(pause);
            let id = Id::new(Priority::CONFIGURATION, TxNode::new(tx_node).unwrap(), Etag::new(etag).unwrap());
            let frame = Frame::new(id, Payload::full(bytes.to_be_bytes()));
            control.on_frame(&frame);
            client.on_frame(&frame, now);
            let mut outputs = 0;
            while control.poll(now, |_| None).is_some() || client.poll(now).is_some() {
                outputs += 1;
                prop_assert!(outputs < 20);
            }
            prop_assert!(client.next_wakeup() > now);
        }
        prop_assert!(control.table().admitted().count() <= 4);
    }
}
