//! Configuration and binding on a whole cluster: clients and brokers under the faults that we can name.

mod binding;
mod brokers;
mod configuration;
mod ether;
mod famouso;
mod robustness;

use std::collections::BTreeSet;

use cosmic_core::broker::*;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::client::*;
use cosmic_core::time::Duration;
use ether::*;

const SECOND: Duration = Duration::from_secs(1);

/// A bus with an active broker on a node with the fixed id 1.
fn with_broker(seed: u64) -> Ether {
    let mut ether = Ether::new(seed);
    let host = Node::fixed(ether.now, 0xB0, 1, seed).hosting(Nodes::new(), Subjects::new());
    ether.add(host);
    ether.run_until(SECOND, |ether| ether.node(0).role() == BrokerRole::Active);
    ether
}

fn all_configured(ether: &Ether) -> bool {
    ether.nodes().all(|node| node.tx_node().is_some())
}

/// No two nodes that are alive have the same id.
fn assert_ids_differ(ether: &Ether) {
    let ids: Vec<TxNode> = ether.nodes().filter_map(Node::tx_node).collect();
    let different: BTreeSet<TxNode> = ids.iter().copied().collect();
    assert_eq!(ids.len(), different.len(), "two nodes have one id: {ids:?}");
}

#[test]
fn a_node_gets_its_id_in_32_frames() {
    let mut ether = with_broker(1);
    ether.run(Duration::from_millis(10));
    ether.log.clear();
    let at = ether.add(Node::asking(ether.now, 0x0123_4567_89AB_CDEF, 7));
    let took = ether.run_until(SECOND, all_configured);
    assert_eq!(ether.node(at).tx_node(), Some(TxNode::MAX));
    let frames = ether.log.iter().filter(|frame| frame.id.etag() <= Etag::CONFIGURATION_REQUEST).count();
    assert_eq!(frames, 32);
    assert!(took < Duration::from_millis(100), "{took}");
}

#[test]
fn twenty_nodes_boot_at_once() {
    for seed in 0..20 {
        for faults in [
            Faults::default(),
            Faults { lost: 50, ..Faults::default() },
            Faults { twice: 200, late: 50, ..Faults::default() },
            Faults { lost: 20, twice: 20, late: 20 },
        ] {
            let mut ether = Ether::new(seed);
            ether.faults = faults;
            // The host takes no id of the broker's, so nineteen ask; their UIDs share long prefixes.
            ether.add(Node::fixed(ether.now, 0xB0, 1, seed).hosting(Nodes::new(), Subjects::new()));
            for at in 0..19 {
                let uid = 0xC051_0000_0000_0000 | (at % 4) << 32 | at;
                ether.add(Node::asking(ether.now, uid, seed ^ at).with_subjects([1, 2 + at % 3]));
            }
            ether.run_until(SECOND * 60, |ether| {
                all_configured(ether) && ether.nodes().skip(1).all(|node| node.etag_of(1).is_some())
            });
            ether.run_until(SECOND * 30, |ether| {
                let mut nodes = ether.nodes().skip(1).enumerate();
                nodes.all(|(at, node)| node.etag_of(2 + at as u64 % 3).is_some())
            });
            ether.run(SECOND * 2);
            assert!(all_configured(&ether), "seed {seed}");
            assert_ids_differ(&ether);
            let shared: BTreeSet<_> = ether.nodes().skip(1).map(|node| node.etag_of(1)).collect();
            assert_eq!(shared.len(), 1, "one subject has one etag, seed {seed}");
        }
    }
}

#[test]
fn nineteen_nodes_boot_fast_on_a_sound_bus() {
    let mut ether = with_broker(3);
    for at in 0..19 {
        ether.add(Node::asking(ether.now, 0xC051_0000 + at, at));
    }
    let took = ether.run_until(SECOND * 10, all_configured);
    assert!(took < Duration::from_millis(1000), "{took}");
}

