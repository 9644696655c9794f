//! Where the cycles of a path go, by function.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use cosmic_core::can::Id;
use cosmic_emu::{ObservationKind, Place};

use crate::bed::{Bed, CORE_HERTZ, FOREIGN, Images, SMALL, VEHICLE, ms, suspension};
use crate::cycles::{CAN1_RX1, LISTENERS, TIM2};

/// Prints, for each function that a node executes from the beginning of a handler until it sleeps, its cycles and how often
/// it was come to.
fn profile(
    what: &str,
    (images, nodes, looked_at): (Images, &[&'static str], &str),
    flood: Option<Id>,
    handler: u16,
) {
    let mut bed = Bed::new(images, nodes, looked_at, flood);
    for pc in FLASH.step_by(2) {
        bed.cluster.watch_address(bed.node, pc);
    }
    bed.cluster.watch_handlers(bed.node);
    bed.cluster.run_until(ms(1_040));
    let mut functions: BTreeMap<String, (u64, u32)> = BTreeMap::new();
    // The function that is being executed, and since when.
    let mut last = None;
    let seen = bed.cluster.take_observations().into_iter().filter(|seen| seen.node == bed.node);
    let begins = |kind: &ObservationKind| matches!(kind, ObservationKind::Handler { exception, begins: true, .. } if *exception == handler);
    for seen in seen.skip_while(|seen| !begins(&seen.kind)) {
        let ObservationKind::Reached { place, .. } = &seen.kind else { continue };
        let function = function(place);
        let entered = last.as_ref().is_none_or(|(before, _)| *before != function);
        functions.entry(function.clone()).or_default().1 += u32::from(entered);
        if let Some((before, since)) = last.replace((function, seen.at)) {
            let nanoseconds = seen.at.checked_duration_since(since).unwrap().as_ticks();
            let cycles = nanoseconds * CORE_HERTZ / 1_000_000_000;
            if cycles > ASLEEP {
                break;
            }
            functions.entry(before).or_default().0 += cycles;
        }
    }
    let mut functions: Vec<_> = functions.into_iter().collect();
    functions.sort_by_key(|(_, (cycles, _))| Reverse(*cycles));
    println!("{what}: {} cycles", functions.iter().map(|(_, (cycles, _))| cycles).sum::<u64>());
    for (function, (cycles, times)) in &functions {
        println!("{cycles:>6} {times:>3} {function}");
    }
    assert!(functions.len() > 1, "nothing was executed");
}

/// The name without how far behind its start the place is.
fn function(place: &Place) -> String {
    let symbol = place.symbol.as_deref().unwrap_or("?");
    symbol.rsplit_once('+').map_or(symbol, |(name, _)| name).trim().to_owned()
}

#[test]
#[ignore = "output for who looks for cycles; what must hold is in the other tests"]
fn where_the_cycles_go() {
    let all = ["sensor", "brake", "diagnostics"];
    profile("delivered frame", (VEHICLE, &LISTENERS, "listener"), Some(suspension()), CAN1_RX1);
    profile("instant of the timer", (VEHICLE, &all, "sensor"), None, TIM2);
}

#[test]
#[ignore = "as the other"]
fn where_the_cycles_of_small_nodes_go() {
    let small = ["hub", "full", "full_logs", "ups"];
    profile("foreign frame", (SMALL, &small, "full"), Some(FOREIGN), CAN1_RX1);
    profile("instant of the timer", (SMALL, &small, "full"), None, TIM2);
}

/// Where the programs are.
const FLASH: std::ops::Range<u32> = 0x0800_0000..0x0802_0000;
/// Longer than any instruction, in cycles.
const ASLEEP: u64 = 500;
