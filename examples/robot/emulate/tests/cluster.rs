//! The robot as it would be flashed does what it is for: `cargo test`.

use cosmic_bus::VirtualInstant;
use cosmic_emu::ObservationKind;
use emulate::{cluster, images, plan, run};

/// Long enough for the clocks to agree, and for two seconds of events.
const MILLISECONDS: u64 = 3_200;

/// Until then a subscriber may be there before the publisher is, and rightly says that it misses events.
const STARTING_UP: VirtualInstant = VirtualInstant::from_ticks(600_000_000);

#[test]
fn the_nodes_hear_each_other() {
    let mut cluster = cluster(&images().unwrap()).unwrap();
    let mut lines = Vec::new();
    for seen in run(&mut cluster, MILLISECONDS) {
        let node = plan::NODES[seen.node.index()].name;
        match seen.kind {
            ObservationKind::Log(line) => lines.push((seen.at, node, line.level, line.message)),
            ObservationKind::Pin { .. } => {}
            other => panic!("{node} at {}: {other}", seen.at),
        }
    }
    let said = |node: &str, text: &str| {
        lines
            .iter()
            .any(|(_, of, level, message)| *of == node && *level == "INFO" && message.starts_with(text))
    };
    assert!(said("panel", "node 2 writes: motor at 4150 after 100 events"), "{lines:#?}");
    assert!(said("arm", "200 set points"), "{lines:#?}");
    // No event was missed, replaced or late once all had started.
    let is_warning = |level: &str| matches!(level, "WARN" | "ERROR");
    let warnings: Vec<_> =
        lines.iter().filter(|(at, _, level, _)| *at > STARTING_UP && is_warning(level)).collect();
    assert!(warnings.is_empty(), "{warnings:#?}");
}
