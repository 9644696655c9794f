//! The client of binding alone, frame by frame.

use cosmic_core::can::{Etag, Frame, TxNode};
use cosmic_core::client::*;
use cosmic_core::protocol::*;
use cosmic_core::time::{Duration, Instant};

use crate::ether::{at, from_candump, subject, tx_node};

fn binding_outputs<const N: usize>(client: &mut Binding<N>, now: Instant) -> Vec<Output<BindingEvent>> {
    core::iter::from_fn(|| client.poll(now)).collect()
}

fn supply(sender: TxNode, requester: u8, of: u64, answer: Answer) -> [Frame; 2] {
    SupplyEtag::pair(sender, tx_node(requester), subject(of), answer).map(|half| half.encode())
}

fn get(of: u64) -> Frame {
    GetEtag { requester: tx_node(4), subject: subject(of) }.encode()
}

const ETAG: Etag = Etag::BOUND_LAST;

fn binding() -> Binding<2> {
    let mut client = Binding::new(0, &BindingTiming::DEFAULT);
    client.bind(subject(1)).unwrap();
    client.bind(subject(2)).unwrap();
    assert_eq!(client.bind(subject(3)), Err(BindingFull));
    assert_eq!(binding_outputs(&mut client, at(0)), [], "silent without an id");
    client.set_tx_node(Some(tx_node(4)));
    assert_eq!(binding_outputs(&mut client, at(0)), [Output::Send(get(1))]);
    client
}

#[test]
fn subjects_are_bound_one_after_the_other() {
    let mut client = binding();
    let [first, second] = supply(TxNode::BROKER, 4, 1, Answer::Bound(ETAG));
    client.on_frame(&second, at(1));
    client.on_frame(&first, at(1));
    assert_eq!(binding_outputs(&mut client, at(1)), [], "halves in the wrong order");
    client.on_frame(&second, at(1));
    let bound = BindingEvent::Bound { subject: subject(1), etag: ETAG };
    assert_eq!(binding_outputs(&mut client, at(1)), [Output::Event(bound), Output::Send(get(2))]);
    assert_eq!(client.etag_of(subject(1)), Some(ETAG));
    // It is told again to whoever asks again.
    client.bind(subject(1)).unwrap();
    assert_eq!(binding_outputs(&mut client, at(1)), [Output::Event(bound)]);
}

#[test]
fn an_answer_to_another_node_makes_our_request_void() {
    let mut client = binding();
    for half in supply(TxNode::BROKER, 77, 1, Answer::Bound(ETAG)) {
        client.on_frame(&half, at(1));
    }
    let bound = BindingEvent::Bound { subject: subject(1), etag: ETAG };
    let expected = [Output::Withdraw(get(1)), Output::Event(bound), Output::Send(get(2))];
    assert_eq!(binding_outputs(&mut client, at(1)), expected);
}

#[test]
fn without_an_answer_the_subjects_take_turns() {
    let mut client = binding();
    let mut asked = Vec::new();
    for _ in 0..6 {
        let now = client.next_wakeup();
        let outputs = binding_outputs(&mut client, now);
        assert!(matches!(outputs[0], Output::Withdraw(_)));
        asked.extend(outputs.into_iter().skip(1));
    }
    let turns = [2, 1, 2, 1, 2, 1].map(|of| Output::Send(get(of)));
    assert_eq!(asked, turns);
}

#[test]
fn only_the_broker_binds() {
    let mut client = binding();
    for half in supply(tx_node(9), 9, 1, Answer::Bound(ETAG)) {
        client.on_frame(&half, at(1));
    }
    assert_eq!(client.etag_of(subject(1)), None);
}

#[test]
fn a_refused_subject_is_asked_for_again_later() {
    let mut client = binding();
    client.forget(subject(2));
    for half in supply(TxNode::BROKER, 4, 1, Answer::Refused) {
        client.on_frame(&half, at(1));
    }
    let refused = BindingEvent::Refused { subject: subject(1) };
    assert_eq!(binding_outputs(&mut client, at(1)), [Output::Event(refused)]);
    let again = client.next_wakeup();
    assert!(again > at(1) + Duration::from_secs(1));
    assert_eq!(binding_outputs(&mut client, again), [Output::Send(get(1))]);
}

#[test]
fn a_subject_is_bound_anew() {
    let mut client = Binding::<1>::new(0, &BindingTiming::DEFAULT);
    client.assume(subject(1), ETAG).unwrap();
    let new = Etag::new(0x3000).unwrap();
    for half in supply(TxNode::BROKER, 77, 1, Answer::Bound(new)) {
        client.on_frame(&half, at(1));
    }
    let rebound = BindingEvent::Rebound { subject: subject(1), old: ETAG, new };
    assert_eq!(binding_outputs(&mut client, at(1)), [Output::Event(rebound)]);
    // A probe is answered with what holds now.
    client.set_tx_node(Some(tx_node(4)));
    client.on_frame(&Probe { tx_node: tx_node(3) }.encode(), at(2));
    let claim = supply(tx_node(4), 4, 1, Answer::Bound(new)).map(Output::Send);
    assert_eq!(binding_outputs(&mut client, at(2)), claim);
}

