//! A crystal that fails while the node runs: it is silent at once, the others go on, and when the crystal oscillates again
//! the node takes part again and says why it had gone.

use cosmic_bus::VirtualInstant;
use cosmic_core::can::{Frame, Priority, TxNode};
use cosmic_emu::{NodeConfig, ResetCause};
use cosmic_trials::{Trial, millisecond, ms, on_board};

const FAILS: u64 = 1_500;
const WORKER: TxNode = TxNode::new(3).unwrap();

fn is_beat(frame: &Frame) -> bool {
    frame.id.priority() == Priority::HARD
}

/// The cluster, in which the crystal of the worker fails once it sends such a frame.
fn fails(worker: &'static str, into: impl Fn(&Frame) -> bool) -> Trial {
    let nodes = [("master", 0), ("deputy", 0), (worker, 0), ("guest", 0)];
    let mut trial = Trial::with(&nodes, on_board);
    trial.run_until(FAILS);
    trial.run_into_frame(FAILS + 500, into);
    let node = trial.node(worker);
    trial.cluster.set_crystal(node, false);
    trial
}

/// How many frames of the worker came whole after an instant.
fn sent(trial: &Trial, after: VirtualInstant) -> usize {
    trial.frames_at(0).filter(|(at, frame)| *at > after && frame.id.tx_node() == WORKER).count()
}

#[test]
fn a_node_whose_crystal_fails_is_silent_at_once_and_comes_back_with_it() {
    for (worker, into) in [
        ("worker", is_beat as fn(&Frame) -> bool),
        // It sleeps while others send.
        ("worker", |frame| frame.id.tx_node() != WORKER),
        // A clock from outside, and CAN2.
        ("worker_nucleo", is_beat),
    ] {
        let mut trial = fails(worker, into);
        let failed_at = trial.cluster.bus().now();
        let failed = millisecond(failed_at);
        trial.run_until(failed + 700);
        let [(reset, ResetCause::Software)] = trial.resets(worker)[..] else { panic!("{worker}") };
        assert_eq!(reset, failed, "{worker}");
        assert_eq!(sent(&trial, failed_at), 0, "{worker}: not even the frame that was under way");
        // All others go on, and what was under way from the worker is not taken for a frame by anybody.
        let others = trial.frames(failed + 10).filter(|(_, frame)| frame.id.tx_node() != WORKER).count();
        assert!(others > 100, "{worker}: {others}");

        let node = trial.node(worker);
        trial.cluster.set_crystal(node, true);
        trial.run_until(failed + 2_700);
        let beats: Vec<_> = trial.frames(failed + 700).filter(|(_, frame)| is_beat(frame)).collect();
        let (first, _) = beats.first().unwrap();
        assert!(*first < failed + 700 + 1_500 && beats.len() > 40, "{worker}: {first}, {}", beats.len());
        assert!(trial.said(worker, "started by Crystal", failed), "{worker}: {:#?}", trial.log(worker, 0));
        let of_worker = trial.statuses(failed).filter(|(_, status)| status.tx_node == WORKER);
        let causes: Vec<_> = of_worker.map(|(_, status)| status.reset_cause.name()).collect();
        assert!(!causes.is_empty() && causes.iter().all(|cause| *cause == "crystal"), "{causes:?}");
        assert_eq!(trial.resets(worker).len(), 1, "{worker}");
        assert_eq!(trial.oddities(), Vec::<String>::new(), "{worker}");

        // Told once: the next reset has a cause of its own.
        trial.cluster.reset(node);
        trial.run_until(failed + 3_000);
        assert!(trial.said(worker, "started by Pin", failed + 2_600), "{worker}");
    }
}

#[test]
fn a_board_whose_crystal_has_never_run_says_so_and_is_silent() {
    let change = |config: &mut NodeConfig| config.crystal_runs = config.name != "worker";
    let mut trial = Trial::with(&[("master", 0), ("worker", 0)], change);
    trial.run_until(1_000);
    assert_eq!(sent(&trial, ms(0)), 0);
    assert!(trial.said("worker", "Crystal", 0), "{:#?}", trial.log("worker", 0));
}
