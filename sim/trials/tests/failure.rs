//! A crystal or a supply that fails while the node runs: it is silent at once, the others go on, and when it may, the node
//! takes part again and says why it had gone.

use std::collections::BTreeSet;

use cosmic_bus::VirtualInstant;
use cosmic_core::can::{Frame, Priority, TxNode};
use cosmic_emu::{Cluster, NodeConfig, NodeId};
use cosmic_trials::{Trial, millisecond, ms, on_board};

const FAILS: u64 = 1_500;
/// Longer than the watchdog's patience.
const LASTS: u64 = 300;
const WORKER: TxNode = TxNode::new(3).unwrap();

fn is_beat(frame: &Frame) -> bool {
    frame.id.priority() == Priority::HARD
}

/// How many frames of the worker came whole after an instant.
fn sent(trial: &Trial, after: VirtualInstant) -> usize {
    trial.frames_at(0).filter(|(at, frame)| *at > after && frame.id.tx_node() == WORKER).count()
}

/// What fails, or is well again.
type Change = fn(&mut Cluster, NodeId, bool);

const CRYSTAL: Change = |cluster, node, fails| cluster.set_crystal(node, !fails);
const SUPPLY: Change = |cluster, node, fails| cluster.set_supply(node, fails);

/// Something of the worker fails while such a frame is sent, for a while. Looks at what is before and after, and at the cause
/// that the node tells.
fn fails(worker: &'static str, what: Change, causes: (&str, &str), into: impl Fn(&Frame) -> bool) {
    let nodes = [("master", 0), ("deputy", 0), (worker, 0), ("guest", 0)];
    let mut trial = Trial::with(&nodes, on_board);
    trial.run_until(FAILS);
    trial.run_into_frame(FAILS + 500, into);
    let (node, failed_at) = (trial.node(worker), trial.cluster.bus().now());
    let failed = millisecond(failed_at);
    what(&mut trial.cluster, node, true);
    trial.run_until(failed + LASTS);
    assert_eq!(sent(&trial, failed_at), 0, "{worker}: not even the frame that was under way");
    // All others go on, and what was under way from the worker is not taken for a frame by anybody.
    let others = trial.frames(failed + 10).filter(|(_, frame)| frame.id.tx_node() != WORKER).count();
    assert!(others > 40, "{worker}: {others}");

    what(&mut trial.cluster, node, false);
    trial.run_until(failed + LASTS + 2_000);
    let beats: Vec<_> = trial.frames(failed + LASTS).filter(|(_, frame)| is_beat(frame)).collect();
    let (first, _) = beats.first().unwrap();
    assert!(*first < failed + LASTS + 1_500 && beats.len() > 40, "{worker}: {first}, {}", beats.len());
    let (logged, told) = causes;
    assert!(
        trial.said(worker, &format!("started by {logged}"), failed),
        "{worker}: {:#?}",
        trial.log(worker, failed)
    );
    let of_worker = trial.statuses(failed).filter(|(_, status)| status.tx_node == WORKER);
    let causes: BTreeSet<_> = of_worker.map(|(_, status)| status.reset_cause.name()).collect();
    assert_eq!(causes, BTreeSet::from([told]), "{worker}");
    assert_eq!(trial.oddities(), Vec::<String>::new(), "{worker}");
    assert_eq!(trial.resets(worker).len(), 1, "{worker}: {:?}", trial.resets(worker));

    // Told once: the next reset has a cause of its own.
    trial.cluster.reset(node);
    trial.run_until(failed + LASTS + 2_300);
    assert!(trial.said(worker, "started by Pin", failed + LASTS + 1_900), "{worker}");
}

#[test]
fn a_node_whose_crystal_fails_is_silent_at_once_and_comes_back_with_it() {
    fails("worker", CRYSTAL, ("Crystal", "crystal"), is_beat);
    // It sleeps while others send.
    fails("worker", CRYSTAL, ("Crystal", "crystal"), |frame| frame.id.tx_node() != WORKER);
    // A clock from outside, and CAN2.
    fails("worker_nucleo", CRYSTAL, ("Crystal", "crystal"), is_beat);
}

#[test]
fn a_node_whose_supply_sinks_is_silent_at_once_and_comes_back_with_it() {
    fails("worker", SUPPLY, ("BrownOut", "brown-out"), is_beat);
    fails("worker", SUPPLY, ("BrownOut", "brown-out"), |frame| frame.id.tx_node() != WORKER);
    fails("worker_nucleo", SUPPLY, ("BrownOut", "brown-out"), is_beat);
}

#[test]
fn a_board_whose_crystal_has_never_run_says_so_and_is_silent() {
    let change = |config: &mut NodeConfig| config.crystal_runs = config.name != "worker";
    let mut trial = Trial::with(&[("master", 0), ("worker", 0)], change);
    trial.run_until(1_000);
    assert_eq!(sent(&trial, ms(0)), 0);
    assert!(trial.said("worker", "Crystal", 0), "{:#?}", trial.log("worker", 0));
}
