//! Why a channel's bound is what it is, and what changed between two plans.

use crate::analysis::proof::ChannelProof;
use crate::analysis::segment::Assessment;
use crate::cluster::{Cluster, PlannedClass};
use crate::plan::{Plan, PlannedSlot};
use crate::units::{microseconds, show};
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Why the slots of a channel stand where they stand, and the terms of its bounds.
pub fn channel(cluster: &Cluster, plan: &Plan, assessment: &Assessment, channel: usize) -> String {
    let mut out = String::new();
    let description = &cluster.channels[channel];
    // Writing into a string does not fail.
    let _ = writeln!(
        out,
        "{} ({}, {} bytes, every {})",
        description.name,
        description.class.abbreviation(),
        description.length,
        show(description.recurrence.span())
    );
    for planned in plan.slots().iter().filter(|planned| planned.channel == channel) {
        for line in slot_reasons(cluster, plan, planned) {
            let _ = writeln!(out, "  {line}");
        }
    }
    for proven in assessment.channels.iter().filter(|proven| proven.channel == channel) {
        let _ = write_proof(&mut out, cluster, proven);
    }
    out
}

fn write_proof(out: &mut String, cluster: &Cluster, proven: &ChannelProof) -> std::fmt::Result {
    let proof = &proven.proof;
    let bound = proof.bound.map_or("no bound".to_owned(), show);
    let deadline = proof.deadline.map_or("none".to_owned(), show);
    let node = &cluster.nodes[proven.node].name;
    writeln!(out, "\n  published by {node}: {bound}, deadline {deadline}: {}", proof.verdict.word())?;
    writeln!(out, "  {}", proof.how)?;
    if let Some(window) = proof.from_ready {
        writeln!(out, "  from the slot's ready instant to delivery: {}", show(window))?;
    }
    for term in &proof.terms {
        writeln!(out, "    {:>10} µs  {}", microseconds(term.span), term.name)?;
    }
    Ok(())
}

/// Why a slot stands where it stands.
fn slot_reasons(cluster: &Cluster, plan: &Plan, planned: &PlannedSlot) -> Vec<String> {
    let slot = &planned.slot;
    let mut reasons = vec![format!(
        "slot of {}: ready {} into every {}, on the bus by {}, all sent by {}, delivered at {}",
        cluster.nodes[planned.node].name,
        show(slot.phase),
        show(slot.period),
        show(slot.phase + planned.times.latest_start),
        show(slot.phase + planned.times.deadline),
        show(slot.phase + planned.times.delivery)
    )];
    if let PlannedClass::Hard { wishes, .. } = &cluster.channels[planned.channel].class {
        if let Some(phase) = wishes.phase {
            reasons.push(format!("the file fixes its phase at {}", show(phase)));
        }
        if let Some(earliest) = wishes.earliest {
            reasons.push(format!("the file wants it not before {}", show(earliest)));
        }
        if let Some(after) = wishes.after {
            let first = &cluster.channels[after.channel].name;
            reasons.push(format!("the file wants it behind {first}, at most {} later", show(after.within)));
        }
    }
    if let Some(pool) = planned.pool {
        reasons.push(format!("it shares the window and the fault budget of pool P{pool}"));
    }
    reasons.extend(neighbours(cluster, plan, planned));
    reasons
}

/// The windows in front of and behind the first occurrence of a slot, and the free time between.
fn neighbours(cluster: &Cluster, plan: &Plan, planned: &PlannedSlot) -> Option<String> {
    let all = plan.occurrences();
    let at = all.iter().position(|(_, other)| std::ptr::eq(*other, planned))?;
    let count = all.len();
    let cycle = plan.cycle().as_ticks();
    if count < 2 {
        return Some(format!(
            "nothing else is in the calendar; free are {} of each cycle",
            show(cosmic_core::time::Duration::from_ticks(cycle - planned.times.delivery.as_ticks()))
        ));
    }
    let (before, first) = all[(at + count - 1) % count];
    let (behind, last) = all[(at + 1) % count];
    let ready = planned.slot.phase.as_ticks();
    let gap = |from: u64, to: u64| {
        let distance = (to + 2 * cycle - from % cycle) % cycle;
        show(cosmic_core::time::Duration::from_ticks(distance))
    };
    let in_front = gap(before.as_ticks() + first.times.delivery.as_ticks(), ready);
    let to_next = gap(ready + planned.times.delivery.as_ticks(), behind.as_ticks());
    let name = |slot: &PlannedSlot| cluster.channels[slot.channel].name.clone();
    Some(format!(
        "free in front of it: {in_front} (behind {}), behind it: {to_next} (until {})",
        name(first),
        name(last)
    ))
}

