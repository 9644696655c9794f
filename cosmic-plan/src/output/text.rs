//! The report for people, in at most 80 columns.

use crate::analysis::proof::Origin;
use crate::analysis::segment::Assessment;
use crate::analysis::sensitivity::Growth;
use crate::cluster::{Cluster, PlannedClass};
use crate::plan::relax::Relaxation;
use crate::plan::{Method, NoPlan, Plan, PlannedSlot};
use crate::units::{microseconds, show, show_rate};
use std::fmt::Write as _;

/// The calendar, what is proven of each channel, and who takes how much of the bus.
pub fn of_plan(cluster: &Cluster, plan: &Plan, assessment: &Assessment) -> String {
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = write_calendar(&mut out, cluster, plan);
    let _ = write_proofs(&mut out, cluster, assessment);
    let _ = write_utilisation(&mut out, plan, assessment);
    let _ = writeln!(out, "\n{}", summary(cluster, plan, assessment));
    out
}

/// One line: does it hold?
pub fn summary(cluster: &Cluster, plan: &Plan, assessment: &Assessment) -> String {
    let failing: Vec<&str> = assessment
        .channels
        .iter()
        .filter(|channel| !channel.proof.verdict.holds())
        .map(|channel| cluster.channels[channel.channel].name.as_str())
        .chain(
            cluster
                .foreign
                .iter()
                .zip(&assessment.foreign)
                .filter(|(_, proof)| !proof.verdict.holds())
                .map(|(frame, _)| frame.name.as_str()),
        )
        .collect();
    if failing.is_empty() {
        let count = plan.slots().len();
        let slots = if count == 1 { "slot" } else { "slots" };
        format!("{}: everything holds ({count} {slots}, cycle {})", cluster.name, show(plan.cycle()))
    } else {
        format!("{}: no proof that these meet their deadlines: {}", cluster.name, failing.join(", "))
    }
}

fn write_calendar(out: &mut String, cluster: &Cluster, plan: &Plan) -> std::fmt::Result {
    let rate = show_rate(cluster.segment.bit_rate);
    writeln!(
        out,
        "Segment {} at {rate}, ε = {}, release jitter {}\n",
        cluster.name,
        show(cluster.segment.accuracy),
        show(cluster.segment.release_jitter)
    )?;
    let how = match plan.method() {
        Method::Empty => "no hard real-time channels",
        Method::Placement => "found by quick placement",
        Method::Search => "found by the complete search",
        Method::Occurrences => "found occurrence by occurrence",
    };
    writeln!(out, "Calendar: cycle {}, {how}; instants in µs", show(plan.cycle()))?;
    if plan.slots().is_empty() {
        return writeln!(out);
    }
    writeln!(
        out,
        "  {:<16} {:<12} {:>9} {:>9} {:>9} {:>9} {:>3}",
        "channel", "publisher", "period", "ready", "deadline", "delivery", "k"
    )?;
    for planned in plan.slots() {
        let slot = &planned.slot;
        let degree = match planned.pool {
            Some(pool) => format!("P{pool}"),
            None => slot.omission_degree.to_string(),
        };
        writeln!(
            out,
            "  {:<16} {:<12} {:>9} {:>9} {:>9} {:>9} {degree:>3}",
            cut(&cluster.channels[planned.channel].name, 16),
            cut(&cluster.nodes[planned.node].name, 12),
            microseconds(slot.period),
            microseconds(slot.phase),
            microseconds(slot.phase + planned.times.deadline),
            microseconds(slot.phase + planned.times.delivery)
        )?;
    }
    for pool in 0..cluster.pools.len() {
        let Some(effect) = pool_effect(cluster, plan, pool) else { continue };
        let saved = 100.0 - 100.0 * effect.shared.as_ticks() as f64 / effect.separate.as_ticks() as f64;
        writeln!(
            out,
            "  Pool P{pool}: one window of {} instead of {} ({saved:.0} % saved)",
            show(effect.shared),
            show(effect.separate)
        )?;
        writeln!(out, "    now {}", effect.with_pool)?;
        writeln!(out, "    instead of faults in each slot: {}", effect.without)?;
    }
    writeln!(out)
}

