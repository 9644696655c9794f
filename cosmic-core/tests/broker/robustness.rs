//! Whatever arrives, whenever it is polled: no panic, an end to every `poll`, and a wake-up that lies
//! ahead; and nothing is broken for good. The fuzz targets of this crate look further.

use std::collections::VecDeque;

use cosmic_core::broker::*;
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::client::*;
use cosmic_core::time::{Duration, Instant};
use proptest::prelude::*;

use crate::ether::{Ether, Node, Station, subject, tx_node, uid};

fn frame() -> impl Strategy<Value = Frame> {
    let id = (250..=251u8, 0..=127u8, 0..=22u16).prop_map(|(priority, node, etag)| {
        Id::new(Priority::new(priority), TxNode::new(node).unwrap(), Etag::new(etag).unwrap())
    });
    let any_id = (0..1u32 << 29).prop_map(|raw| Id::from_raw(raw).unwrap());
    // Bytes that are likely to be the UIDs, subjects and ids of the test.
    let few = prop_oneof![Just(0u8), Just(1), Just(2), Just(0x3F), Just(0xFF), any::<u8>()];
    (prop_oneof![4 => id, 1 => any_id], proptest::collection::vec(few, 0..=8))
        .prop_map(|(id, data)| Frame::new(id, Payload::new(&data).unwrap()))
}

/// Sends what it has, a frame a millisecond, and then nothing more.
struct Stranger {
    frames: VecDeque<Frame>,
    next_at: Instant,
}

impl Station for Stranger {
    fn on_frame(&mut self, _: &Frame, _: Instant) {}

    fn poll(&mut self, now: Instant, outbox: &mut VecDeque<Frame>) {
        if now >= self.next_at {
            outbox.extend(self.frames.pop_front());
            self.next_at = now + Duration::from_millis(1);
        }
    }

    fn next_wakeup(&self) -> Instant {
        if self.frames.is_empty() { Instant::FAR_FUTURE } else { self.next_at }
    }
}

/// A control frame: any reserved etag, TxNode and length, of this cluster's names or any others.
fn control_frame() -> impl Strategy<Value = Frame> {
    let etag = prop_oneof![4 => 0..=22u16, 1 => 0..=99u16];
    let node = prop_oneof![Just(1u8), Just(0x7E), Just(0x7F), 0..=0x7Fu8];
    let id = (250..=251u8, node, etag).prop_map(|(priority, node, etag)| {
        Id::new(Priority::new(priority), TxNode::new(node).unwrap(), Etag::new(etag).unwrap())
    });
    let name = prop_oneof![Just(0xB0u64), Just(0x100), Just(0x101), Just(1), Just(2), any::<u64>()];
    let data = prop_oneof![
        4 => name.prop_map(|name| name.to_be_bytes().to_vec()),
        // A half of a binding.
        4 => (0..=0x7Fu8, 0..=5u8, 0x3FF0..=0x3FFFu16, 0..=2u8).prop_map(|(node, half, etag, end)| {
            vec![node, half, (etag >> 8) as u8, etag as u8, 0, 0, 0, if half % 2 == 0 { 0 } else { end }]
        }),
        1 => proptest::collection::vec(any::<u8>(), 0..=8),
    ];
    (id, data).prop_map(|(id, data)| Frame::new(id, Payload::new(&data).unwrap()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Whatever frames a stranger sends, before or after the others have their names: when it is silent, the
    /// cluster works again, or goes on.
    #[test]
    fn what_a_stranger_breaks_heals(
        frames in proptest::collection::vec(control_frame(), 1..40), late: bool, seed: u64,
    ) {
        let second = Duration::from_secs(1);
        let mut ether = Ether::new(seed);
        ether.add(Node::fixed(ether.now, 0xB0, 1, seed).hosting(Nodes::new(), Subjects::new()));
        for of in 0..2 {
            ether.add(Node::asking(ether.now, 0x100 + of, seed ^ of).with_subjects([1, 2 + of]));
        }
        if late {
            ether.run(second * 2);
        }
        ether.add(Stranger { frames: frames.into(), next_at: ether.now });
        // What it seemed to have handed out as a broker is kept for a minute.
        ether.run(second * 65);
        prop_assert_eq!(ether.node(0).role(), BrokerRole::Active);
        // A newcomer is served.
        let newcomer = ether.add(Node::asking(ether.now, 0x102, seed ^ 2).with_subjects([1, 4]));
        ether.run(second * 30);
        let mut ids: Vec<_> = ether.nodes().filter_map(Node::tx_node).collect();
        ids.sort_unstable();
        ids.dedup();
        prop_assert_eq!(ids.len(), 4);
        let shared = ether.node(newcomer).etag_of(1);
        prop_assert!(shared.is_some() && ether.node(newcomer).etag_of(4).is_some());
        for at in 1..=2 {
            prop_assert_eq!(ether.node(at).etag_of(1), shared);
            prop_assert!(ether.node(at).etag_of(1 + at as u64).is_some());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_frames(steps in proptest::collection::vec((frame(), 0..2_000_000_000u64), 0..200), fixed: bool) {
        let mut now = Instant::EPOCH;
        let timing = &ConfigurationTiming::DEFAULT;
        let mut configuration = match fixed {
            true => Configuration::fixed(now, uid(1), tx_node(1), 0, timing),
            false => Configuration::new(now, uid(1), 0, timing),
        };
        let mut binding = Binding::<2>::new(0, &BindingTiming::DEFAULT);
        binding.bind(subject(1)).unwrap();
        binding.set_tx_node(Some(tx_node(1)));
        let mut broker = Broker::<3, 3>::new(uid(1), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
        broker.set_tx_node(now, Some(tx_node(1)));
        for (frame, pause) in steps {
            now = now + Duration::from_ticks(pause);
            configuration.on_frame(&frame, now);
            binding.on_frame(&frame, now);
            broker.on_frame(&frame, now);
            prop_assert!((0..1000).any(|_| configuration.poll(now).is_none()));
            prop_assert!((0..1000).any(|_| binding.poll(now).is_none()));
            prop_assert!((0..1000).any(|_| broker.poll(now).is_none()));
            for wakeup in [configuration.next_wakeup(), binding.next_wakeup(), broker.next_wakeup()] {
                prop_assert!(wakeup > now);
            }
        }
    }
}