/// The same for machines.
pub fn channel_json(cluster: &Cluster, plan: &Plan, assessment: &Assessment, channel: usize) -> Value {
    let whole = super::report::of_plan(cluster, plan, assessment);
    let name = json!(cluster.channels[channel].name);
    let of_channel = |list: &Value| -> Vec<Value> {
        let items = list.as_array().map_or(&[][..], Vec::as_slice);
        items.iter().filter(|item| item["channel"] == name).cloned().collect()
    };
    let reasons: Vec<String> = plan
        .slots()
        .iter()
        .filter(|planned| planned.channel == channel)
        .flat_map(|planned| slot_reasons(cluster, plan, planned))
        .collect();
    json!({
        "channel": name,
        "slots": of_channel(&whole["calendar"]["slots"]),
        "reasons": reasons,
        "bounds": of_channel(&whole["channels"]),
    })
}

/// One thing that differs between two plans.
#[derive(Clone, PartialEq, Debug)]
pub struct Change {
    /// For whom.
    pub who: String,
    /// What.
    pub what: String,
    /// Before.
    pub before: String,
    /// After.
    pub after: String,
}

/// What changed for whom between two plans.
pub fn difference(
    before: (&Cluster, &Plan, &Assessment),
    after: (&Cluster, &Plan, &Assessment),
) -> Vec<Change> {
    let (a, b) = (facts(before), facts(after));
    let mut changes = Vec::new();
    let absent = || "-".to_owned();
    for (who, what, value) in &a {
        let other = b.iter().find(|(w, x, _)| (w, x) == (who, what)).map(|(_, _, value)| value);
        if other != Some(value) {
            let after = other.cloned().unwrap_or_else(absent);
            changes.push(Change { who: who.clone(), what: what.clone(), before: value.clone(), after });
        }
    }
    for (who, what, value) in &b {
        if !a.iter().any(|(w, x, _)| (w, x) == (who, what)) {
            changes.push(Change {
                who: who.clone(),
                what: what.clone(),
                before: absent(),
                after: value.clone(),
            });
        }
    }
    // What concerns one of them stands together, in the order in which they first appear.
    let names: Vec<String> = changes.iter().map(|change| change.who.clone()).collect();
    changes.sort_by_key(|change| names.iter().position(|name| *name == change.who));
    changes
}

type Fact = (String, String, String);

fn facts((cluster, plan, assessment): (&Cluster, &Plan, &Assessment)) -> Vec<Fact> {
    let mut facts: Vec<Fact> = Vec::new();
    let mut fact =
        |who: &str, what: &str, value: String| facts.push((who.to_owned(), what.to_owned(), value));
    fact("segment", "cycle", show(plan.cycle()));
    fact("segment", "bit rate", crate::units::show_rate(cluster.segment.bit_rate));
    let percent = |share: f64| format!("{:.2} %", share * 100.0);
    fact("segment", "load", percent(assessment.utilisation.total()));
    fact("segment", "reserved", percent(assessment.utilisation.reserved));
    if let Ok(calendar) = plan.calendar() {
        fact("segment", "digest", format!("{:08x}", calendar.digest()));
    }
    for planned in plan.slots() {
        let who =
            format!("{} of {}", cluster.channels[planned.channel].name, cluster.nodes[planned.node].name);
        fact(&who, "ready", show(planned.slot.phase));
        fact(&who, "omission degree", planned.slot.omission_degree.to_string());
    }
    for proven in &assessment.channels {
        let channel = &cluster.channels[proven.channel];
        let who = format!("{} of {}", channel.name, cluster.nodes[proven.node].name);
        fact(&who, "class", channel.class.abbreviation().to_owned());
        fact(&who, "period", show(channel.recurrence.span()));
        fact(&who, "length", format!("{} bytes", channel.length));
        if let Some(window) = proven.proof.from_ready {
            fact(&who, "window", show(window));
        }
        fact(&who, "bound", proven.proof.bound.map_or("none".to_owned(), show));
        fact(&who, "deadline", proven.proof.deadline.map_or("none".to_owned(), show));
        fact(&who, "verdict", proven.proof.verdict.word().to_owned());
    }
    for (frame, proof) in cluster.foreign.iter().zip(&assessment.foreign) {
        fact(&frame.name, "bound", proof.bound.map_or("none".to_owned(), show));
    }
    facts
}

/// The changes as text, in at most 80 columns where names allow.
pub fn changes_as_text(changes: &[Change]) -> String {
    if changes.is_empty() {
        return "nothing changed\n".to_owned();
    }
    let mut out = String::new();
    let mut last = "";
    for change in changes {
        if change.who != last {
            let _ = writeln!(out, "{}", change.who);
            last = &change.who;
        }
        let _ = writeln!(out, "  {:<16} {} -> {}", change.what, change.before, change.after);
    }
    out
}

/// The changes for machines.
pub fn changes_as_json(changes: &[Change]) -> Value {
    let entry = |c: &Change| json!({ "who": c.who, "what": c.what, "before": c.before, "after": c.after });
    json!(changes.iter().map(entry).collect::<Vec<_>>())
}