#[test]
fn a_node_that_dies_in_the_middle_does_not_block_the_others() {
    // The smallest UID wins each stage, and dies after some frames.
    for frames in 1..32 {
        let mut ether = with_broker(4);
        let dying = ether.add(Node::asking(ether.now, 0x1000, 1));
        ether.log.clear();
        ether.run_until(SECOND, |ether| ether.log.len() >= frames);
        ether.kill(dying);
        ether.add(Node::asking(ether.now, 0x1001, 2));
        ether.add(Node::asking(ether.now, 0x2000, 3));
        ether.run_until(SECOND * 3, all_configured);
        assert_ids_differ(&ether);
    }
}

#[test]
fn a_node_that_comes_back_has_its_id_again() {
    let mut ether = with_broker(5);
    let at = ether.add(Node::asking(ether.now, 0x11, 1));
    ether.run_until(SECOND, all_configured);
    let id = ether.node(at).tx_node();
    ether.add(Node::asking(ether.now, 0x22, 2));
    ether.run_until(SECOND, all_configured);
    ether.replace(at, Node::asking(ether.now, 0x11, 3));
    ether.run_until(SECOND, all_configured);
    assert_eq!(ether.node(at).tx_node(), id);
}

/// A broker on station 0, and five nodes with two subjects each.
fn five_nodes(seed: u64) -> Ether {
    let mut ether = with_broker(seed);
    for at in 0..5 {
        ether.add(Node::asking(ether.now, 0x100 + at, seed ^ at).with_subjects([1, 10 + at]));
    }
    ether.run_until(SECOND * 5, |ether| {
        let bound =
            |(at, node): (usize, &Node)| node.etag_of(1).is_some() && node.etag_of(10 + at as u64).is_some();
        all_configured(ether) && ether.nodes().skip(1).enumerate().all(bound)
    });
    ether
}

#[test]
fn a_broker_restarts_with_its_table() {
    let mut ether = five_nodes(6);
    let (mut nodes, mut subjects) = (Nodes::new(), Subjects::new());
    let broker = ether.node(0).broker.as_ref().unwrap();
    broker.nodes().entries().for_each(|(uid, id)| nodes.restore(uid, id).unwrap());
    broker.subjects().entries().for_each(|(subject, etag)| subjects.restore(subject, etag).unwrap());
    let (ids, etags): (Vec<_>, Vec<_>) =
        (1..6).map(|at| (ether.node(at).tx_node(), ether.node(at).etag_of(9 + at as u64))).unzip();
    // All nodes are off while the broker starts, so the table is all that is known.
    (0..6).for_each(|at| ether.kill(at));
    ether.run(SECOND);
    ether.replace(0, Node::fixed(ether.now, 0xB0, 1, 0).hosting(nodes, subjects));
    ether.run_until(SECOND, |ether| ether.node(0).role() == BrokerRole::Active);
    for at in (0..5).rev() {
        let node = Node::asking(ether.now, 0x100 + at, at).with_subjects([10 + at]);
        ether.replace(1 + at as usize, node);
        ether.run_until(SECOND, |ether| ether.node(1 + at as usize).etag_of(10 + at).is_some());
    }
    for at in 1..6 {
        assert_eq!(ether.node(at).tx_node(), ids[at - 1]);
        assert_eq!(ether.node(at).etag_of(9 + at as u64), etags[at - 1]);
    }
}

#[test]
fn a_broker_that_lost_its_table_learns_it_from_the_nodes() {
    for seed in 0..10 {
        let mut ether = five_nodes(seed);
        let before: Vec<_> = ether.node(0).broker.as_ref().unwrap().subjects().entries().collect();
        let shared = ether.node(1).etag_of(1);
        ether.replace(0, Node::fixed(ether.now, 0xB0, 1, 1).hosting(Nodes::new(), Subjects::new()));
        for at in 0..3 {
            ether.add(Node::asking(ether.now, 0x50 + at, at).with_subjects([1, 20 + at]));
        }
        ether.run_until(SECOND * 5, |ether| {
            let bound = |at: u64| ether.node(6 + at as usize).etag_of(20 + at).is_some();
            all_configured(ether) && (0..3).all(bound)
        });
        assert_ids_differ(&ether);
        let after: Vec<_> = ether.node(0).broker.as_ref().unwrap().subjects().entries().collect();
        assert!(before.iter().all(|pair| after.contains(pair)), "{before:?} {after:?}");
        assert_eq!(ether.node(6).etag_of(1), shared);
        assert!(ether.nodes().all(|node| node.configuration_events.len() <= 1), "nobody lost its id");
    }
}

