//! The broker on any frames and calls: an id never belongs to two nodes, nor an etag to two subjects, and the
//! host's id to nobody else.
#![no_main]

use std::collections::BTreeSet;

use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core_fuzz::{Act, Script, check_wakeup, drain, subject, tx_node, uid};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    let mut broker = Broker::<5, 5>::new(uid(*first), BrokerTiming::DEFAULT, Nodes::new(), Subjects::new());
    let mut script = Script::new(bytes);
    let host = uid(*first);
    let mut host_id = tx_node(*first);
    broker.set_tx_node(script.now, host_id);
    while let Some(step) = script.next() {
        let now = script.now;
        match step {
            Act::Frame(frame) => broker.on_frame(&frame, now),
            Act::Call(0..=9, of) => {
                host_id = tx_node(of);
                broker.set_tx_node(now, host_id);
            }
            Act::Call(10..=19, of) if uid(of) != host => _ = broker.release_node(uid(of)),
            Act::Call(20..=29, of) => _ = broker.release_subject(subject(of)),
            Act::Call(..) | Act::Pause => {}
        }
        drain(now, || broker.poll(now), |_| {});
        check_wakeup(now, broker.next_wakeup());
        let owner = host_id.and_then(|id| broker.nodes().uid_of(id));
        assert!(owner.is_none_or(|owner| owner == host), "{owner:?} has the host's id");
        let uids: BTreeSet<_> = broker.nodes().entries().map(|(uid, _)| uid).collect();
        assert_eq!(uids.len(), broker.nodes().entries().count(), "a node with two ids");
        let subjects: BTreeSet<_> = broker.subjects().entries().map(|(subject, _)| subject).collect();
        assert_eq!(subjects.len(), broker.subjects().entries().count(), "a subject with two etags");
    }
});
