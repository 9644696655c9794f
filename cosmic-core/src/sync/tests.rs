use super::*;
use crate::can::{Id, Payload};
use crate::protocol::SyncSequence;
use crate::time::GlobalInstant;
use proptest::prelude::*;
use std::vec::Vec;

const MASTER: TxNode = TxNode::new(0x10).unwrap();
const OTHER: TxNode = TxNode::new(0x11).unwrap();
const OWN: TxNode = TxNode::new(0x12).unwrap();
const PERIOD: u64 = 100_000;

/// So many microseconds of local time.
fn at(microseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(microseconds))
}

fn frame(raw: u32, bytes: [u8; 8]) -> Frame {
    Frame::new(Id::from_raw(raw).unwrap(), Payload::full(bytes))
}

/// As sent by `master` at rank 1: what matters here is who, when and in continuation of whom.
fn sync(master: TxNode, sequence: u64, predecessor: TxNode) -> Frame {
    let message = SyncMessage {
        sequence: SyncSequence::new(sequence as u8),
        rank: Rank::new(1).unwrap(),
        predecessor,
        accuracy: Duration::from_ticks(if master == predecessor { 0 } else { 2_000 }),
        calendar_digest: 0xCAFE_F00D,
    };
    message.encode(master)
}

fn follow_up(master: TxNode, sequence: u64, microseconds: u64) -> Frame {
    let sent_at = GlobalInstant::from_epoch(Duration::from_micros(microseconds));
    FollowUp { sequence: SyncSequence::new(sequence as u8), sent_at }.encode(master)
}

fn node(rank: Option<u8>) -> ClockSync {
    let rank = rank.and_then(Rank::new);
    let config = SyncConfig { rank, calendar_digest: 0xCAFE_F00D, ..SyncConfig::DEFAULT };
    let mut node = ClockSync::new(config, at(0)).unwrap();
    node.set_tx_node(Some(OWN));
    node
}

/// A pair that was sent in the given period by a master whose clock is a second ahead.
fn hear<const CANDIDATE: bool>(
    node: &mut ClockSync<CANDIDATE>,
    master: TxNode,
    predecessor: TxNode,
    period: u64,
) {
    node.on_frame(&sync(master, period, predecessor), at(period * PERIOD));
    let sent_at = 1_000_000 + period * PERIOD;
    node.on_frame(&follow_up(master, period, sent_at), at(period * PERIOD + 300));
}

/// Has heard `MASTER` in the periods 0..=10.
fn synchronised(rank: Option<u8>) -> ClockSync {
    let mut node = node(rank);
    for period in 0..=10 {
        hear(&mut node, MASTER, MASTER, period);
    }
    assert_eq!(events(&mut node), [ClockEvent::MasterChanged { master: MASTER, continued: false }]);
    assert!(node.clock().is_synchronised(at(10 * PERIOD)));
    node
}

fn events<const CANDIDATE: bool>(node: &mut ClockSync<CANDIDATE>) -> Vec<ClockEvent> {
    core::iter::from_fn(|| node.poll_event()).collect()
}

#[test]
fn literal_frames_make_a_clock() {
    let mut node = node(None);
    for period in 0u8..=6 {
        let received_at = at(u64::from(period) * PERIOD);
        node.on_frame(&frame(0x0024_0010, [period << 4, 0x10, 0, 0, 0xCA, 0xFE, 0xF0, 0x0D]), received_at);
        let [.., b4, b5, b6, b7] = (1_000_000_000 + u64::from(period) * 100_000_000).to_be_bytes();
        node.on_frame(&frame(0x0024_0011, [period << 4, 0, 0, 0, b4, b5, b6, b7]), received_at);
        // Six periods must pass before nobody can be left on another time scale.
        assert_eq!(node.clock().is_synchronised(received_at), period == 6);
    }
    assert_eq!(node.master(), Some(MASTER));
    assert_eq!(node.counters().used, 7);
    let now = at(6 * PERIOD + 50_000);
    let expected = GlobalInstant::from_epoch(Duration::from_micros(1_650_000));
    assert!(node.clock().to_global(now).signed_since(expected).abs() <= 1);
    assert!(node.clock().accuracy(now) < Duration::from_micros(2));
    // Six periods later it is not synchronised any more.
    assert!(node.clock().is_synchronised(at(12 * PERIOD - 1)));
    assert!(!node.clock().is_synchronised(at(12 * PERIOD)));
}