#[test]
fn a_standby_takes_over_with_the_same_table() {
    for seed in 0..10 {
        let mut ether = five_nodes(seed);
        // A standby that comes late, on a node that got its id from the active broker.
        let standby = ether.add(Node::asking(ether.now, 0xB1, 1).hosting(Nodes::new(), Subjects::new()));
        ether.run_until(SECOND, |ether| ether.node(standby).role() == BrokerRole::Standby);
        // This one is configured and bound while it stands by.
        let late = ether.add(Node::asking(ether.now, 0x200, 1).with_subjects([30]));
        ether.run_until(SECOND, |ether| ether.node(late).etag_of(30).is_some());
        let active = ether.node(0).broker.as_ref().unwrap();
        let nodes: BTreeSet<_> = active.nodes().entries().filter(|(of, _)| *of != uid(0xB0)).collect();
        let subjects: BTreeSet<_> = active.subjects().entries().collect();
        ether.kill(0);
        let took = ether.run_until(SECOND * 3, |ether| ether.node(standby).role() == BrokerRole::Active);
        assert!(took > Duration::from_millis(900), "{took}");
        let mirror = ether.node(standby).broker.as_ref().unwrap();
        assert_eq!(mirror.nodes().entries().collect::<BTreeSet<_>>(), nodes);
        assert_eq!(mirror.subjects().entries().collect::<BTreeSet<_>>(), subjects);
        // It serves, and goes on when the first one comes back.
        let newest = ether.add(Node::asking(ether.now, 0x201, 2).with_subjects([1, 31]));
        ether.run_until(SECOND * 3, |ether| ether.node(newest).etag_of(31).is_some());
        assert_eq!(ether.node(newest).etag_of(1), ether.node(1).etag_of(1));
        ether.replace(0, Node::fixed(ether.now, 0xB0, 1, 9).hosting(Nodes::new(), Subjects::new()));
        ether.run(SECOND * 5);
        // It hears the active one before it becomes active itself.
        assert_eq!(
            [ether.node(0).role(), ether.node(standby).role()],
            [BrokerRole::Standby, BrokerRole::Active]
        );
        assert_ids_differ(&ether);
    }
}

#[test]
fn of_two_brokers_that_start_together_one_stands_by() {
    for seed in 0..20 {
        let mut ether = Ether::new(seed);
        ether.faults = Faults { lost: 20, ..Faults::default() };
        ether.add(Node::fixed(ether.now, 0xB5, 1, seed).hosting(Nodes::new(), Subjects::new()));
        ether.add(Node::fixed(ether.now, 0xB0, 2, seed + 1).hosting(Nodes::new(), Subjects::new()));
        for at in 0..8 {
            ether.add(Node::asking(ether.now, 0x100 + at, at).with_subjects([1, 2 + at]));
        }
        ether.run_until(SECOND * 30, |ether| {
            let nodes = || ether.nodes().skip(2).enumerate();
            all_configured(ether) && nodes().all(|(at, node)| node.etag_of(2 + at as u64).is_some())
        });
        ether.run(SECOND * 3);
        let roles = [ether.node(0).role(), ether.node(1).role()];
        assert!(
            matches!(
                roles,
                [BrokerRole::Active, BrokerRole::Standby] | [BrokerRole::Standby, BrokerRole::Active]
            ),
            "{roles:?}"
        );
        assert_ids_differ(&ether);
    }
}

