//! What the paths of a node take, in cycles of its core, and the limits.
//!
//! The model: cycles of the Cortex-M4 manual (table 3-1), a taken branch two more, flash without wait states, twelve to enter
//! a handler and ten to leave it, six from one to the next; sleep counts for nothing.

use cosmic_core::can::Id;
use cosmic_emu::{Observation, ObservationKind, Pin};

use crate::bed::{Bed, CORE_HERTZ, FOREIGN, Images, SMALL, VEHICLE, ms, suspension};

/// What a frame of this identifier costs a node in all, from its interrupt to sleep: a full bus compared with one without
/// such frames.
fn cost(images: Images, nodes: &[&'static str], looked_at: &str, id: Id) -> u64 {
    let without = Bed::new(images, nodes, looked_at, None).second();
    let with = Bed::new(images, nodes, looked_at, Some(id)).second();
    assert!(with.frames > 5_000 && without.frames == 0);
    // What a node does by itself falls into other instants on a full bus, and may take a little less.
    with.awake.saturating_sub(without.awake) / with.frames
}

/// What a node does in all in ten milliseconds, which is the cycle of its calendar.
fn cycle(images: Images, nodes: &[&'static str], looked_at: &str) -> u64 {
    Bed::new(images, nodes, looked_at, None).second().awake / 100
}

/// What an observation is to a span of time.
enum Mark {
    Begins,
    Ends,
    /// One that has begun is none: it was something else.
    Voids,
    Nothing,
}

/// How long it took from one thing to the next, in cycles, the shortest first.
struct Spans(Vec<u64>);

impl Spans {
    /// Those of half a second.
    fn of(mut bed: Bed, mark: impl Fn(&ObservationKind) -> Mark) -> Self {
        bed.cluster.watch_handlers(bed.node);
        bed.cluster.run_until(ms(1_500));
        let (mut begun, mut spans) = (None, Vec::new());
        let of_node = |seen: &Observation| seen.node == bed.node;
        for seen in bed.cluster.take_observations().into_iter().filter(of_node) {
            match (mark(&seen.kind), begun) {
                (Mark::Begins, _) => begun = Some(seen.at),
                (Mark::Ends, Some(since)) => {
                    let nanoseconds = seen.at.checked_duration_since(since).unwrap().as_ticks();
                    spans.push(ENTRY + nanoseconds * CORE_HERTZ / 1_000_000_000);
                    begun = None;
                }
                (Mark::Voids, _) => begun = None,
                _ => {}
            }
        }
        assert!(spans.len() > 20, "{} spans", spans.len());
        spans.sort_unstable();
        Self(spans)
    }

    /// Half of them take no longer.
    fn median(&self) -> u64 {
        self.0[self.0.len() / 2]
    }

    fn longest(&self) -> u64 {
        self.0.last().copied().unwrap_or_default()
    }
}

/// From the instant of the timer to the handler that polls the calendar task.
fn release(images: Images, nodes: &[&'static str], looked_at: &str) -> Spans {
    Spans::of(Bed::new(images, nodes, looked_at, None), |kind| match *kind {
        ObservationKind::Handler { exception: TIM2, begins: true, .. } => Mark::Begins,
        ObservationKind::Handler { priority: CALENDAR, begins: true, .. } => Mark::Ends,
        // It was somebody else's instant.
        ObservationKind::Handler { begins: true, .. } => Mark::Voids,
        _ => Mark::Nothing,
    })
}

/// From the instant of the timer to the calendar task.
fn release_seen_at_pin(nodes: &[&'static str], looked_at: &str) -> Spans {
    Spans::of(Bed::new(VEHICLE, nodes, looked_at, None), |kind| match *kind {
        ObservationKind::Handler { exception: TIM2, begins: true, .. } => Mark::Begins,
        ObservationKind::Pin { pin: CALENDAR_RUNS, level: true, .. } => Mark::Ends,
        ObservationKind::Handler { priority, begins: true, .. } if priority != CALENDAR => Mark::Voids,
        _ => Mark::Nothing,
    })
}

/// From the interrupt of a frame to the task of the application that has taken the event.
fn delivery() -> Spans {
    let bed = Bed::new(VEHICLE, &LISTENERS, "listener", Some(suspension()));
    Spans::of(bed, |kind| match *kind {
        ObservationKind::Handler { exception: CAN1_RX1, begins: true, .. } => Mark::Begins,
        ObservationKind::Pin { pin: DELIVERED, .. } => Mark::Ends,
        _ => Mark::Nothing,
    })
}

#[test]
fn paths_stay_within_their_limits() {
    let all = ["sensor", "brake", "diagnostics"];
    let small = ["hub", "full", "full_logs", "ups"];
    let (delivery, of_sensor) = (delivery(), release_seen_at_pin(&all, "sensor"));
    let of_full = release(SMALL, &small, "full");
    // What, how much, the limit, the goal if there is one.
    let measured = [
        // Nothing of it is for the frame: on a full bus its own frames leave one by one.
        ("foreign frame, full, in all", cost(SMALL, &small, "full", FOREIGN), 60, Some(400)),
        ("foreign frame, ups, in all", cost(SMALL, &small, "ups", FOREIGN), 0, Some(400)),
        ("frame to its application, listener", delivery.median(), 885, Some(900)),
        ("the same at worst", delivery.longest(), 2_850, None),
        ("the same in all", cost(VEHICLE, &LISTENERS, "listener", suspension()), 1_095, None),
        ("the same in all, brake", cost(VEHICLE, &all[..2], "brake", suspension()), 1_670, None),
        ("instant to calendar task, sensor", of_sensor.median(), 205, Some(250)),
        ("the same at worst", of_sensor.longest(), 205, None),
        ("instant to calendar's handler, full", of_full.median(), 130, None),
        ("the same at worst", of_full.longest(), 130, None),
        ("cycle of 10 ms, sensor", cycle(VEHICLE, &all, "sensor"), 20_200, None),
        ("cycle of 10 ms, listener", cycle(VEHICLE, &LISTENERS, "listener"), 10_700, None),
        ("cycle of 10 ms, full", cycle(SMALL, &small, "full"), 38_500, None),
    ];
    let mut exceeded = Vec::new();
    for (what, cycles, most, goal) in measured {
        let goal = goal.map_or(String::new(), |goal| format!(", goal {goal}"));
        let line = format!("{what:<36} {cycles:>6} cycles, at most {most}{goal}");
        println!("{line}");
        if cycles > most {
            exceeded.push(line);
        }
    }
    assert_eq!(exceeded, Vec::<String>::new());
}

/// The sensor, and who listens in place of the brake.
pub(crate) const LISTENERS: [&str; 2] = ["sensor", "listener"];
/// What the core takes to enter a handler, which is not seen before.
const ENTRY: u64 = 12;
// Numbers of exceptions (RM0090, table 62: position and 16).
pub(crate) const CAN1_RX1: u16 = 16 + 21;
pub(crate) const TIM2: u16 = 16 + 28;
/// RTIC's priority 7 of 16, as NVIC has it.
const CALENDAR: u8 = (16 - 7) << 4;
/// The measuring point that is high while the calendar task runs.
const CALENDAR_RUNS: Pin = Pin { port: 'B', number: 12 };
/// The measuring point that changes when an event is delivered.
const DELIVERED: Pin = Pin { port: 'B', number: 14 };