#[test]
fn a_master_sends_a_sync_frame_and_the_instant_of_its_end() {
    let mut node = node(Some(0));
    assert_eq!(node.poll(at(799_999)), None);
    let first = node.poll(at(800_000)).unwrap();
    assert_eq!(first, frame(0x0024_8010, [0x00, 0x12, 0, 0, 0xCA, 0xFE, 0xF0, 0x0D]));
    assert_eq!(node.poll(at(800_000)), None);
    assert_eq!(events(&mut node), [ClockEvent::BecameMaster { continued: false }]);
    node.on_sent(&first, at(800_200));
    assert_eq!(node.next_wakeup(), Instant::EPOCH);
    // 800 200 000 ns
    let told = node.poll(at(800_201)).unwrap();
    assert_eq!(told, frame(0x0024_8011, [0, 0, 0, 0, 0x2F, 0xB2, 0x15, 0x40]));
    node.on_sent(&told, at(800_400));
    assert_eq!(node.poll(at(800_400)), None);
    assert_eq!(node.next_wakeup(), at(900_000));
    // Called late, by three and a half periods: one frame, not four.
    let second = node.poll(at(1_250_000)).unwrap();
    assert_eq!(second.payload.padded()[0], 0x10);
    assert_eq!(node.poll(at(1_250_000)), None);
    assert_eq!(node.next_wakeup(), at(1_350_000));
    assert_eq!(node.counters().sent, 1);
    // A confirmation that comes twice, or for another frame, changes nothing.
    node.on_sent(&first, at(1_250_100));
    assert_eq!(node.poll(at(1_250_100)), None);
}

#[test]
fn a_new_time_scale_is_trusted_when_nobody_is_left_on_another() {
    let mut node = node(Some(0));
    for period in 8..16 {
        let now = at(period * PERIOD);
        let frame = node.poll(now).unwrap();
        assert_eq!(node.clock().is_synchronised(now), period == 15);
        node.on_sent(&frame, now);
        assert!(node.poll(now).is_some());
    }
    assert_eq!(node.clock().accuracy(at(15 * PERIOD)), Duration::from_ticks(0));
}

#[test]
fn a_sync_frame_that_is_not_sent_is_followed_by_another_one_later() {
    let mut node = node(Some(0));
    assert!(node.poll(at(8 * PERIOD)).is_some());
    assert_eq!(node.poll(at(9 * PERIOD)), None);
    let second = node.poll(at(10 * PERIOD)).unwrap();
    assert_eq!(node.counters().unsent, 1);
    node.on_sent(&second, at(10 * PERIOD + 200));
    assert!(node.poll(at(10 * PERIOD + 200)).is_some());
    assert!(node.is_master());
}

#[test]
fn a_master_that_nobody_acknowledges_gives_up() {
    let mut node = node(Some(0));
    let first = node.poll(at(8 * PERIOD)).unwrap();
    while node.is_master() {
        let now = node.next_wakeup();
        assert!(now <= at(11 * PERIOD));
        let _ = node.poll(now);
    }
    assert_eq!(events(&mut node), [ClockEvent::BecameMaster { continued: false }, ClockEvent::Isolated]);
    assert_eq!(node.next_wakeup(), at(19 * PERIOD));
    // The old frame gets through when the bus is back. Its follow-up is not sent any more.
    node.on_sent(&first, at(12 * PERIOD));
    assert_eq!(node.poll(at(12 * PERIOD)), None);
}