#[test]
fn two_halves_of_a_bus_come_together() {
    for seed in 0..10 {
        let mut ether = Ether::new(seed);
        ether.add(Node::fixed(ether.now, 0xB5, 1, seed).hosting(Nodes::new(), Subjects::new()));
        ether.add(Node::fixed(ether.now, 0xB0, 2, seed).hosting(Nodes::new(), Subjects::new()));
        for at in 0..6 {
            // Subject 1 and two of one's own: the halves hand out the same ids and etags.
            ether.add(Node::asking(ether.now, 0x100 + at, at).with_subjects([2 + at, 1, 12 + at]));
        }
        (0..8).for_each(|at| ether.move_to_segment(at, at as u8 % 2));
        let bound = |ether: &Ether| {
            let of = |(at, node): (usize, &Node)| {
                [1, 2 + at as u64, 12 + at as u64].iter().all(|of| node.etag_of(*of).is_some())
            };
            all_configured(ether) && ether.nodes().skip(2).enumerate().all(of)
        };
        ether.run_until(SECOND * 5, bound);
        (0..8).for_each(|at| ether.move_to_segment(at, 0));
        ether.run(SECOND * 15);
        assert_eq!(
            [ether.node(0).role(), ether.node(1).role()],
            [BrokerRole::Standby, BrokerRole::Active],
            "seed {seed}"
        );
        assert!(bound(&ether), "seed {seed}");
        assert_ids_differ(&ether);
        assert_etags_agree(&ether, 20);
    }
}

/// Whatever is lost at whatever moment: the tables agree in the end, while frames are still lost.
#[test]
fn halves_of_a_bus_agree_in_the_end_though_frames_are_lost() {
    for seed in 0..1000 {
        let mut ether = Ether::new(seed);
        ether.faults = Faults { lost: 10 * (seed % 7), ..Faults::default() };
        ether.add(Node::fixed(ether.now, 0xB5, 1, seed).hosting(Nodes::new(), Subjects::new()));
        ether.add(Node::fixed(ether.now, 0xB0, 2, seed).hosting(Nodes::new(), Subjects::new()));
        for at in 0..6 {
            ether.add(Node::asking(ether.now, 0x100 + at, at).with_subjects([2 + at % 3, 1, 12 + at]));
        }
        (0..8).for_each(|at| ether.move_to_segment(at, at as u8 % 2));
        ether.run(SECOND * 2);
        (0..8).for_each(|at| ether.move_to_segment(at, 0));
        ether.run(SECOND * 30);
        assert_eq!(
            [ether.node(0).role(), ether.node(1).role()],
            [BrokerRole::Standby, BrokerRole::Active],
            "seed {seed}"
        );
        assert!(all_configured(&ether), "seed {seed}");
        assert_ids_differ(&ether);
        assert_etags_agree(&ether, 20);
    }
}

/// All nodes that know a subject have the same etag for it, and no two subjects have one etag.
fn assert_etags_agree(ether: &Ether, subjects: u64) {
    let mut used = BTreeSet::new();
    for subject in 1..=subjects {
        let etags: BTreeSet<Etag> = ether.nodes().filter_map(|node| node.etag_of(subject)).collect();
        assert!(etags.len() <= 1, "subject {subject} has the etags {etags:?}");
        for etag in etags {
            assert!(used.insert(etag), "etag {etag:?} belongs to two subjects");
        }
    }
}

#[test]
fn of_two_nodes_with_one_uid_only_one_works() {
    for seed in 0..20 {
        let mut ether = with_broker(seed);
        let first = ether.add(Node::asking(ether.now, 0x77, 1));
        // Together, or the second one later.
        if seed % 2 == 0 {
            ether.run_until(SECOND, all_configured);
        }
        let second = ether.add(Node::asking(ether.now, 0x77, 2));
        ether.run(SECOND * 20);
        assert_ids_differ(&ether);
        let working = [first, second].map(|at| ether.node(at).tx_node().is_some());
        assert_eq!(working.iter().filter(|works| **works).count(), 1, "seed {seed}: {working:?}");
        if seed % 2 == 0 {
            assert_eq!(working, [true, false], "the one that was there keeps its id");
        }
        for at in [first, second] {
            let told = ether.node(at).configuration_events.iter().any(
                |event| matches!(event, ConfigurationEvent::Conflict { other: Some(other), .. } if *other == uid(0x77)),
            );
            assert!(told, "seed {seed}: both are told");
        }
    }
}

