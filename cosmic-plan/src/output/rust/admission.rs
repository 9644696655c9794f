//! What becomes of soft real-time channels that the plan does not know, and what is on the segment besides.

use super::{CORE, DURATION, subject};
use crate::analysis::reserved::Reserved;
use crate::cluster::{Cluster, PlannedClass};
use crate::plan::Plan;
use cosmic_core::admission::{Faults, Guarded, Load, Reservations, SoftLoad, Unplanned};
use cosmic_core::time::Duration;
use std::fmt::{self, Write as _};

pub(super) fn write(out: &mut String, cluster: &Cluster, plan: &Plan) -> fmt::Result {
    let unplanned = match cluster.unplanned {
        None => return Ok(()),
        Some(Unplanned::Ask) => "Ask",
        Some(Unplanned::Refuse) => "Refuse",
        Some(Unplanned::NonRealTime) => "NonRealTime",
    };
    let of = format!("{CORE}::admission");
    writeln!(out, "/// What becomes of soft real-time channels that are not in the plan.")?;
    writeln!(out, "pub static ADMISSION: {of}::AdmissionPlan = {of}::AdmissionPlan {{")?;
    writeln!(out, "    unplanned: {of}::Unplanned::{unplanned},")?;
    writeln!(out, "    planned: &[")?;
    for (at, channel) in cluster.channels.iter().enumerate() {
        if channel.class != PlannedClass::Soft {
            continue;
        }
        let name = &channel.name;
        let deadline = format!("channels::{name}::ATTRIBUTES.deadline");
        for node in cluster.publishers(at) {
            let publisher = format!("publisher: nodes::{}::UID", node.name);
            let quality =
                format!("rate: channels::{name}::RATE, deadline: {deadline}, len: {}", channel.length);
            writeln!(
                out,
                "        {of}::PlannedPublication {{ {publisher}, subject: channels::{name}::SUBJECT, {quality} }},"
            )?;
        }
    }
    writeln!(out, "    ],")?;
    let reserved = Reserved::of(cluster, plan);
    write_reservations(out, &of, &reserved.reservations())?;
    writeln!(out, "}};\n")
}

fn write_reservations(out: &mut String, of: &str, reservations: &Reservations<'_>) -> fmt::Result {
    let Reservations { bit_rate, priority_step, reload, slow_refill, faults, calendar, above, soft, guarded } =
        *reservations;
    writeln!(out, "    reservations: {of}::Reservations {{")?;
    writeln!(out, "        bit_rate: {CORE}::can::BitRate::new({}).unwrap(),", bit_rate.bits_per_second())?;
    writeln!(out, "        priority_step: {},", ticks(priority_step))?;
    writeln!(out, "        reload: {},", ticks(reload))?;
    writeln!(out, "        slow_refill: {slow_refill},")?;
    writeln!(out, "        faults: {},", faults_of(of, faults))?;
    writeln!(out, "        calendar: {of}::CalendarDemand {{")?;
    writeln!(out, "            cycle: {},", ticks(calendar.cycle))?;
    writeln!(out, "            total: {},", ticks(calendar.total))?;
    writeln!(out, "            slack: {},", ticks(calendar.slack))?;
    let steps = calendar.steps.iter().map(|(span, load)| format!("({}, {})", ticks(*span), ticks(*load)));
    write_list(out, "            steps", steps)?;
    writeln!(out, "        }},")?;
    write_list(out, "        above", above.iter().map(|load| load_of(of, load)))?;
    let soft = soft.iter().map(|SoftLoad { load, deadline, subject: name }| {
        let (load, deadline, name) = (load_of(of, load), ticks(*deadline), subject(name.get()));
        format!("{of}::SoftLoad {{ load: {load}, deadline: {deadline}, subject: {name} }}")
    });
    write_list(out, "        soft", soft)?;
    let guarded = guarded.iter().map(|Guarded { span, room }| {
        format!("{of}::Guarded {{ span: {}, room: {} }}", ticks(*span), ticks(*room))
    });
    write_list(out, "        guarded", guarded)?;
    writeln!(out, "    }},")
}

fn write_list(out: &mut String, name: &str, items: impl Iterator<Item = String>) -> fmt::Result {
    let list: Vec<String> = items.collect();
    let indent = " ".repeat(name.len() - name.trim_start().len());
    match list.as_slice() {
        [] => writeln!(out, "{name}: &[],"),
        list => {
            writeln!(out, "{name}: &[")?;
            list.iter().try_for_each(|item| writeln!(out, "{indent}    {item},"))?;
            writeln!(out, "{indent}],")
        }
    }
}

fn load_of(of: &str, load: &Load) -> String {
    let Load { transmission, interval, tolerance } = load;
    let (transmission, interval, tolerance) = (ticks(*transmission), ticks(*interval), ticks(*tolerance));
    format!("{of}::Load {{ transmission: {transmission}, interval: {interval}, tolerance: {tolerance} }}")
}

fn faults_of(of: &str, faults: Faults) -> String {
    match faults {
        Faults::None => format!("{of}::Faults::None"),
        Faults::Burst(count, interval) => format!("{of}::Faults::Burst({count}, {})", ticks(interval)),
        Faults::Window(count, window) => format!("{of}::Faults::Window({count}, {})", ticks(window)),
    }
}

/// As the analysis counts.
fn ticks(span: Duration) -> String {
    format!("{DURATION}::from_ticks({})", span.as_ticks())
}