#[test]
fn a_sync_frame_of_an_earlier_mastership_has_another_number() {
    let mut node = node(Some(0));
    let first = node.poll(at(8 * PERIOD)).unwrap();
    let second = node.poll(at(10 * PERIOD)).unwrap();
    assert_eq!(node.poll(at(11 * PERIOD)), None);
    assert_eq!(node.next_wakeup(), at(19 * PERIOD));
    let third = node.poll(at(19 * PERIOD)).unwrap();
    let number = |frame: &Frame| SyncMessage::decode(frame).unwrap().sequence.get();
    assert_eq!([&first, &second, &third].map(number), [0, 1, 2]);
    // Only the one that is awaited is followed up.
    for late in [&first, &second] {
        node.on_sent(late, at(19 * PERIOD + 160));
        assert_eq!(node.poll(at(19 * PERIOD + 160)), None);
    }
    node.on_sent(&third, at(19 * PERIOD + 480));
    assert!(node.poll(at(19 * PERIOD + 480)).is_some());
}

#[test]
fn who_has_yielded_continues_no_time_scale_for_a_while() {
    // It becomes master in continuation of `MASTER`, and yields to one who continues it.
    let mut node = synchronised(Some(2));
    let sync = node.poll(at(13 * PERIOD + PERIOD / 4)).unwrap();
    node.on_sent(&sync, at(13 * PERIOD + PERIOD / 4));
    assert!(node.is_master());
    hear(&mut node, OTHER, OWN, 14);
    assert_eq!(node.master(), Some(OTHER));
    for period in 15..=23 {
        hear(&mut node, OTHER, OTHER, period);
    }
    assert!(node.clock().is_synchronised(at(23 * PERIOD)));
    // Not after three periods and its rank's part, but when nobody takes the old scale for the new one.
    let takeover = at(28 * PERIOD);
    assert_eq!(node.poll(at(26 * PERIOD)), None);
    assert_eq!(node.next_wakeup(), takeover);
    let first = SyncMessage::decode(&node.poll(takeover).unwrap()).unwrap();
    assert_eq!(first.predecessor, OTHER);
}

#[test]
fn a_pair_with_a_lost_frame_is_not_used() {
    let mut node = synchronised(None);
    let clock = node.clock();
    node.on_frame(&sync(MASTER, 11, MASTER), at(11 * PERIOD));
    node.on_frame(&sync(MASTER, 12, MASTER), at(12 * PERIOD));
    assert_eq!(node.counters().follow_ups_missed, 1);
    node.on_frame(&follow_up(MASTER, 13, 2_300_000), at(13 * PERIOD));
    assert_eq!(node.counters().syncs_missed, 1);
    assert_eq!(node.clock(), clock);
    hear(&mut node, MASTER, MASTER, 14);
    assert_ne!(node.clock(), clock);
    assert_eq!(node.counters().used, 12);
}

#[test]
fn a_follow_up_belongs_to_one_sync_frame() {
    let mut node = synchronised(None);
    let clock = node.clock();
    node.on_frame(&sync(MASTER, 11, MASTER), at(11 * PERIOD));
    let wrong = [
        follow_up(MASTER, 12, 2_100_000), // of another sync frame
        follow_up(OTHER, 11, 2_100_000),  // of another master
    ];
    for frame in wrong {
        node.on_frame(&frame, at(11 * PERIOD + 300));
    }
    // Sixteen periods later the number is the same.
    node.on_frame(&follow_up(MASTER, 11 + 16, 3_700_000), at(27 * PERIOD));
    assert_eq!(node.clock(), clock);
    assert_eq!(node.counters().syncs_missed, 3);
}

#[test]
fn of_a_repeated_sync_frame_the_last_copy_counts() {
    let mut node = synchronised(None);
    // The first copy was rejected by another node (inconsistent omission); the master stamps the second.
    node.on_frame(&sync(MASTER, 11, MASTER), at(11 * PERIOD - 180));
    node.on_frame(&sync(MASTER, 11, MASTER), at(11 * PERIOD));
    node.on_frame(&follow_up(MASTER, 11, 2_100_000), at(11 * PERIOD + 300));
    assert_eq!((node.counters().duplicates, node.counters().used), (1, 12));
    assert_eq!(node.counters().implausible, 0);
    // Copies of both after the pair is complete.
    node.on_frame(&sync(MASTER, 11, MASTER), at(11 * PERIOD + 500));
    node.on_frame(&follow_up(MASTER, 11, 2_100_000), at(11 * PERIOD + 700));
    assert_eq!((node.counters().duplicates, node.counters().used), (2, 12));
    assert_eq!(node.counters().implausible, 0);
}