#[test]
fn of_two_nodes_with_one_fixed_id_only_one_works() {
    for seed in 0..20 {
        let mut ether = Ether::new(seed); // no broker at all
        let first = ether.add(Node::fixed(ether.now, 0x71, 5, seed));
        if seed % 2 == 0 {
            ether.run_until(SECOND, all_configured);
        }
        let second = ether.add(Node::fixed(ether.now, 0x70, 5, seed + 100));
        ether.run(SECOND * 20);
        let working = [first, second].map(|at| ether.node(at).tx_node().is_some());
        assert_eq!(working.iter().filter(|works| **works).count(), 1, "seed {seed}: {working:?}");
        if seed % 2 == 0 {
            assert_eq!(working, [true, false], "the one that was there keeps its id");
        }
    }
}

#[test]
fn a_broker_that_does_not_know_a_fixed_node_finds_another_id() {
    let mut ether = with_broker(9);
    // The broker's first choice is in use on the other side of a cut.
    let fixed = ether.add(Node::fixed(ether.now, 0x10, TxNode::MAX.get(), 1));
    ether.move_to_segment(fixed, 1);
    ether.run_until(SECOND, |ether| ether.node(fixed).tx_node().is_some());
    ether.move_to_segment(fixed, 0);
    let asking = ether.add(Node::asking(ether.now, 0x20, 2));
    ether.run_until(SECOND * 5, all_configured);
    assert_eq!(ether.node(fixed).tx_node(), Some(TxNode::MAX));
    assert_eq!(ether.node(asking).tx_node(), TxNode::new(0x7D));
}

#[test]
fn a_cluster_without_a_broker() {
    let mut ether = Ether::new(1);
    for at in 0..10u8 {
        ether.add(Node::fixed(ether.now, 0x10 + u64::from(at), at, 1));
    }
    let took = ether.run_until(SECOND, all_configured);
    assert!(took < Duration::from_millis(100));
    assert_ids_differ(&ether);
}

#[test]
fn no_id_left() {
    let mut ether = with_broker(10);
    for at in 0..22 {
        ether.add(Node::asking(ether.now, 0x100 + at, at));
    }
    ether.run(SECOND * 20);
    assert_eq!(ether.nodes().skip(1).filter(|node| node.tx_node().is_some()).count(), 20);
    let refused: Vec<usize> = (1..=22).filter(|at| ether.node(*at).tx_node().is_none()).collect();
    for at in &refused {
        assert!(ether.node(*at).configuration_events.contains(&ConfigurationEvent::Refused));
    }
    assert!(ether.node(0).broker.as_ref().unwrap().counters().no_id_left >= 2);
    // One leaves, and one of those that wait gets its id.
    let leaves = (1..=22).find(|at| ether.node(*at).tx_node().is_some()).unwrap();
    ether.node_mut(leaves).configuration.release();
    ether.run(SECOND * 10);
    assert_eq!(refused.iter().filter(|at| ether.node(**at).tx_node().is_some()).count(), 1);
    assert_ids_differ(&ether);
}

#[test]
fn no_etag_left() {
    let mut ether = with_broker(11);
    let first = ether.add(Node::asking(ether.now, 0x100, 1).with_subjects(1..=8));
    let second = ether.add(Node::asking(ether.now, 0x101, 2).with_subjects(11..=18));
    let third = ether.add(Node::asking(ether.now, 0x102, 3).with_subjects([1, 21]));
    ether.run(SECOND * 5);
    let bound = |ether: &Ether, at: usize, mut of: std::ops::RangeInclusive<u64>| {
        of.all(|of| ether.node(at).etag_of(of).is_some())
    };
    let refused = BindingEvent::Refused { subject: subject(21) };
    let all_bound = bound(&ether, first, 1..=8) && bound(&ether, second, 11..=18);
    if all_bound {
        assert!(ether.node(third).binding_events.contains(&refused));
        assert!(ether.node(third).etag_of(1).is_some(), "a subject that is bound has its etag still");
        // An etag becomes free.
        let broker = ether.node_mut(0).broker.as_mut().unwrap();
        assert!(broker.release_subject(subject(18)));
        ether.node_mut(second).binding.forget(subject(18));
        ether.run(SECOND * 10);
        assert!(ether.node(third).etag_of(21).is_some());
    } else {
        // The third one came before the sixteenth of the others.
        assert!(ether.node(third).etag_of(21).is_some());
    }
    assert_etags_agree(&ether, 21);
}