#[test]
fn a_flood_of_probes_is_answered_five_times_a_second() {
    let mut client = Binding::<3>::new(0, &BindingTiming::DEFAULT);
    for of in 1..=3 {
        client.assume(subject(of), Etag::new(0x3000 + of as u16).unwrap()).unwrap();
    }
    client.set_tx_node(Some(tx_node(4)));
    let mut claims = Vec::new();
    for now in (0..2000).map(at) {
        client.on_frame(&from_candump("1F40C008#"), now);
        // The bus takes one frame a millisecond.
        claims.extend(client.poll(now));
    }
    let round: Vec<_> = (1..=3)
        .flat_map(|of| supply(tx_node(4), 4, of, Answer::Bound(Etag::new(0x3000 + of as u16).unwrap())))
        .map(Output::Send)
        .collect();
    assert_eq!(claims, round.repeat(10), "each of them whole");
    assert_eq!(client.next_wakeup(), at(2000), "the last probe is not forgotten");
    assert_eq!(binding_outputs(&mut client, at(2000)), round);
}

#[test]
fn a_claim_that_is_given_up_half_way_is_not_completed_by_another() {
    let mut client = Binding::<2>::new(0, &BindingTiming::DEFAULT);
    let etag = |of: u64| Etag::new(0x3000 + of as u16).unwrap();
    let claim = |of| supply(tx_node(4), 4, of, Answer::Bound(etag(of))).map(Output::Send);
    for of in 1..=2 {
        client.assume(subject(of), etag(of)).unwrap();
    }
    client.set_tx_node(Some(tx_node(4)));
    client.on_frame(&Probe { tx_node: tx_node(3) }.encode(), at(1));
    assert_eq!(client.poll(at(1)), Some(claim(1)[0]));
    client.forget(subject(1));
    assert_eq!(binding_outputs(&mut client, at(1)), claim(2));
}

/// Forged frames would otherwise move a channel of a cluster without a broker, for good.
#[test]
fn an_etag_that_is_fixed_stays() {
    for fixed in [ETAG, Etag::HARD_FIRST] {
        let mut client = Binding::<2>::new(0, &BindingTiming::DEFAULT);
        client.set_tx_node(Some(tx_node(4)));
        client.fix(subject(1), fixed).unwrap();
        let contradicted = [Output::Event(BindingEvent::Contradicted { subject: subject(1), etag: fixed })];
        let mut hear = |now, of, answer| {
            supply(TxNode::BROKER, 9, of, answer).iter().for_each(|half| client.on_frame(half, now));
            let outputs = binding_outputs(&mut client, now);
            assert_eq!(client.etag_of(subject(1)), Some(fixed));
            outputs
        };
        let other = Answer::Bound(Etag::new(0x3000).unwrap());
        assert_eq!(hear(at(1), 1, other), contradicted);
        assert_eq!(hear(at(1500), 1, other), [], "told once in two seconds");
        assert_eq!(hear(at(2001), 1, other), contradicted);
        assert_eq!(hear(at(5000), 1, Answer::Refused), []);
        assert_eq!(hear(at(5000), 2, other), [], "that concerns nobody here");
        if fixed == ETAG {
            assert_eq!(hear(at(5000), 1, Answer::Bound(ETAG)), [], "that is right");
            assert_eq!(hear(at(5000), 2, Answer::Bound(ETAG)), contradicted);
        }
    }
}

#[test]
fn an_etag_that_another_subject_gets_is_dropped_at_once() {
    let mut client = binding();
    let bind = |client: &mut Binding<2>, of, etag| {
        for half in supply(TxNode::BROKER, 77, of, Answer::Bound(etag)) {
            client.on_frame(&half, at(1));
        }
        binding_outputs(client, at(1))
    };
    let other = Etag::new(0x3000).unwrap();
    bind(&mut client, 1, ETAG);
    bind(&mut client, 2, other);
    // A subject of which this node knows nothing.
    let withdrawn = BindingEvent::Withdrawn { subject: subject(1), old: ETAG };
    assert_eq!(bind(&mut client, 7, ETAG), [Output::Event(withdrawn), Output::Send(get(1))]);
    assert_eq!(client.etag_of(subject(1)), None);
    // Its own two subjects: the old one goes before the new one comes.
    let withdrawn = BindingEvent::Withdrawn { subject: subject(2), old: other };
    let bound = BindingEvent::Bound { subject: subject(1), etag: other };
    let [withdrawn, bound] = [withdrawn, bound].map(Output::Event);
    let expected = [Output::Withdraw(get(1)), withdrawn, bound, Output::Send(get(2))];
    assert_eq!(bind(&mut client, 1, other), expected);
}