#[test]
fn frames_of_wrong_length_are_counted() {
    let mut node = node(None);
    for etag in [Etag::SYNC, Etag::FOLLOW_UP] {
        let id = Id::new(crate::can::Priority::SOFT_MOST_URGENT, MASTER, etag);
        node.on_frame(&Frame::new(id, Payload::EMPTY), at(0));
    }
    assert_eq!(node.counters().malformed, 2);
}

#[test]
fn candidates_take_over_in_the_order_of_their_ranks() {
    for rank in 0..=15 {
        let mut node = synchronised(Some(rank));
        let lost = at(13 * PERIOD);
        assert_eq!(node.next_wakeup(), lost);
        let takeover = lost + Duration::from_micros(u64::from(rank) * PERIOD / 8);
        if rank > 0 {
            assert_eq!(node.poll(lost), None);
            assert_eq!(events(&mut node), [ClockEvent::MasterLost { master: MASTER }]);
            assert_eq!(node.next_wakeup(), takeover);
        }
        let before = node.clock().to_global(takeover);
        let first = SyncMessage::decode(&node.poll(takeover).unwrap()).unwrap();
        // Without a step, and it says whose time it continues, and how well.
        assert_eq!(node.clock().to_global(takeover), before);
        assert_eq!(first.predecessor, MASTER);
        assert!(first.accuracy > Duration::from_micros(1) && first.accuracy < Duration::from_micros(10));
        assert!(events(&mut node).contains(&ClockEvent::BecameMaster { continued: true }));
    }
}

#[test]
fn the_handover_ends_after_seven_periods() {
    let mut node = synchronised(Some(0));
    for period in 13..=20 {
        let now = at(period * PERIOD);
        let sync = node.poll(now).unwrap();
        node.on_sent(&sync, now);
        assert!(node.poll(now).is_some());
        let message = SyncMessage::decode(&sync).unwrap();
        let ended = period == 20;
        assert_eq!(message.predecessor, if ended { OWN } else { MASTER });
        assert_eq!(message.accuracy.is_zero(), ended);
        assert_eq!(node.clock().accuracy(now).is_zero(), ended);
    }
}

#[test]
fn a_candidate_that_cannot_continue_waits_longer() {
    let mut node = node(Some(0));
    for period in 0..=2 {
        hear(&mut node, MASTER, MASTER, period);
    }
    assert_eq!(node.poll(at(5 * PERIOD)), None);
    assert_eq!(node.next_wakeup(), at(10 * PERIOD));
    assert!(node.poll(at(10 * PERIOD)).is_some());
    assert!(events(&mut node).contains(&ClockEvent::BecameMaster { continued: false }));
}

#[test]
fn a_node_without_rank_or_id_never_becomes_master() {
    let mut without_rank = synchronised(None);
    assert_eq!(without_rank.next_wakeup(), at(13 * PERIOD));
    assert_eq!(without_rank.poll(at(1_000 * PERIOD)), None);
    assert_eq!(without_rank.next_wakeup(), Instant::FAR_FUTURE);
    assert_eq!(events(&mut without_rank), [ClockEvent::MasterLost { master: MASTER }]);
    let mut without_id = node(Some(0));
    without_id.set_tx_node(None);
    assert_eq!(without_id.next_wakeup(), Instant::FAR_FUTURE);
    assert_eq!(without_id.poll(at(1_000 * PERIOD)), None);
}

