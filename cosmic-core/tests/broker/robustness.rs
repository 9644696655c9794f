//! Whatever arrives, whenever it is polled: no panic, an end to every `poll`, and a wake-up that lies
//! ahead. The fuzz targets of this crate look further.

use cosmic_core::broker::*;
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::time::{Duration, Instant};
use proptest::prelude::*;

use crate::ether::{subject, tx_node, uid};

fn frame() -> impl Strategy<Value = Frame> {
    let id = (250..=251u8, 0..=127u8, 0..=20u16).prop_map(|(priority, node, etag)| {
        Id::new(Priority::new(priority), TxNode::new(node).unwrap(), Etag::new(etag).unwrap())
    });
    let any_id = (0..1u32 << 29).prop_map(|raw| Id::from_raw(raw).unwrap());
    // Bytes that are likely to be the UIDs, subjects and ids of the test.
    let few = prop_oneof![Just(0u8), Just(1), Just(2), Just(0x3F), Just(0xFF), any::<u8>()];
    (prop_oneof![4 => id, 1 => any_id], proptest::collection::vec(few, 0..=8))
        .prop_map(|(id, data)| Frame::new(id, Payload::new(&data).unwrap()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_frames(steps in proptest::collection::vec((frame(), 0..2_000_000_000u64), 0..200), fixed: bool) {
        let mut now = Instant::EPOCH;
        let timing = ConfigurationTiming::DEFAULT;
        let mut configuration = match fixed {
            true => Configuration::fixed(now, uid(1), tx_node(1), 0, timing),
            false => Configuration::new(now, uid(1), 0, timing),
        };
        let mut binding = Binding::<2>::new(0, BindingTiming::DEFAULT);
        binding.bind(subject(1)).unwrap();
        binding.set_tx_node(Some(tx_node(1)));
        let mut broker = Broker::<3, 3>::new(uid(1), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
        broker.set_tx_node(now, Some(tx_node(1)));
        for (frame, pause) in steps {
            now = now + Duration::from_ticks(pause);
            configuration.on_frame(now, &frame);
            binding.on_frame(now, &frame);
            broker.on_frame(now, &frame);
            prop_assert!((0..1000).any(|_| configuration.poll(now).is_none()));
            prop_assert!((0..1000).any(|_| binding.poll(now).is_none()));
            prop_assert!((0..1000).any(|_| broker.poll(now).is_none()));
            for wakeup in [configuration.next_wakeup(), binding.next_wakeup(), broker.next_wakeup()] {
                prop_assert!(wakeup.is_none_or(|at| at > now));
            }
        }
    }
}
