//! The workshop as it would be flashed does what it is for: `cargo test`.

use emulate::{Workshop, images};

/// The desk goes then, and the scout comes a second later.
const DESK_GOES: u64 = 4_000;
const SCOUT_COMES: u64 = 7_000;
const END: u64 = 10_000;

#[test]
fn nodes_find_each_other_and_go_on_without_the_desk() {
    let mut workshop = Workshop::new(&images().unwrap(), &[("scout", SCOUT_COMES)]).unwrap();
    workshop.run_until(DESK_GOES).unwrap();
    let lines = &workshop.lines;

    // Two nodes asked for an id, and the desk saw them come.
    for node in ["probe", "lamp"] {
        assert_eq!(workshop.said(node, "INFO Configured", 0), 1, "{lines:#?}");
    }
    // The lamp is shown what the probe measured, and knows where.
    assert!(workshop.said("lamp", "INFO Reading { value: 25 } at Some(7)", 0) == 1, "{lines:#?}");
    // The channel was given up, and announced again.
    assert!(workshop.said("probe", "INFO rests", 0) >= 2, "{lines:#?}");
    assert!(workshop.said("lamp", "INFO is dark", 0) >= 1, "{lines:#?}");
    // An emergency stop came through its slot.
    assert!(workshop.said("desk", "INFO stops, for a reading of 99", 0) == 1, "{lines:#?}");
    assert!(workshop.said("lamp", "INFO Stop { reading: 99 } by node 1", 0) == 1, "{lines:#?}");
    // What the probe had written came in several frames.
    let is_entry = |what: &str| what.starts_with("INFO node ") && what.contains(" writes: 50 readings");
    let entries = lines.iter().filter(|(_, who, what)| *who == "desk" && is_entry(what));
    assert_eq!(entries.count(), 1, "{lines:#?}");

    // Without the desk, the spare names nodes and channels.
    workshop.switch_off("desk");
    workshop.run_until(END).unwrap();
    let lines = &workshop.lines;
    assert_eq!(workshop.said("scout", "INFO Configured", SCOUT_COMES), 1, "{lines:#?}");
    assert!(workshop.said("scout", "INFO rests", SCOUT_COMES) >= 1, "{lines:#?}");
    // It asked whether it may publish what is in no plan.
    assert!(workshop.said("scout", "INFO Admitted(C0000000000000F1)", SCOUT_COMES) == 1, "{lines:#?}");
    // What is measured in the yard is not for the lamp.
    assert!(workshop.said("lamp", "INFO Reading", SCOUT_COMES) >= 1, "{lines:#?}");
    let of_yard = lines.iter().filter(|(_, who, what)| *who == "lamp" && what.contains("at Some(42)"));
    assert_eq!(of_yard.count(), 0, "{lines:#?}");
}
