//! The client of configuration alone, frame by frame.

use cosmic_core::can::Frame;
use cosmic_core::client::*;
use cosmic_core::protocol::*;
use cosmic_core::time::{Duration, Instant};

use crate::ether::{at, from_candump, tx_node, uid};

const TIMING: ConfigurationTiming = ConfigurationTiming::DEFAULT;

fn stage(stage: u8) -> Stage {
    Stage::new(stage).unwrap()
}

fn request(of: u64, at: u8) -> Frame {
    ConfigurationRequest::new(uid(of), stage(at)).encode()
}

fn prefix(of: u64, at: u8) -> Frame {
    ConfigurationReply::Prefix(Prefix::new(of, stage(at)).unwrap()).encode()
}

fn assigned(of: u64, id: u8) -> Frame {
    ConfigurationReply::Assigned { uid: uid(of), tx_node: tx_node(id) }.encode()
}

fn outputs(client: &mut Configuration, now: Instant) -> Vec<Output<ConfigurationEvent>> {
    core::iter::from_fn(|| client.poll(now)).collect()
}

/// A third of the time for which a claiming node listens.
const BETWEEN_ANSWERS: Duration = Duration::from_millis(20);
const UID: u64 = 0x1234_0000_0000_0000;

/// A client whose first request is out.
fn asking() -> (Configuration, Instant) {
    let mut client = Configuration::new(at(0), uid(UID), 0, &TIMING);
    let now = client.next_wakeup();
    assert!(now < at(0) + TIMING.reply);
    assert_eq!(outputs(&mut client, now), [Output::Send(request(UID, 15))]);
    (client, now)
}

/// A client that has got the id 9, and has stated it some time ago.
fn configured() -> (Configuration, Instant) {
    let (mut client, mut now) = asking();
    client.on_frame(&prefix(UID, 1), now);
    let last = [Output::Withdraw(request(UID, 15)), Output::Send(request(UID, 0))];
    assert_eq!(outputs(&mut client, now), last);
    client.on_frame(&assigned(UID, 9), now);
    let mut all = Vec::new();
    while client.tx_node().is_none() {
        now = client.next_wakeup();
        all.extend(outputs(&mut client, now));
    }
    let identity = Output::Send(NodeIdentity { tx_node: tx_node(9), uid: uid(UID) }.encode());
    let event = Output::Event(ConfigurationEvent::Configured(tx_node(9)));
    // The answer to another's request made our own one void.
    assert_eq!(all, [Output::Withdraw(request(UID, 0)), identity, identity, event]);
    (client, now + BETWEEN_ANSWERS)
}

#[test]
fn a_node_goes_on_with_its_prefix_and_withdraws_when_it_has_lost() {
    let (mut client, now) = asking();
    client.on_frame(&prefix(UID, 15), now);
    let next = [Output::Withdraw(request(UID, 15)), Output::Send(request(UID, 14))];
    assert_eq!(outputs(&mut client, now), next);
    client.on_frame(&prefix(UID, 15), now);
    assert_eq!(outputs(&mut client, now), [], "the same reply again");
    client.on_frame(&prefix(0x1100_0000_0000_0000, 14), now);
    assert_eq!(outputs(&mut client, now), [Output::Withdraw(request(UID, 14))]);
    // The end of the other's search is the start of ours.
    client.on_frame(&assigned(0x1100_0000_0000_0000, 7), now);
    assert_eq!(outputs(&mut client, now), [Output::Send(request(UID, 15))]);
}

#[test]
fn a_node_that_has_lost_begins_again_when_the_bus_falls_silent() {
    let (mut client, now) = asking();
    client.on_frame(&prefix(0x0100_0000_0000_0000, 15), now);
    let _ = outputs(&mut client, now);
    let wakeup = client.next_wakeup();
    assert_eq!(wakeup, now + TIMING.search);
    assert_eq!(outputs(&mut client, wakeup), [Output::Send(request(UID, 15))]);
}

#[test]
fn a_request_that_nobody_has_fetched_is_not_withdrawn_but_dropped() {
    let (mut client, now) = asking();
    client.on_frame(&prefix(UID, 15), now);
    client.on_frame(&prefix(0x1100_0000_0000_0000, 14), now);
    assert_eq!(outputs(&mut client, now), [Output::Withdraw(request(UID, 15))]);
}

#[test]
fn without_an_answer_a_node_asks_less_and_less_often() {
    let (mut client, mut now) = asking();
    let mut sent = vec![now];
    while sent.len() < 60 {
        now = client.next_wakeup();
        sent.extend(
            outputs(&mut client, now).iter().filter(|out| matches!(out, Output::Send(_))).map(|_| now),
        );
    }
    // Three tries for each pause.
    assert_eq!(sent[1].saturating_since(sent[0]), TIMING.reply);
    let pauses: Vec<Duration> =
        sent.chunks(3).zip(sent.chunks(3).skip(1)).map(|(a, b)| b[0].saturating_since(a[2])).collect();
    assert!(pauses[0] < TIMING.back_off * 2);
    let longest = TIMING.longest_back_off + TIMING.longest_back_off + TIMING.reply * 16;
    assert!(pauses.iter().all(|pause| *pause < longest));
    assert!(pauses[10..].iter().all(|pause| *pause > TIMING.longest_back_off.min(Duration::from_secs(1))));
}

