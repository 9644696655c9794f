//! The report for machines.

use super::text::pool_effect;
use crate::analysis::proof::Proof;
use crate::analysis::segment::Assessment;
use crate::analysis::sensitivity::Growth;
use crate::cluster::Cluster;
use crate::plan::conflict::Conflict;
use crate::plan::relax::Relaxation;
use crate::plan::{NoPlan, Plan, PlannedSlot};
use crate::units::as_microseconds;
use serde_json::{Value, json};

/// Everything about a plan that holds or does not. Spans are in microseconds, shares in 1.
pub fn of_plan(cluster: &Cluster, plan: &Plan, assessment: &Assessment) -> Value {
    let use_of = &assessment.utilisation;
    json!({
        "verdict": if assessment.holds() { "holds" } else { "fails" },
        "segment": {
            "name": cluster.name,
            "bit_rate": cluster.segment.bit_rate.bits_per_second(),
            "clock_accuracy_us": as_microseconds(cluster.segment.accuracy),
            "release_jitter_us": as_microseconds(cluster.segment.release_jitter),
            "priority_step_us": as_microseconds(cluster.priority_step),
        },
        "calendar": {
            "cycle_us": as_microseconds(plan.cycle()),
            "digest": plan.calendar().map(|calendar| format!("{:08x}", calendar.digest())).ok(),
            "method": format!("{:?}", plan.method()).to_lowercase(),
            "narrowest_gap_us": as_microseconds(plan.narrowest_gap()),
            "longest_reserved_stretch_us": as_microseconds(plan.longest_stretch()),
            "slots": plan.slots().iter().map(|slot| of_slot(cluster, slot)).collect::<Vec<_>>(),
            "pools": (0..cluster.pools.len()).map(|pool| of_pool(cluster, plan, pool)).collect::<Vec<_>>(),
        },
        "channels": assessment.channels.iter().map(|channel| {
            let description = &cluster.channels[channel.channel];
            let mut value = of_proof(&channel.proof);
            value["channel"] = json!(description.name);
            value["publisher"] = json!(cluster.nodes[channel.node].name);
            value["class"] = json!(description.class.abbreviation());
            value["period_us"] = json!(as_microseconds(description.recurrence.span()));
            value["etag"] = json!(description.etag.map(|etag| etag.get()));
            value
        }).collect::<Vec<_>>(),
        "foreign": cluster.foreign.iter().zip(&assessment.foreign).map(|(frame, proof)| {
            let mut value = of_proof(proof);
            value["name"] = json!(frame.name);
            value["id"] = json!(frame.id);
            value
        }).collect::<Vec<_>>(),
        "utilisation": {
            "calendar_reserved": use_of.reserved,
            "hard": use_of.hard,
            "soft": use_of.soft,
            "non_real_time": use_of.non_real_time,
            "sync": use_of.sync,
            "foreign": use_of.foreign,
            "total": use_of.total(),
            "free": 1.0 - use_of.total(),
        },
    })
}

fn of_slot(cluster: &Cluster, planned: &PlannedSlot) -> Value {
    let (slot, times) = (&planned.slot, &planned.times);
    json!({
        "channel": cluster.channels[planned.channel].name,
        "publisher": cluster.nodes[planned.node].name,
        "tx_node": slot.publisher.get(),
        "etag": slot.etag.get(),
        "length": slot.len,
        "omission_degree": slot.omission_degree,
        "periodic": slot.periodic,
        "period_us": as_microseconds(slot.period),
        "ready_us": as_microseconds(slot.phase),
        "latest_start_us": as_microseconds(slot.phase + times.latest_start),
        "deadline_us": as_microseconds(slot.phase + times.deadline),
        "delivery_us": as_microseconds(slot.phase + times.delivery),
        "pool": planned.pool,
    })
}

fn of_pool(cluster: &Cluster, plan: &Plan, pool: usize) -> Value {
    match pool_effect(cluster, plan, pool) {
        None => Value::Null,
        Some(effect) => json!({
            "window_us": as_microseconds(effect.shared),
            "separate_windows_us": as_microseconds(effect.separate),
            "fault_hypothesis": effect.with_pool,
            "omission_degrees_of_separate_slots": effect.without,
        }),
    }
}

fn of_proof(proof: &Proof) -> Value {
    json!({
        "bound_us": proof.bound.map(as_microseconds),
        "deadline_us": proof.deadline.map(as_microseconds),
        "counted_from": proof.origin.words(),
        "from_ready_us": proof.from_ready.map(as_microseconds),
        "verdict": proof.verdict.word(),
        "how": proof.how,
        "terms": proof.terms.iter().map(|term| json!({
            "term": term.name, "us": as_microseconds(term.span),
        })).collect::<Vec<_>>(),
    })
}

/// Why there is no plan.
pub fn of_failure(cluster: &Cluster, failure: &NoPlan, relaxations: &[Relaxation]) -> Value {
    let ways_out: Vec<Value> =
        relaxations.iter().map(|r| json!({ "change": r.change, "cost": r.cost })).collect();
    match failure {
        NoPlan::Impossible(conflict) => json!({
            "verdict": "impossible",
            "reason": conflict.reason,
            "conflict": conflict.constraints,
            "channels": names(cluster, conflict),
            "minimal": conflict.minimal,
            "relaxations": ways_out,
        }),
        NoPlan::GaveUp { slots, reserved } => json!({
            "verdict": "not found", "slots": slots, "reserved": reserved, "relaxations": ways_out,
        }),
    }
}

/// What would help.
pub fn of_advice(advice: &[Relaxation]) -> Value {
    json!(advice.iter().map(|r| json!({ "change": r.change, "cost": r.cost })).collect::<Vec<_>>())
}

fn names<'a>(cluster: &'a Cluster, conflict: &Conflict) -> Vec<&'a str> {
    conflict.channels.iter().map(|channel| cluster.channels[*channel].name.as_str()).collect()
}

/// How far channels could grow.
pub fn of_growth(cluster: &Cluster, growth: &[Growth], common: Option<u32>) -> Value {
    json!({
        "event_rates_up_to_percent": common,
        "channels": growth.iter().map(|growth| {
            let channel = &cluster.channels[growth.channel];
            json!({
                "channel": channel.name,
                "period_us": as_microseconds(channel.recurrence.span()),
                "shortest_period_us": growth.shortest_period.map(as_microseconds),
                "omission_degree": cluster.omission_degree(growth.channel),
                "highest_omission_degree": growth.highest_omission_degree,
            })
        }).collect::<Vec<_>>(),
    })
}