fn write_proofs(out: &mut String, cluster: &Cluster, assessment: &Assessment) -> std::fmt::Result {
    writeln!(out, "Worst-case latencies in µs")?;
    writeln!(
        out,
        "  {:<16} {:<12} {:<3} {:>9} {:>10} {:>10}  verdict",
        "channel", "publisher", "", "period", "bound", "deadline"
    )?;
    let or_dash = |span: Option<cosmic_core::time::Duration>| span.map_or("-".to_owned(), microseconds);
    for channel in &assessment.channels {
        let description = &cluster.channels[channel.channel];
        let proof = &channel.proof;
        writeln!(
            out,
            "  {:<16} {:<12} {:<3} {:>9} {:>10} {:>10}  {}",
            cut(&description.name, 16),
            cut(&cluster.nodes[channel.node].name, 12),
            description.class.abbreviation(),
            microseconds(description.recurrence.span()),
            or_dash(proof.bound),
            or_dash(proof.deadline),
            proof.verdict.word()
        )?;
    }
    write_foreign_proofs(out, cluster, assessment)?;
    let counted: Vec<&str> = ORIGINS
        .iter()
        .filter(|(origin, _)| {
            assessment.channels.iter().any(|c| c.proof.from_ready.is_some() && c.proof.origin == *origin)
        })
        .map(|(_, words)| *words)
        .collect();
    if !counted.is_empty() {
        writeln!(out, "  HRT: {}; SRT, NRT: from publication", counted.join(", "))?;
    }
    writeln!(out)
}

/// From where bounds and deadlines of hard real-time channels are counted.
const ORIGINS: [(Origin, &str); 2] = [
    (Origin::Period, "periodic ones from the start of the period"),
    (Origin::Publication, "sporadic ones from publication"),
];

fn write_foreign_proofs(out: &mut String, cluster: &Cluster, assessment: &Assessment) -> std::fmt::Result {
    let or_dash = |span: Option<cosmic_core::time::Duration>| span.map_or("-".to_owned(), microseconds);
    for (frame, proof) in cluster.foreign.iter().zip(&assessment.foreign) {
        writeln!(
            out,
            "  {:<16} {:<12} {:<3} {:>9} {:>10} {:>10}  {}",
            cut(&frame.name, 16),
            format!("{:#x}", frame.id),
            "-",
            microseconds(frame.period),
            or_dash(proof.bound),
            or_dash(proof.deadline),
            proof.verdict.word()
        )?;
    }
    Ok(())
}

fn write_utilisation(out: &mut String, plan: &Plan, assessment: &Assessment) -> std::fmt::Result {
    let shares = &assessment.utilisation;
    writeln!(out, "Bus")?;
    let mut bar = |name: &str, share: f64| {
        // An empty sum is -0.
        let share = share + 0.0;
        let filled = (share.clamp(0.0, 1.0) * 40.0).round() as usize;
        let rest = 40 - filled;
        writeln!(out, "  {name:<24} {:>6.2} % {}{}", share * 100.0, "█".repeat(filled), "░".repeat(rest))
    };
    bar("hard real-time", shares.hard)?;
    bar("soft real-time", shares.soft)?;
    bar("non real-time", shares.non_real_time)?;
    bar("sync", shares.sync)?;
    bar("foreign", shares.foreign)?;
    bar("free without faults", 1.0 - shares.total())?;
    bar("reserved by windows", shares.reserved)?;
    let (stretch, gap) = (plan.longest_stretch(), plan.narrowest_gap());
    writeln!(out, "  at most {} reserved without a gap; gaps of at least {}", show(stretch), show(gap))
}

/// How far channels could grow.
pub fn of_growth(cluster: &Cluster, growth: &[Growth], common: Option<u32>) -> String {
    let mut out = String::from("\nGrowth: one at a time, with everything else as it is\n");
    for growth in growth {
        let channel = &cluster.channels[growth.channel];
        let period = match growth.shortest_period {
            Some(shortest) => format!("{} down to {}", show(channel.recurrence.span()), show(shortest)),
            None => "does not hold as it is".to_owned(),
        };
        let degree = match (cluster.omission_degree(growth.channel), growth.highest_omission_degree) {
            (Some(now), Some(highest)) => format!(", k = {now} up to {highest}"),
            _ => String::new(),
        };
        let _ = writeln!(out, "  {:<16} period {period}{degree}", cut(&channel.name, 16));
    }
    if let Some(percent) = common {
        let _ = writeln!(out, "  all but HRT together: {percent} % of today's rates");
    }
    out
}