#[test]
fn a_refused_node_pauses() {
    let (mut client, now) = asking();
    client.on_frame(&ConfigurationRefusal { uid: uid(UID) }.encode(), now);
    let refused = [Output::Withdraw(request(UID, 15)), Output::Event(ConfigurationEvent::Refused)];
    assert_eq!(outputs(&mut client, now), refused);
    // It takes no part in the searches of others meanwhile.
    client.on_frame(&prefix(UID, 15), now);
    assert_eq!(outputs(&mut client, now), []);
    assert!(client.next_wakeup() > now + Duration::from_millis(900));
}

#[test]
fn a_node_defends_its_id_and_yields_only_to_one_that_stays() {
    let (mut client, mut now) = configured();
    let mine = Output::Send(NodeIdentity { tx_node: tx_node(9), uid: uid(UID) }.encode());
    let theirs = NodeIdentity { tx_node: tx_node(9), uid: uid(5) }.encode();
    let conflict = ConfigurationEvent::Conflict { tx_node: tx_node(9), other: Some(uid(5)) };
    client.on_frame(&theirs, now);
    assert_eq!(outputs(&mut client, now), [Output::Event(conflict), mine]);
    client.on_frame(&theirs, now);
    assert_eq!(outputs(&mut client, now), [], "told once, and answered a little later");
    now = now + BETWEEN_ANSWERS;
    assert_eq!(client.next_wakeup(), now);
    assert_eq!(outputs(&mut client, now), [mine]);
    client.on_frame(&theirs, now);
    assert_eq!(outputs(&mut client, now), [Output::Event(ConfigurationEvent::Lost(tx_node(9)))]);
    assert_eq!(client.tx_node(), None);
}

#[test]
fn the_lower_uid_stays_and_conflicts_that_are_rare_are_forgotten() {
    let (mut client, mut now) = configured();
    let higher = NodeIdentity { tx_node: tx_node(9), uid: uid(UID + 1) }.encode();
    let lower = NodeIdentity { tx_node: tx_node(9), uid: uid(5) }.encode();
    for _ in 0..10 {
        client.on_frame(&higher, now);
        now = now + TIMING.conflict;
        client.on_frame(&lower, now);
        now = now + TIMING.conflict;
        let _ = outputs(&mut client, now);
    }
    assert_eq!(client.tx_node(), Some(tx_node(9)));
}

#[test]
fn any_frame_with_its_id_is_a_conflict_but_configuration_is_not() {
    let (mut client, now) = configured();
    // Stage 0, nibble 9: the TxNode field happens to be 9.
    client.on_frame(&request(9, 0), now);
    assert_eq!(outputs(&mut client, now), []);
    client.on_frame(&NodeStatus::first(tx_node(9), NodeState::Operational).encode(), now);
    let conflict = ConfigurationEvent::Conflict { tx_node: tx_node(9), other: None };
    let identity = NodeIdentity { tx_node: tx_node(9), uid: uid(UID) }.encode();
    assert_eq!(outputs(&mut client, now), [Output::Event(conflict), Output::Send(identity)]);
}

#[test]
fn a_second_node_with_our_uid_is_told_of() {
    let (mut client, now) = configured();
    client.on_frame(&assigned(UID, 9), now);
    assert_eq!(outputs(&mut client, now), [], "it may be the reply to our own request, repeated");
    let later = now + Duration::from_secs(5);
    client.on_frame(&assigned(UID, 9), later);
    let conflict = ConfigurationEvent::Conflict { tx_node: tx_node(9), other: Some(uid(UID)) };
    assert_eq!(outputs(&mut client, later)[0], Output::Event(conflict));
}

#[test]
fn a_probe_is_answered_and_a_release_is_the_last_word() {
    let (mut client, now) = configured();
    client.on_frame(&Probe { tx_node: tx_node(3) }.encode(), now);
    let identity = NodeIdentity { tx_node: tx_node(9), uid: uid(UID) }.encode();
    assert_eq!(outputs(&mut client, now), [Output::Send(identity)]);
    client.release();
    let release = Release { tx_node: tx_node(9), uid: uid(UID) }.encode();
    assert_eq!(outputs(&mut client, now), [Output::Send(release)]);
    client.on_frame(&Probe { tx_node: tx_node(3) }.encode(), now);
    client.on_frame(&ConfigurationReply::Restart.encode(), now);
    assert_eq!((outputs(&mut client, now), client.next_wakeup()), (vec![], Instant::FAR_FUTURE));
}