#[test]
fn followers_go_over_to_the_successor_without_a_step() {
    let mut node = synchronised(None);
    let before = node.clock().accuracy(at(13 * PERIOD));
    hear(&mut node, OTHER, MASTER, 13);
    assert_eq!(events(&mut node), [ClockEvent::MasterChanged { master: OTHER, continued: true }]);
    let after = node.clock().accuracy(at(13 * PERIOD));
    assert!(before < Duration::from_micros(4) && after < Duration::from_micros(4), "{before} {after}");
    // A master of which this node knows nothing has a time scale of which it knows nothing.
    hear(&mut node, TxNode::MAX, TxNode::MAX, 15);
    hear(&mut node, TxNode::MAX, TxNode::MAX, 16);
    assert_eq!(events(&mut node), [ClockEvent::MasterChanged { master: TxNode::MAX, continued: false }]);
    assert!(!node.clock().is_synchronised(at(16 * PERIOD)));
}

#[test]
fn of_two_masters_the_lower_node_of_equal_rank_stays() {
    let mut node = synchronised(None);
    hear(&mut node, OTHER, OTHER, 11);
    assert_eq!((node.master(), node.counters().foreign), (Some(MASTER), 1));
    hear(&mut node, TxNode::MIN, TxNode::MIN, 11);
    assert_eq!(node.master(), Some(TxNode::MIN));
}

#[test]
fn interleaved_frames_of_two_masters_do_not_hide_the_better_one() {
    let mut node = synchronised(None);
    node.on_frame(&sync(MASTER, 11, MASTER), at(11 * PERIOD));
    node.on_frame(&sync(OTHER, 3, OTHER), at(11 * PERIOD + 160));
    node.on_frame(&follow_up(MASTER, 11, 2_100_000), at(11 * PERIOD + 320));
    node.on_frame(&follow_up(OTHER, 3, 77), at(11 * PERIOD + 480));
    assert_eq!((node.counters().used, node.counters().foreign, node.counters().syncs_missed), (12, 1, 1));
    assert_eq!(node.master(), Some(MASTER));
}

#[test]
fn a_master_yields_to_a_better_one_and_not_to_a_worse_one() {
    let mut node = node(Some(1));
    let first = node.poll(at(9 * PERIOD)).unwrap();
    node.on_sent(&first, at(9 * PERIOD + 160));
    let _ = node.poll(at(9 * PERIOD + 160));
    let _ = events(&mut node);
    // All have rank 1, so the smaller TxNode is the better one.
    hear(&mut node, TxNode::MAX, TxNode::MAX, 9);
    assert!(node.is_master());
    assert_eq!(node.counters().foreign, 1);
    hear(&mut node, MASTER, MASTER, 10);
    assert!(!node.is_master());
    assert_eq!(
        events(&mut node),
        [ClockEvent::Yielded { to: MASTER }, ClockEvent::MasterChanged { master: MASTER, continued: false }]
    );
}

#[test]
fn another_calendar_is_reported_once_and_its_end_too() {
    let mut node = synchronised(None);
    let message = SyncMessage::decode(&sync(MASTER, 11, MASTER)).unwrap();
    for (period, digest) in [(11, 0xBAD), (12, 0xBAD), (13, 0xCAFE_F00D), (14, 0)] {
        let message =
            SyncMessage { calendar_digest: digest, sequence: SyncSequence::new(period as u8), ..message };
        node.on_frame(&message.encode(MASTER), at(period * PERIOD));
        let sent_at = 1_000_000 + period * PERIOD;
        node.on_frame(&follow_up(MASTER, period, sent_at), at(period * PERIOD));
        assert_eq!(node.has_calendar_mismatch(), digest == 0xBAD);
    }
    let master = MASTER;
    assert_eq!(
        events(&mut node),
        [ClockEvent::CalendarMismatch { master }, ClockEvent::CalendarMatch { master }]
    );
}

#[test]
fn events_that_are_not_fetched_are_counted() {
    let mut node = synchronised(None);
    for period in 11..31 {
        node.on_frame(&sync(MASTER, period, MASTER), at(period * PERIOD));
        node.on_frame(&follow_up(MASTER, period, period * 7), at(period * PERIOD));
    }
    assert_eq!(node.counters().implausible, 20);
    assert_eq!(events(&mut node).len(), 6);
    assert_eq!(node.counters().events_lost, 14);
}

