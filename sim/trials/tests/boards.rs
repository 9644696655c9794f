//! The images of each board, in one cluster: CAN2, a crystal of 12 MHz, a clock in place of a crystal.

use cosmic_core::can::{Etag, Priority};
use cosmic_emu::CanController;
use cosmic_trials::{Trial, on_board};

#[test]
fn boards_with_another_crystal_and_with_can2_take_part() {
    let nodes = [("master", 0), ("worker_nucleo", 0), ("guest_feather", 0)];
    let mut trial = Trial::with(&nodes, on_board);
    trial.run_until(2_000);
    assert_eq!(trial.oddities(), Vec::<String>::new());
    let of =
        |is_it: fn(&cosmic_core::can::Frame) -> bool| trial.frames(1_000).filter(|(_, it)| is_it(it)).count();
    let beats = of(|frame| frame.id.priority() == Priority::HARD);
    let counts = of(|frame| frame.id.etag() == Etag::BOUND_LAST);
    assert!((99..=101).contains(&beats) && (98..=102).contains(&counts), "{beats}, {counts}");
    // And the nodes received: ids and etags, the time, and what the master counts.
    let (_, last) =
        trial.log("master", 1_000).into_iter().rfind(|(_, line)| line.contains(" beats")).unwrap();
    assert!(!last.starts_with("INFO 0 ") && !last.ends_with(" 0 counts"), "{last}");
}

#[test]
fn a_discovery_runs_what_is_built_for_it() {
    let mut trial = Trial::with(&[("master", 0), ("guest_discovery", 0)], on_board);
    trial.run_until(1_500);
    assert_eq!(trial.oddities(), Vec::<String>::new());
    let counts = trial.frames(1_000).filter(|(_, it)| it.id.etag() == Etag::BOUND_LAST).count();
    assert!((48..=52).contains(&counts), "{counts}");
}

#[test]
fn an_image_of_another_board_is_found_out() {
    // The Feather's image on a crystal of 8 MHz: its bits are too long, and it stays off the bus.
    let mut trial = Trial::new(&[("guest_feather", 0)]);
    trial.run_until(100);
    assert!(trial.oddities().iter().any(|odd| odd.contains("bit/s")), "{:?}", trial.oddities());
    // The worker's on CAN2, with the transceiver at CAN1: nothing is heard of it.
    let mut trial =
        Trial::with(&[("master", 0), ("worker_nucleo", 0)], |config| config.can = CanController::Can1);
    trial.run_until(1_000);
    assert!(!trial.frames(0).any(|(_, frame)| frame.id.tx_node().get() == 3));
}
