//! Thousands of cluster-seconds under random faults: the promise of the hard real-time class.
//!
//! Each run is one seed, printed on failure. `COSMIC_SEED` repeats one, `COSMIC_RUNS` sets how many there
//! are. The judge looks only at the trace of the bus, at the calendar, and at what the applications saw.

mod scenario;

use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{ErrorLevel, StationId, VirtualInstant};
use cosmic_core::calendar::{Calendar, Slot};
use cosmic_core::can::{Frame, Priority};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::{Duration, GlobalInstant};
use scenario::{Dice, Hardships, Journal, Scenario};
use std::collections::{HashMap, HashSet};

const MILLISECOND: u64 = 1_000_000;

/// A hard real-time event on its way: from its load until its withdrawal would be due.
struct Attempted {
    slot: &'static Slot,
    index: u32,
    loaded_at: VirtualInstant,
    /// Errors on the bus in its window, without one on a frame that was on the wire when it was loaded.
    faults: u32,
    sent: bool,
    disrupted: bool,
}

/// Reads the history of every hard real-time event from the trace.
fn attempted(trace: &[TraceEvent], calendar: &'static Calendar) -> Vec<Attempted> {
    let mut all: Vec<Attempted> = Vec::new();
    let mut open: Option<usize> = None;
    let mut frame_before_load = None;
    let mut on_the_wire = None;
    for event in trace {
        if let Some(at) = open {
            let window = calendar.slot_times(all[at].slot).deadline + Duration::from_micros(20);
            if event.at > all[at].loaded_at + window {
                open = None;
            }
        }
        match &event.kind {
            TraceKind::Load { frame, .. } => {
                let Ok(frame) = Frame::try_from(*frame) else { continue };
                if frame.id.priority() != Priority::HARD {
                    continue;
                }
                let mine = |slot: &&Slot| slot.etag == frame.id.etag();
                let slot = calendar.slots().iter().find(mine).unwrap();
                let index = u32::from_be_bytes(frame.payload.as_slice().try_into().unwrap());
                frame_before_load = on_the_wire;
                open = Some(all.len());
                all.push(Attempted {
                    slot,
                    index,
                    loaded_at: event.at,
                    faults: 0,
                    sent: false,
                    disrupted: false,
                });
            }
            TraceKind::FrameStart { number, .. } => on_the_wire = Some(*number),
            TraceKind::FrameEnd { frame, .. } => {
                on_the_wire = None;
                if let (Ok(frame), Some(at)) = (Frame::try_from(*frame), open) {
                    all[at].sent |= frame.id.priority() == Priority::HARD;
                }
            }
            TraceKind::Error(_) | TraceKind::Omission { .. } => {
                let number = match &event.kind {
                    TraceKind::Error(error) => Some(error.number),
                    TraceKind::Omission { number, .. } => Some(*number),
                    _ => None,
                };
                if let Some(at) = open.filter(|_| number != frame_before_load) {
                    all[at].faults += 1;
                }
            }
            // Nor does a frame arrive when nobody is there to acknowledge it.
            TraceKind::Connection { .. } | TraceKind::Reset { .. } | TraceKind::ErrorState { .. } => {
                if let Some(at) = open {
                    all[at].disrupted = true;
                }
            }
            TraceKind::Withdraw { .. } => {}
        }
    }
    all
}

/// Returns whether the node was on, connected and synchronised for the milliseconds around this instant.
fn is_healthy(journal: &Journal, absences: &[Absence], node: u8, at: VirtualInstant) -> bool {
    let millisecond = (at.as_ticks() / MILLISECOND) as usize;
    let row = &journal.healthy[usize::from(node)];
    // A node that has just been switched on takes part from its next 20 ms on.
    let synchronised = (millisecond.saturating_sub(40)..=millisecond + 2)
        .all(|at| row.get(at).is_some_and(|healthy| *healthy));
    synchronised && !absences.iter().any(|absence| absence.node == node && absence.around(at))
}

struct Absence {
    node: u8,
    from: VirtualInstant,
    until: VirtualInstant,
}

impl Absence {
    fn around(&self, at: VirtualInstant) -> bool {
        let margin = 50 * MILLISECOND;
        at.as_ticks() + margin > self.from.as_ticks() && at.as_ticks() < self.until.as_ticks() + margin
    }
}

fn absences(trace: &[TraceEvent], stations: &[StationId]) -> Vec<Absence> {
    let mut all: Vec<Absence> = Vec::new();
    for event in trace {
        let (station, back) = match event.kind {
            TraceKind::Connection { station, connected } => (station, connected),
            TraceKind::Reset { station } => (station, true),
            // Bus-off is an absence, too.
            TraceKind::ErrorState { station, state } => (station, state.level() != ErrorLevel::BusOff),
            _ => continue,
        };
        let node = stations.iter().position(|known| *known == station).unwrap() as u8 + 1;
        all.push(Absence { node, from: event.at, until: event.at });
        if !back {
            all.last_mut().unwrap().until = VirtualInstant::from_ticks(u64::MAX / 2);
        } else {
            for absence in all.iter_mut().filter(|absence| absence.node == node) {
                absence.until = absence.until.min(event.at);
            }
        }
    }
    all
}