#[test]
fn a_node_that_only_follows_has_no_rank() {
    let with = |rank| ClockSync::<false>::new(SyncConfig { rank, ..SyncConfig::DEFAULT }, at(0)).err();
    assert_eq!(with(Some(Rank::FIRST)), Some(SyncConfigError::Rank));
    assert_eq!(with(None), None);
}

proptest! {
    /// Whomever it hears, loses and believes: what is compiled without a master follows as one that is none does.
    #[test]
    fn a_node_that_only_follows_is_one_without_a_rank(
        steps in proptest::collection::vec((0u64..12, any::<bool>(), any::<bool>(), -3i64..=3), 0..60),
    ) {
        let config = SyncConfig { calendar_digest: 0xCAFE_F00D, ..SyncConfig::DEFAULT };
        let mut follower = ClockSync::<false>::new(config, at(0)).unwrap();
        let mut other = node(None);
        follower.set_tx_node(Some(OWN));
        let mut period = 0;
        let mut used = 0;
        for (silent, is_other, continues, error) in steps {
            // Mostly the next period; a long silence now and then, and a stamp that contradicts.
            period += 1 + silent.saturating_sub(4);
            let master = if is_other { OTHER } else { MASTER };
            let predecessor = if continues { MASTER } else { master };
            let sent_at = (1_000_000 + period * PERIOD).saturating_add_signed(if silent == 4 { error } else { 0 });
            let [sync, told] = [sync(master, period, predecessor), follow_up(master, period, sent_at)];
            for (frame, now) in [(sync, at(period * PERIOD)), (told, at(period * PERIOD + 300))] {
                follower.on_frame(&frame, now);
                other.on_frame(&frame, now);
                for now in [now, follower.next_wakeup().min(at((period + 1) * PERIOD - 1))] {
                    prop_assert_eq!(follower.next_wakeup(), other.next_wakeup());
                    prop_assert_eq!((follower.poll(now), other.poll(now)), (None, None));
                }
            }
            prop_assert_eq!(follower.clock(), other.clock());
            prop_assert_eq!(follower.master(), other.master());
            prop_assert_eq!(events(&mut follower), events(&mut other));
            prop_assert_eq!(follower.counters(), other.counters());
            used = follower.counters().used;
        }
        prop_assert!(used > 0 || period == 0);
    }

    /// Whatever stands in the frames and however late calls are: no panic, and no endless polling.
    #[test]
    fn arbitrary_frames_do_no_harm(
        rank in proptest::option::of(0u8..16),
        start in any::<u64>(),
        steps in proptest::collection::vec(
            (0u32..4, any::<bool>(), any::<[u8; 8]>(), 0usize..=8, any::<u64>(), 0u32..64), 0..60),
    ) {
        let config = SyncConfig { rank: rank.and_then(Rank::new), ..SyncConfig::DEFAULT };
        let mut now = Instant::from_epoch(Duration::from_ticks(start));
        let mut node: ClockSync = ClockSync::new(config, now).unwrap();
        node.set_tx_node(Some(OWN));
        for (sender, sync, mut bytes, len, span, shift) in steps {
            // Few sequence numbers and senders, so that frames make pairs.
            bytes[0] &= 0x1F;
            let etag = if sync { Etag::SYNC } else { Etag::FOLLOW_UP };
            let sender = TxNode::new(0x10 + sender as u8).unwrap();
            let id = Id::new(crate::can::Priority::SOFT_MOST_URGENT, sender, etag);
            node.on_frame(&Frame::new(id, Payload::truncated(bytes, len)), now);
            now = now + Duration::from_ticks(span >> shift);
            for polled in 0.. {
                prop_assert!(polled <= 2);
                let Some(frame) = node.poll(now) else { break };
                node.on_sent(&frame, now);
            }
            let _ = (node.next_wakeup(), node.clock().to_global(now), node.clock().accuracy(now));
            let _ = node.poll_event();
        }
    }
}