/// Frames from one sender, one in a millisecond.
fn flood(
    client: &mut Configuration,
    from: Instant,
    frame: &Frame,
    count: u64,
) -> Vec<Output<ConfigurationEvent>> {
    let times = (0..count).map(|ms| from + Duration::from_millis(ms));
    let answers = times.flat_map(|now| {
        client.on_frame(frame, now);
        outputs(client, now)
    });
    answers.collect()
}

fn is_frame<Event>(output: &Output<Event>) -> bool {
    matches!(output, Output::Send(_))
}

#[test]
fn a_flood_is_answered_fifty_times_a_second_at_most() {
    for frame in ["1F40C008#", "1F424013#0100000100000001", "00224FFF#"] {
        let (mut client, now) = configured();
        let answers = flood(&mut client, now, &from_candump(frame), 3000);
        assert_eq!(answers.iter().filter(|out| is_frame(out)).count(), 150, "{frame}");
        assert!(answers.len() <= 153, "one conflict a second is told: {frame}");
    }
    // Identities of a higher UID: after three in a second the other knows.
    let (mut client, now) = configured();
    let answers = flood(&mut client, now, &from_candump("1F424007#FF00000000000000"), 3000);
    assert!(answers.iter().filter(|out| is_frame(out)).count() <= 9, "{answers:?}");
    assert_eq!(client.tx_node(), Some(tx_node(9)));
}

/// A client with the fixed id 9, which works.
fn fixed(on_duplicate: OnDuplicate) -> (Configuration, Instant) {
    let client = Configuration::fixed(at(0), uid(UID), tx_node(9), 0, &TIMING);
    let mut client = client.on_duplicate(on_duplicate);
    let mut now = at(0);
    while client.tx_node().is_none() {
        now = client.next_wakeup();
        let _ = outputs(&mut client, now);
    }
    (client, now + BETWEEN_ANSWERS)
}

#[test]
fn a_node_that_holds_its_id_is_not_silenced_by_any_identities() {
    // UID 1, which is lower than any.
    let low = from_candump("1F424007#0000000000000001");
    let conflict = ConfigurationEvent::Conflict { tx_node: tx_node(9), other: Some(uid(1)) };
    for stays in [OnDuplicate::Hold, OnDuplicate::Stay] {
        let (mut client, now) = fixed(stays);
        let all = flood(&mut client, now, &low, 31);
        assert_eq!(client.tx_node(), Some(tx_node(9)));
        assert_eq!(all[0], Output::Event(conflict));
        assert_eq!(all.iter().filter(|out| !is_frame(out)).count(), 1, "told once in a second");
        assert!(all.len() <= 4, "{all:?}");
        let all = flood(&mut client, now + Duration::from_secs(1), &low, 10_000);
        assert_eq!(all.iter().filter(|out| **out == Output::Event(conflict)).count(), 10);
        assert!(all.len() <= 40, "{}", all.len());
        assert_eq!(client.tx_node(), Some(tx_node(9)));
    }
    let (mut client, now) = fixed(OnDuplicate::Yield);
    let _ = flood(&mut client, now, &low, 31);
    assert_eq!(client.tx_node(), None, "any other yields");
}

#[test]
fn a_node_that_holds_its_id_lets_one_that_works_with_it_already() {
    let low = from_candump("1F424007#0000000000000001");
    for (stays, works) in [(OnDuplicate::Hold, false), (OnDuplicate::Stay, true)] {
        let client = Configuration::fixed(at(0), uid(UID), tx_node(9), 0, &TIMING);
        let mut client = client.on_duplicate(stays);
        // The other one answers each claim.
        let mut told = 0;
        for now in (0..20_000).map(at) {
            let all = outputs(&mut client, now);
            told += all
                .iter()
                .filter(|out| matches!(out, Output::Event(ConfigurationEvent::Conflict { .. })))
                .count();
            if all.iter().any(is_frame) {
                client.on_frame(&low, now);
            }
        }
        assert_eq!(client.tx_node().is_some(), works, "{stays:?}");
        assert!(told > 0);
    }
}

#[test]
fn what_a_node_does_on_a_duplicate_is_for_fixed_ids_only() {
    let (client, now) = configured();
    let mut client = client.on_duplicate(OnDuplicate::Stay);
    let _ = flood(&mut client, now, &from_candump("1F424007#0000000000000001"), 31);
    assert_eq!(client.tx_node(), None);
}

#[test]
fn an_id_counts_only_as_the_answer_to_the_last_question() {
    let (mut client, now) = asking();
    client.on_frame(&assigned(UID, 9), now);
    let again = [Output::Withdraw(request(UID, 15)), Output::Send(request(UID, 15))];
    assert_eq!(outputs(&mut client, now), again);
}