fn judge(scenario: &Scenario) -> (u64, u64) {
    let journal = scenario.journal.borrow();
    let calendar = scenario.calendar;
    let absences = absences(&scenario.trace, &scenario.stations);
    let mut delivered = HashSet::new();
    let mut latest = HashMap::new();
    for event in &journal.hard {
        let key = (event.node, event.etag, event.index);
        assert!(delivered.insert(key), "delivered twice: {event:?}");
        if is_healthy(&journal, &absences, event.node, event.at) {
            let before = latest.insert((event.node, event.etag), event.index);
            assert!(before.is_none_or(|before| before < event.index), "out of order: {event:?}");
            check_instant(calendar, event);
        }
    }
    let (mut within, mut beyond) = (0, 0);
    for event in attempted(&scenario.trace, calendar) {
        if event.disrupted {
            continue;
        }
        let publisher = event.slot.publisher.get();
        let in_hypothesis = event.faults <= event.slot.omission_degree.into();
        if in_hypothesis {
            assert!(
                event.sent || !is_healthy(&journal, &absences, publisher, event.loaded_at),
                "lost within its fault hypothesis: {} of {:?}, {} faults",
                event.index,
                event.slot,
                event.faults
            );
        }
        for node in 1..=scenario.stations.len() as u8 {
            let at = event.loaded_at + calendar.slot_times(event.slot).delivery;
            if !is_healthy(&journal, &absences, node, at)
                || !is_healthy(&journal, &absences, publisher, event.loaded_at)
            {
                continue;
            }
            let arrived = delivered.contains(&(node, event.slot.etag, event.index));
            if in_hypothesis {
                within += 1;
                assert!(arrived, "not delivered at node {node}: {} of {:?}", event.index, event.slot);
            } else if !arrived {
                beyond += 1;
                let noticed = |kind| {
                    journal.exceptions.iter().any(|(number, when, exception)| {
                        *number == node
                            && exception.kind == kind
                            && when.as_ticks().abs_diff(at.as_ticks()) < MILLISECOND
                    })
                };
                let publisher_noticed = node != publisher || noticed(ExceptionKind::OmissionDegreeExceeded);
                assert!(
                    publisher_noticed,
                    "the publisher was not told of {} of {:?}",
                    event.index, event.slot
                );
                assert!(
                    !event.slot.periodic || noticed(ExceptionKind::MissedEvent),
                    "node {node} was not told of {} of {:?}",
                    event.index,
                    event.slot
                );
            }
        }
    }
    (within, beyond)
}

/// An event becomes visible at its delivery instant: by the clock of the subscriber, no sooner, and no
/// later than its dispatcher may be late.
fn check_instant(calendar: &Calendar, event: &scenario::Delivery) {
    let slot = calendar.slots().iter().find(|slot| slot.etag == event.etag).unwrap();
    let ready = slot.phase.as_ticks() + u64::from(event.index) * slot.period.as_ticks();
    let due = GlobalInstant::from_epoch(Duration::from_ticks(ready)) + calendar.slot_times(slot).delivery;
    let late = event.global.signed_since(due);
    // The clock may have been corrected by up to ε between the wake-up and now.
    let least = -(calendar.segment().accuracy.as_ticks() as i64);
    let most = (calendar.segment().release_jitter + calendar.segment().accuracy).as_ticks() as i64;
    assert!((least..=most).contains(&late), "{late} ns late: {event:?}");
}

fn runs() -> Vec<u64> {
    if let Some(seed) = std::env::var("COSMIC_SEED").ok().and_then(|seed| seed.parse().ok()) {
        return vec![seed];
    }
    let count = std::env::var("COSMIC_RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(300);
    (1..=count).collect()
}

/// One seed, or a few, may hold too little to count.
fn is_sample() -> bool {
    runs().len() < 100
}

fn survive(seconds: u64, hardships: impl Fn(&mut Dice) -> Hardships) -> (u64, u64) {
    let (mut within, mut beyond) = (0, 0);
    for seed in runs() {
        let hardships = hardships(&mut Dice::new(!seed));
        let run = std::panic::AssertUnwindSafe(|| {
            let mut scenario = Scenario::new(seed, hardships);
            let until = VirtualInstant::from_ticks(seconds * 1000 * MILLISECOND);
            scenario.run(until, hardships.disruptions);
            judge(&scenario)
        });
        match std::panic::catch_unwind(run) {
            Ok(counts) => {
                within += counts.0;
                beyond += counts.1;
            }
            Err(panic) => {
                eprintln!("COSMIC_SEED={seed} repeats this, with {hardships:?}");
                std::panic::resume_unwind(panic);
            }
        }
    }
    (within, beyond)
}

#[test]
fn no_faults() {
    let (within, beyond) = survive(10, |_| Hardships { inversion: 0.0, omission: 0.0, disruptions: 0 });
    assert!(within > 10_000 || is_sample(), "{within}");
    assert_eq!(beyond, 0);
}

#[test]
fn bit_errors_up_to_and_beyond_the_omission_degree() {
    let (within, beyond) = survive(10, |dice| Hardships {
        inversion: dice.one_of(&[0.001, 0.01, 0.03]),
        omission: dice.one_of(&[0.0, 0.001, 0.01]),
        disruptions: 0,
    });
    assert!(within > 10_000 || is_sample(), "{within}");
    assert!(beyond > 10 || is_sample(), "{beyond}");
}

#[test]
fn crashes_restarts_and_partitions() {
    let (within, _) = survive(15, |dice| Hardships {
        inversion: dice.one_of(&[0.0, 0.001, 0.01]),
        omission: dice.one_of(&[0.0, 0.001]),
        disruptions: 1 + dice.below(8),
    });
    assert!(within > 10_000 || is_sample(), "{within}");
}
