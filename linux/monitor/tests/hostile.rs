//! Whatever the bus sends, and whatever the clock of the listener does: no panic, and bounded memory.

use cosmic_bus::WireFrame;
use cosmic_core::can::{BitRate, ErrorCounters, Frame, Id, Payload};
use cosmic_core::time::{Duration, Instant};
use cosmic_monitor::{MOST_CHANNELS, MOST_NOTICES, MOST_PARTICIPANTS, Monitor, SegmentPlan};
use cosmic_plan::document::Source;
use embedded_can::{ExtendedId, Frame as _};
use proptest::prelude::*;

/// A frame that is mostly one of the protocol, or nearly.
fn frame() -> impl Strategy<Value = Frame> {
    let etag = prop_oneof![4 => 0_u32..22, 1 => 100_u32..110, 2 => 16_300_u32..16_384, 1 => 0_u32..1 << 14];
    let priority = prop_oneof![4 => Just(250_u32), 2 => Just(1_u32), 1 => Just(0_u32), 1 => 0_u32..256];
    let tx_node = prop_oneof![2 => 0_u32..4, 1 => 0_u32..128];
    let bytes = prop_oneof![1 => any::<[u8; 8]>(), 2 => (0_u8..6, 0_u8..6, any::<[u8; 6]>()).prop_map(small)];
    let length = prop_oneof![5 => Just(8_usize), 1 => 0_usize..9];
    (priority, tx_node, etag, bytes, length).prop_map(|(priority, tx_node, etag, bytes, length)| {
        let id = Id::masked(priority << 21 | tx_node << 14 | etag);
        Frame::new(id, Payload::truncated(bytes, length))
    })
}

fn small((first, second, [a, b, c, d, e, f]): (u8, u8, [u8; 6])) -> [u8; 8] {
    [first, second, a, b, c, d, e, f]
}

fn plan() -> SegmentPlan {
    SegmentPlan::parse(&Source::new("vehicle.toml", cosmic_plan::cluster::EXAMPLE)).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_frames_at_any_instants(
        frames in proptest::collection::vec((frame(), any::<u16>(), 0_u8..40), 1..400),
        leap in any::<u64>(),
        planned in any::<bool>(),
    ) {
        let mut monitor = match planned {
            true => Monitor::with_plan(plan(), Instant::EPOCH),
            false => Monitor::new(BitRate::MAX, Instant::EPOCH),
        };
        let mut at = 0_u64;
        for (frame, pause_us, what) in frames {
            at = match what {
                38 => at.wrapping_add(leap),
                39 => at.wrapping_sub(leap),
                _ => at.wrapping_add(u64::from(pause_us) * 1_000),
            };
            let instant = Instant::from_epoch(Duration::from_ticks(at));
            match what {
                0 => monitor.on_lost(pause_us.into(), instant),
                1 => monitor.on_bus_off(instant),
                2 => monitor.on_errors(ErrorCounters { transmit: pause_us as u8, receive: (pause_us >> 8) as u8 }, instant),
                3 => monitor.on_foreign(WireFrame::new_remote(ExtendedId::ZERO, 8).as_ref(), instant),
                4 => monitor.on_foreign(None, instant),
                _ => monitor.on_frame(&frame, instant),
            }
            prop_assert!(!monitor.decode(&frame).to_string().is_empty());
        }
        let instant = Instant::from_epoch(Duration::from_ticks(at));
        for finding in monitor.doctor(instant) {
            prop_assert!(!finding.what.is_empty() && !finding.remedy.is_empty());
        }
        let snapshot = monitor.snapshot(instant);
        prop_assert!(snapshot.nodes.len() <= 128 && monitor.notices(0).count() <= MOST_NOTICES);
        prop_assert!(serde_json::to_string(&snapshot).is_ok());
    }
}

#[test]
fn a_bus_full_of_new_names_is_held_within_the_bounds() {
    let mut monitor = Monitor::new(BitRate::MAX, Instant::EPOCH);
    // 25 s of a saturated bus: every frame has another channel, publisher, subscriber.
    for number in 0_u32..200_000 {
        let scattered = number.wrapping_mul(2_654_435_761);
        let at = Instant::from_epoch(Duration::from_micros(u64::from(number) * 125));
        let etag = scattered % 16_384;
        let publishes =
            Frame::new(Id::masked((255 << 21) | (((scattered >> 8) % 127) << 14) | etag), Payload::EMPTY);
        // Interest of the longest lease, as a subscriber.
        let subscribes = [(etag >> 8) as u8 & 0x3F, etag as u8, 0x7F, 0xFF, 0, 0, 0, 0];
        let subscribes = Frame::new(
            Id::masked((250 << 21) | (((scattered >> 9) % 127) << 14) | 18),
            Payload::full(subscribes),
        );
        monitor.on_frame(if number.is_multiple_of(2) { &publishes } else { &subscribes }, at);
    }
    let snapshot = monitor.snapshot(Instant::from_epoch(Duration::from_secs(25)));
    assert_eq!(snapshot.channels.len(), MOST_CHANNELS);
    let participants: usize =
        snapshot.channels.iter().map(|channel| channel.publishers.len() + channel.subscribers.len()).sum();
    assert!(participants <= MOST_PARTICIPANTS, "{participants}");
    assert!(snapshot.overlooked > 0, "and what found no place is counted");
    assert_eq!(snapshot.link.received, 200_000);
}
