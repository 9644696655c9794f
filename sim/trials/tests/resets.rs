//! Resets in every phase of a node's life: it takes part again, and nobody else is disturbed for good.

use cosmic_core::can::{Etag, Frame, Priority, TxNode};
use cosmic_core::protocol::NodeState;
use cosmic_emu::ResetCause;
use cosmic_trials::Trial;

/// Resets a node while such a frame is being sent, and looks at what is two seconds later.
fn reset_in(name: &str, phase: &str, after: u64, is_it: impl Fn(&Frame) -> bool) {
    let mut trial = Trial::new(&[("master", 0), ("deputy", 0), ("worker", 0), ("guest", 0)]);
    trial.run_until(after);
    trial.run_into_frame(after + 1_000, is_it);
    let node = trial.node(name);
    trial.cluster.reset(node);
    let at = trial.cluster.bus().now().as_ticks() / 1_000_000;
    trial.run_until(at + 2_500);
    assert_eq!(trial.resets(name), [(at, ResetCause::Pin)], "{phase}");
    assert!(trial.said(name, "started by Pin", at), "{phase}: {:#?}", trial.log(name, at));
    assert_eq!(trial.oddities(), Vec::<String>::new(), "{phase}");
    // The last second: all are well, each slot is used, and what the guest sends comes.
    let states: Vec<_> =
        trial.statuses(at + 1_400).map(|(_, status)| (status.tx_node, status.state)).collect();
    assert!(states.iter().all(|(_, state)| *state == NodeState::Operational), "{phase}: {states:?}");
    let nodes: std::collections::BTreeSet<_> = states.iter().map(|(node, _)| *node).collect();
    assert_eq!(nodes.len(), 4, "{phase}: {states:?}");
    let of = |is_it: fn(&Frame) -> bool| trial.frames(at + 1_500).filter(|(_, frame)| is_it(frame)).count();
    let beats = of(|frame| frame.id.priority() == Priority::HARD);
    let counts = of(|frame| frame.id.etag() == Etag::BOUND_LAST);
    assert!((99..=101).contains(&beats) && (98..=102).contains(&counts), "{phase}: {beats}, {counts}");
}

fn is_of(frame: &Frame, tx_node: TxNode) -> bool {
    frame.id.tx_node() == tx_node
}

const MASTER: TxNode = TxNode::new(1).unwrap();
const WORKER: TxNode = TxNode::new(3).unwrap();

#[test]
fn while_a_node_asks_for_its_id() {
    reset_in("guest", "configuration request", 0, |frame| frame.id.etag() == Etag::CONFIGURATION_REQUEST);
}

#[test]
fn while_a_node_claims_the_id_of_its_plan() {
    let claims = |frame: &Frame| frame.id.etag() == Etag::NODE_IDENTITY && is_of(frame, WORKER);
    reset_in("worker", "claim", 0, claims);
}

#[test]
fn in_the_middle_of_its_slot() {
    reset_in("worker", "slot", 1_000, |frame| frame.id.priority() == Priority::HARD);
}

#[test]
fn the_time_master_between_its_sync_and_its_follow_up() {
    reset_in("master", "sync", 1_000, |frame| frame.id.etag() == Etag::SYNC && is_of(frame, MASTER));
}

#[test]
fn the_broker_while_it_answers() {
    reset_in("master", "configuration reply", 0, |frame| frame.id.etag() == Etag::CONFIGURATION_REPLY);
}
