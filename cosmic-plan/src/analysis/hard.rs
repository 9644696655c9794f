//! When hard real-time events are delivered.
//!
//! From a slot's ready instant to delivery it always takes the same, the slot's window. What an engineer asks for is
//! something else. A *periodic* event belongs to a period, and is to be delivered by some instant of it: the bound is
//! that instant, from the start of the period. A *sporadic* event is published at any instant; at worst its slot has
//! just been ready, so that it waits for the next one: the bound is the longest distance of two slots and the window,
//! from publication. Clocks of publisher and subscriber may differ by 2ε meanwhile.

use super::proof::{ChannelProof, Origin, Proof, Term, Verdict};
use crate::cluster::Cluster;
use crate::plan::found::{Plan, PlannedSlot};
use cosmic_core::time::Duration;
use std::collections::BTreeMap;

/// What is proven of each hard real-time channel and publisher.
pub(super) fn proofs(cluster: &Cluster, plan: &Plan) -> Vec<ChannelProof> {
    let mut slots: BTreeMap<(usize, usize), Vec<&PlannedSlot>> = BTreeMap::new();
    for planned in plan.slots() {
        slots.entry((planned.channel, planned.node)).or_default().push(planned);
    }
    let proof = |((channel, node), slots): ((usize, usize), Vec<&PlannedSlot>)| {
        Some(ChannelProof { channel, node, proof: proof(cluster, plan, channel, &slots)? })
    };
    slots.into_iter().filter_map(proof).collect()
}

/// `slots`: all of one channel and publisher. `None` if there are none.
fn proof(cluster: &Cluster, plan: &Plan, channel: usize, slots: &[&PlannedSlot]) -> Option<Proof> {
    let first = slots.first()?;
    let window = first.times.delivery;
    let period = cluster.channels[channel].recurrence.span();
    let term = |name: &str, span: Duration| Term { name: name.to_owned(), span };
    let (origin, bound, deadline, how, front) = match cluster.delivery_deadline(channel) {
        Some(deadline) => {
            let ready = |slot: &&PlannedSlot| slot.slot.phase.as_ticks() % period.as_ticks().max(1);
            let latest = Duration::from_ticks(slots.iter().map(ready).max()?);
            let how = "from the start of the period to delivery; from the slot's ready instant it takes always the \
                       same, up to 2ε";
            let front = vec![term("until the slot is ready", latest)];
            (Origin::Period, latest + window, Some(deadline), how, front)
        }
        None => {
            let wait = longest_distance(plan, slots);
            let clocks = Duration::from_ticks(2 * plan.segment().accuracy.as_ticks());
            let how = "from publication to delivery; at worst the slot has just been ready, and the event waits for \
                       the next";
            let front =
                vec![term("until the next slot is ready", wait), term("clocks that differ by 2ε", clocks)];
            (Origin::Publication, wait + clocks + window, cluster.channels[channel].deadline, how, front)
        }
    };
    let mut terms = front;
    terms.extend(window_terms(plan, first));
    Some(Proof {
        bound: Some(bound),
        deadline,
        verdict: Verdict::of(Some(bound), deadline),
        origin,
        from_ready: Some(window),
        how,
        terms,
    })
}

/// The longest distance of two ready instants that follow each other.
fn longest_distance(plan: &Plan, slots: &[&PlannedSlot]) -> Duration {
    let cycle = plan.cycle().as_ticks();
    let mut ready: Vec<u64> = Vec::new();
    for planned in slots {
        let period = planned.slot.period.as_ticks().max(1);
        ready.extend((0..cycle / period).map(|turn| planned.slot.phase.as_ticks() + turn * period));
    }
    ready.sort_unstable();
    let around = ready.first().map(|first| first + cycle);
    let next = ready.iter().skip(1).copied().chain(around);
    Duration::from_ticks(ready.iter().zip(next).map(|(at, next)| next - at).max().unwrap_or(cycle))
}

fn window_terms(plan: &Plan, planned: &PlannedSlot) -> Vec<Term> {
    let segment = plan.segment();
    let (slot, times) = (&planned.slot, &planned.times);
    let frame = segment.bit_rate.longest_frame(usize::from(slot.len));
    let rest = times.deadline.as_ticks() - times.latest_start.as_ticks() - frame.as_ticks();
    let again = match planned.pool {
        Some(_) => "the pool's other frames and its shared fault budget".to_owned(),
        None => format!("k = {} repetitions, each with error recovery", slot.omission_degree),
    };
    let term = |name: &str, span: Duration| Term { name: name.to_owned(), span };
    vec![
        term("ΔT_wait: one frame that has just started, and a fault on it", times.latest_start),
        term("the frame itself", frame),
        term(&again, Duration::from_ticks(rest)),
        term("gap: 2ε + release jitter", segment.gap()),
    ]
}
