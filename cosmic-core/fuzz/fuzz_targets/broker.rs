//! The broker on any frames and calls: an id never belongs to two nodes, nor an etag to two subjects.
#![no_main]

use std::collections::BTreeSet;

use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core_fuzz::{Script, Step, check_wakeup, drain, subject, tx_node, uid};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    let mut broker = Broker::<5, 5>::new(uid(*first), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
    let mut script = Script::new(bytes);
    broker.set_tx_node(script.now, tx_node(*first));
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Step::Frame(frame) => broker.on_frame(now, &frame),
            Step::Call(0..=9, of) => broker.set_tx_node(now, tx_node(of)),
            Step::Call(10..=19, of) => _ = broker.release_node(uid(of)),
            Step::Call(20..=29, of) => _ = broker.release_subject(subject(of)),
            Step::Call(..) | Step::Pause => {}
        }
        drain(now, || broker.poll(now), |_| {});
        check_wakeup(now, broker.next_wakeup());
        let uids: BTreeSet<_> = broker.nodes().entries().map(|(uid, _)| uid).collect();
        assert_eq!(uids.len(), broker.nodes().entries().count(), "a node with two ids");
        let subjects: BTreeSet<_> = broker.subjects().entries().map(|(subject, _)| subject).collect();
        assert_eq!(subjects.len(), broker.subjects().entries().count(), "a subject with two etags");
    }
});