/// Why there is no plan.
pub fn of_failure(cluster: &Cluster, failure: &NoPlan) -> String {
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = match failure {
        NoPlan::Impossible(conflict) => {
            let _ = writeln!(out, "{}: no calendar exists: {}.\n", cluster.name, conflict.reason);
            let all = if conflict.minimal {
                "These constraints clash; without any one the rest would do:"
            } else {
                "These constraints clash (perhaps not all are needed for it):"
            };
            let _ = writeln!(out, "{all}");
            for constraint in conflict.constraints.iter().take(MOST_CONSTRAINTS) {
                let _ = writeln!(out, "  - {constraint}");
            }
            match conflict.constraints.len().saturating_sub(MOST_CONSTRAINTS) {
                0 => Ok(()),
                more => writeln!(out, "  - and {more} more"),
            }
        }
        NoPlan::GaveUp { slots, reserved } => {
            let percent = reserved * 100.0;
            writeln!(
                out,
                "{}: no calendar was found for {slots} slots that reserve {percent:.1} % of the time,\n\
                 nor a proof that none exists.",
                cluster.name
            )
        }
    };
    out
}

/// So many constraints of a conflict are listed.
const MOST_CONSTRAINTS: usize = 20;

/// What helps, if anything was found.
pub fn ways_out(relaxations: &[Relaxation]) -> String {
    if relaxations.is_empty() {
        return "\nNo few changes of omissions, periods or bit rate were found to help.\n".to_owned();
    }
    let changes: String =
        relaxations.iter().map(|relaxation| format!("  - {}\n", relaxation.change)).collect();
    format!("\nAny one of these changes helps, the cheapest first:\n{changes}")
}

/// What would help channels whose deadline is not proven.
pub fn advice(found: &[Relaxation]) -> String {
    if found.is_empty() {
        return "\nNo single change of a deadline, a period or the bit rate was found to help.\n".to_owned();
    }
    ways_out(found)
}

fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let kept: String = text.chars().take(width - 1).collect();
    format!("{kept}…")
}

/// What a pool saves and what it costs.
#[derive(Clone, PartialEq, Debug)]
pub struct PoolEffect {
    /// The window that its slots share.
    pub shared: cosmic_core::time::Duration,
    /// The windows that they would have by themselves, together.
    pub separate: cosmic_core::time::Duration,
    /// The fault hypothesis with the pool.
    pub with_pool: String,
    /// The omission degrees of separate slots.
    pub without: String,
}

/// What a pool saves and what it costs; `None` if it has no slots.
pub fn pool_effect(cluster: &Cluster, plan: &Plan, pool: usize) -> Option<PoolEffect> {
    let slots: Vec<&PlannedSlot> = plan.slots().iter().filter(|slot| slot.pool == Some(pool)).collect();
    let shared = slots.first()?.times.delivery;
    let degree = |planned: &PlannedSlot| match cluster.channels[planned.channel].class {
        PlannedClass::Hard { omission_degree, .. } => omission_degree,
        _ => 0,
    };
    let alone = |planned: &&PlannedSlot| {
        cluster.segment.slot_times(planned.slot.len, degree(planned)).delivery.as_ticks()
    };
    let faults = cluster.pools[pool].faults;
    let degrees: Vec<String> = slots
        .iter()
        .map(|planned| {
            let name = &cluster.channels[planned.channel].name;
            format!("{name} {}", degree(planned))
        })
        .collect();
    Some(PoolEffect {
        shared,
        separate: cosmic_core::time::Duration::from_ticks(slots.iter().map(alone).sum()),
        with_pool: format!(
            "{faults} {} in all {} slots of an occurrence together",
            if faults == 1 { "fault" } else { "faults" },
            slots.len()
        ),
        without: degrees.join(", "),
    })
}
