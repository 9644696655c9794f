//! Masters that tell absurd instants, and time scales that come to their end; by literal frames.

use cosmic_core::can::{Frame, Id, Payload, TxNode};
use cosmic_core::protocol::{FollowUp, Rank};
use cosmic_core::sync::{ClockEvent, ClockSync, SyncConfig};
use cosmic_core::time::{Duration, GlobalInstant, Instant};

const OWN: TxNode = TxNode::new(0x12).unwrap();
const FALSE_MASTER: TxNode = TxNode::new(0x10).unwrap();
const PERIOD: u64 = 100_000_000;
const END: u64 = 1 << 59;

fn at(nanoseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_ticks(nanoseconds))
}

fn frame(raw: u32, bytes: [u8; 8]) -> Frame {
    Frame::new(Id::from_raw(raw).unwrap(), Payload::full(bytes))
}

fn node(rank: u8) -> ClockSync {
    let mut node =
        ClockSync::new(SyncConfig { rank: Rank::new(rank), ..SyncConfig::DEFAULT }, at(0)).unwrap();
    node.set_tx_node(Some(OWN));
    node
}

/// A sync frame of 0x10, of rank 0, and its follow-up that tells `instant`; at most 60 bits.
fn tell(node: &mut ClockSync, number: u8, instant: u64, received_at: u64) {
    let number = number % 16;
    node.on_frame(&frame(0x0024_0010, [number << 4, 0x10, 0, 0, 0, 0, 0, 0]), at(received_at));
    let [b0, rest @ ..] = instant.to_be_bytes();
    let [b1, b2, b3, b4, b5, b6, b7] = rest;
    let told = frame(0x0024_0011, [number << 4 | b0, b1, b2, b3, b4, b5, b6, b7]);
    node.on_frame(&told, at(received_at + 300_000));
}

fn events(node: &mut ClockSync) -> Vec<ClockEvent> {
    core::iter::from_fn(|| node.poll_event()).collect()
}

/// Lets a node that is alone be or become master until `end`, whose frames are all sent at once. Returns the
/// instants that it told, with the local ones.
fn run(node: &mut ClockSync, mut now: u64, end: u64) -> Vec<(u64, u64)> {
    let mut told = Vec::new();
    while now < end {
        while let Some(frame) = node.poll(at(now)) {
            node.on_sent(&frame, at(now + 160_000));
            if let Some(follow_up) = FollowUp::decode(&frame) {
                told.push((now, follow_up.sent_at.since_epoch().as_ticks()));
            }
        }
        now = node.next_wakeup().since_epoch().as_ticks().max(now + 1_000_000).min(end);
    }
    told
}

#[test]
fn two_frames_just_below_the_wrap_do_not_move_anybody() {
    for rank in [0, 1] {
        // A master, and one who would be the next; both know better.
        let mut node = node(rank);
        let before = run(&mut node, 0, 20 * PERIOD);
        assert!(node.is_master());
        let clock = node.clock();
        events(&mut node);
        for (number, instant) in [(0, (1 << 60) - PERIOD), (1, (1 << 60) - 1), (2, END)] {
            tell(&mut node, number, instant, (20 + u64::from(number)) * PERIOD);
        }
        assert_eq!(events(&mut node), [ClockEvent::OutOfRange { master: FALSE_MASTER }]);
        assert_eq!((node.counters().out_of_range, node.counters().used), (3, 0));
        assert!(node.is_master());
        assert_eq!(node.clock(), clock);
        assert!(!before.is_empty());
    }
}

#[test]
fn a_follower_does_not_follow_its_master_out_of_range() {
    let mut node = node(1);
    for period in 0..10 {
        tell(&mut node, period, 5_000_000_000 + u64::from(period) * PERIOD, u64::from(period) * PERIOD);
    }
    assert_eq!(node.master(), Some(FALSE_MASTER));
    for period in 10..14 {
        tell(&mut node, period, END + u64::from(period) * PERIOD, u64::from(period) * PERIOD);
    }
    assert_eq!(node.counters().out_of_range, 4);
    // It has heard no master since the last good pair, and takes over.
    let told = run(&mut node, 14 * PERIOD, 16 * PERIOD);
    assert!(node.is_master());
    let (local, global) = told[0];
    assert!((5_000_159_000..5_000_161_000).contains(&(global - local)));
    assert!(events(&mut node).contains(&ClockEvent::BecameMaster { continued: true }));
}

#[test]
fn a_time_scale_that_comes_to_its_end_is_not_continued() {
    // The last instants that are accepted: two seconds before the end, then the false master is gone.
    let mut node = node(1);
    for period in 0..10 {
        let instant = END - 2_000_000_000 + u64::from(period) * PERIOD;
        tell(&mut node, period, instant, u64::from(period) * PERIOD);
    }
    assert_eq!((node.counters().used, node.counters().out_of_range), (10, 0));
    let told = run(&mut node, 10 * PERIOD, 60 * PERIOD);
    assert!(node.is_master());
    assert!(events(&mut node).contains(&ClockEvent::BecameMaster { continued: false }));
    // Anew from the origin, and in step with local time from there on.
    let (begun, first) = told[0];
    assert!(first < PERIOD, "{first}");
    assert!(told.iter().all(|(local, global)| global - first == local - begun));
    let now = at(60 * PERIOD);
    assert!(node.clock().is_synchronised(now));
    assert!(node.clock().to_global(now) < GlobalInstant::from_epoch(Duration::from_secs(10)));
}

#[test]
fn a_master_starts_anew_before_the_end() {
    // It continues a time scale that stands 30 s before the end.
    let mut node = node(1);
    for period in 0..10 {
        let instant = END - 30_000_000_000 + u64::from(period) * PERIOD;
        tell(&mut node, period, instant, u64::from(period) * PERIOD);
    }
    let told = run(&mut node, 10 * PERIOD, 400 * PERIOD);
    assert_eq!(
        events(&mut node),
        [
            ClockEvent::MasterChanged { master: FALSE_MASTER, continued: false },
            ClockEvent::MasterLost { master: FALSE_MASTER },
            ClockEvent::BecameMaster { continued: true },
            ClockEvent::Exhausted,
        ]
    );
    assert!(told.iter().all(|(_, global)| *global < END));
    let step = told.windows(2).position(|pair| pair[1].1 < pair[0].1).unwrap();
    assert!(told[step].1 > END - 4 * PERIOD && told[step + 1].1 < PERIOD);
    assert!(told[step + 1..].is_sorted());
    // After the seven periods of the handover the new scale is relied on.
    assert!(node.clock().is_synchronised(at(400 * PERIOD)));

    // A follower believes the step at the third pair, and is synchronised again six periods later.
    let mut follower = self::node(2);
    for (number, (local, global)) in told.iter().enumerate() {
        tell(&mut follower, number as u8, *global, *local);
    }
    let now = at(told.last().unwrap().0);
    assert!(follower.clock().is_synchronised(now));
    let expected = GlobalInstant::from_epoch(Duration::from_ticks(told.last().unwrap().1));
    assert!(follower.clock().to_global(now).signed_since(expected).abs() < 2_000);
}
