//! An independent check of a plan, from the definitions.
//!
//! It shares no code with the planner, nor with the calendar of the firmware: frames are counted bit by
//! bit, occurrences are written out one by one over a whole cycle and looked at in order of time. What it
//! finds wrong would be a fault of the planner.

use crate::cluster::{Cluster, PlannedClass, Recurrence};
use crate::plan::{Plan, PlannedSlot};

/// Checks every rule.
///
/// # Errors
/// Every rule that is broken, in words.
pub fn verify(cluster: &Cluster, plan: &Plan) -> Result<(), Vec<String>> {
    let mut faults = Vec::new();
    let windows = write_out(cluster, plan, &mut faults);
    every_slot_is_there(cluster, plan, &mut faults);
    windows_are_apart(plan.cycle().as_ticks(), &windows, &mut faults);
    wishes_are_kept(cluster, &windows, plan.cycle().as_ticks(), &mut faults);
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

/// One occurrence: of which channel, from when to when, and how often per cycle its slot recurs.
struct Window {
    channel: usize,
    node: usize,
    from: u64,
    to: u64,
    shared: Option<usize>,
}

/// The longest frame with `bytes` of data: start, identifier and control (39 bits), data and checksum (15)
/// can be stuffed, a bit behind the first five and then behind every four; the delimiter of the checksum,
/// acknowledgement (2), end of frame (7) and inter-frame space (3) cannot.
fn frame_bits(bytes: u64) -> u64 {
    let stuffable = 39 + 8 * bytes + 15;
    let mut stuffed = 0;
    let mut run_ends = 5;
    while run_ends <= stuffable {
        stuffed += 1;
        run_ends += 4;
    }
    stuffable + stuffed + 1 + 2 + 7 + 3
}

fn write_out(cluster: &Cluster, plan: &Plan, faults: &mut Vec<String>) -> Vec<Window> {
    let bit = 1_000_000_000 / u64::from(cluster.segment.bit_rate.bits_per_second());
    let cycle = plan.cycle().as_ticks();
    let gap = 2 * cluster.segment.accuracy.as_ticks() + cluster.segment.release_jitter.as_ticks();
    let mut windows = Vec::new();
    for planned in plan.slots() {
        let (period, phase) = (planned.slot.period.as_ticks(), planned.slot.phase.as_ticks());
        if period == 0 || cycle % period != 0 || phase >= period {
            faults.push(format!("{}: period or phase is out of range", name(cluster, planned)));
            continue;
        }
        let length = needed(cluster, planned, bit) + gap;
        if planned.times.delivery.as_ticks() < length {
            faults.push(format!("{}: the window is shorter than its definition", name(cluster, planned)));
        }
        let (channel, node, shared) = (planned.channel, planned.node, planned.pool);
        let mut from = phase;
        while from < cycle {
            windows.push(Window { channel, node, from, to: from + length, shared });
            from += period;
        }
    }
    windows.sort_by_key(|window| window.from);
    windows
}

/// From ready to deadline.
fn needed(cluster: &Cluster, planned: &PlannedSlot, bit: u64) -> u64 {
    let recovery = 31;
    let bytes = |channel: usize| u64::from(cluster.channels[channel].length);
    let wait = frame_bits(8) + recovery;
    let bits = match planned.pool {
        None => {
            let degree = match cluster.channels[planned.channel].class {
                PlannedClass::Hard { omission_degree, .. } => u64::from(omission_degree),
                _ => 0,
            };
            let frame = frame_bits(bytes(planned.channel));
            wait + frame + degree * (frame + recovery)
        }
        Some(pool) => {
            let pool = &cluster.pools[pool];
            let slots = |channel: &usize| cluster.publishers(*channel).count() as u64;
            let all: u64 = pool.channels.iter().map(|c| slots(c) * frame_bits(bytes(*c))).sum();
            let longest = pool.channels.iter().map(|c| frame_bits(bytes(*c))).max().unwrap_or(0);
            wait + all + u64::from(pool.faults) * (longest + recovery)
        }
    };
    bits * bit
}

fn name(cluster: &Cluster, planned: &PlannedSlot) -> String {
    format!("{} of {}", cluster.channels[planned.channel].name, cluster.nodes[planned.node].name)
}

fn every_slot_is_there(cluster: &Cluster, plan: &Plan, faults: &mut Vec<String>) {
    let cycle = plan.cycle().as_ticks();
    for (at, channel) in cluster.channels.iter().enumerate() {
        if !matches!(channel.class, PlannedClass::Hard { .. }) {
            continue;
        }
        for (node, _) in cluster.nodes.iter().enumerate().filter(|(_, node)| node.publishes.contains(&at)) {
            let ours = plan.slots().iter().filter(|slot| slot.channel == at && slot.node == node);
            let count: u64 = ours.map(|slot| cycle / slot.slot.period.as_ticks().max(1)).sum();
            if count != cycle / channel.recurrence.span().as_ticks().max(1) {
                faults.push(format!("{}: not one slot in every period", channel.name));
            }
        }
    }
}

fn windows_are_apart(cycle: u64, windows: &[Window], faults: &mut Vec<String>) {
    let Some(first) = windows.first() else { return };
    let mut latest: Option<&Window> = None;
    for window in windows {
        if let Some(before) = latest {
            // Slots of a pool share their window, and nothing else.
            let same =
                before.shared.is_some() && before.shared == window.shared && before.from == window.from;
            if window.from < before.to && !same {
                faults.push(format!("windows overlap at {} ns and {} ns", before.from, window.from));
            }
        }
        if latest.is_none_or(|before| before.to <= window.to) {
            latest = Some(window);
        }
    }
    if let Some(last) = latest
        && last.to > first.from + cycle
    {
        faults.push("the last window reaches into the first of the next cycle".to_owned());
    }
}

fn wishes_are_kept(cluster: &Cluster, windows: &[Window], cycle: u64, faults: &mut Vec<String>) {
    for window in windows {
        let channel = &cluster.channels[window.channel];
        let PlannedClass::Hard { wishes, .. } = &channel.class else { continue };
        let period = channel.recurrence.span().as_ticks();
        let in_period = window.from % period;
        let late = window.to - (window.from - in_period);
        if wishes
            .phase
            .is_some_and(|phase| !near(in_period, phase.as_ticks(), channel.jitter.as_ticks(), period))
        {
            faults.push(format!("{}: ready at {in_period} ns of its period, not at its phase", channel.name));
        }
        if wishes.earliest.is_some_and(|earliest| in_period < earliest.as_ticks()) {
            faults.push(format!("{}: ready before its earliest instant", channel.name));
        }
        let promised = match channel.recurrence {
            Recurrence::Periodic(period) => channel.deadline.unwrap_or(period).as_ticks(),
            // From publication, which is another matter than where the slot stands.
            Recurrence::Sporadic(_) => u64::MAX,
        };
        if late > promised {
            faults
                .push(format!("{}: delivered {late} ns into its period, behind its deadline", channel.name));
        }
        if let Some(after) = wishes.after {
            let other_period = cluster.channels[after.channel].recurrence.span().as_ticks();
            // Where the other channel is rarer, only the window that follows it counts.
            if other_period > period {
                continue;
            }
            let close = windows.iter().filter(|w| w.channel == after.channel).any(|first| {
                let behind = (window.from + 2 * cycle - first.to % cycle) % cycle;
                behind <= after.within.as_ticks()
            });
            if !close {
                let first = &cluster.channels[after.channel].name;
                faults.push(format!("{} at {} ns is not behind {first}", channel.name, window.from));
            }
        }
    }
    occurrences_are_evenly_spaced(cluster, windows, faults);
}

fn near(a: u64, b: u64, tolerance: u64, period: u64) -> bool {
    let distance = a.abs_diff(b);
    distance.min(period - distance.min(period)) <= tolerance
}

/// Each occurrence stands where the first one and the period put it, up to the jitter that is allowed.
fn occurrences_are_evenly_spaced(cluster: &Cluster, windows: &[Window], faults: &mut Vec<String>) {
    for (at, channel) in cluster.channels.iter().enumerate() {
        let period = channel.recurrence.span().as_ticks();
        for node in 0..cluster.nodes.len() {
            let mut ours = windows.iter().filter(|window| window.channel == at && window.node == node);
            let Some(first) = ours.next() else { continue };
            for (turn, window) in ours.enumerate() {
                let nominal = first.from + (turn as u64 + 1) * period;
                if window.from.abs_diff(nominal) > channel.jitter.as_ticks() {
                    faults.push(format!("{}: occurrence {} is out of its rhythm", channel.name, turn + 1));
                }
            }
        }
    }
}
