//! For how much of the time the core of a node is awake on a full bus.

use cosmic_core::can::Id;
use cosmic_emu::ObservationKind;

use crate::bed::{Bed, CORE_HERTZ, FOREIGN, Second, VEHICLE, suspension};

/// A second of a node of the example, flooded, in which it must not complain.
fn measure(nodes: &[&'static str], measured: &str, flood: Id) -> Second {
    let mut bed = Bed::new(VEHICLE, nodes, measured, Some(flood));
    let second = bed.second();
    let warned = |seen: &cosmic_emu::Observation| match &seen.kind {
        ObservationKind::Log(line) if seen.node == bed.node && line.level != "DEBUG" => {
            Some(line.message.clone())
        }
        _ => None,
    };
    let complaints: Vec<_> = bed.cluster.take_observations().iter().filter_map(warned).collect();
    assert_eq!(complaints, Vec::<String>::new(), "{measured}");
    second
}

#[test]
fn a_node_sleeps_most_of_the_time_on_a_full_bus() {
    let all = ["sensor", "brake", "diagnostics"];
    let cases = [
        ("sensor, foreign frames", measure(&all, "sensor", FOREIGN), 5.0),
        (
            "diagnostics, which publishes at 1 kHz, foreign frames",
            measure(&all, "diagnostics", FOREIGN),
            10.0,
        ),
        ("brake, which takes every frame", measure(&all[..2], "brake", suspension()), 20.0),
    ];
    for (name, second, most) in cases {
        let percent = second.awake as f64 / CORE_HERTZ as f64 * 100.0;
        println!("{name}: {percent:.1} % awake, {} frames of the flood", second.frames);
        assert!(second.frames > 5_000, "{name}: {} frames", second.frames);
        assert!(percent < most, "{name}: {percent:.1} % awake");
    }
}
