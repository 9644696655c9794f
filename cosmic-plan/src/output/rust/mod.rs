//! The plan as Rust constants, from which the firmware is built.
//!
//! The file is meant for [`include_plan!`](cosmic_core::include_plan), so it has no inner attributes and names
//! everything by its full path. The compiler checks the calendar again ([`Calendar::checked`]), and the file's
//! digest against the calendar's: a file in which the calendar was edited by hand does not compile.
//!
//! [`Calendar::checked`]: cosmic_core::calendar::Calendar::checked

mod admission;
mod channels;
mod contents;
mod nodes;
mod seal;

use crate::cluster::Cluster;
use crate::needs::Needs;
use crate::node_filters::NoFilters;
use crate::plan::{Plan, PlannedSlot};
use crate::units::show;
use cosmic_core::calendar::CalendarError;
use cosmic_core::time::Duration;
use std::fmt::{self, Write as _};

/// Why there are no constants.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NotRendered {
    /// The calendar's own check finds something wrong, which would be a fault of the planner.
    Calendar(CalendarError),
    /// A node wants more frames than its filters can be planned for.
    Filters(NoFilters),
}

impl fmt::Display for NotRendered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Calendar(error) => write!(f, "the calendar is wrong ({error:?}); please report this"),
            Self::Filters(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for NotRendered {}

/// The text of the file. The types of contents implement these traits besides `Clone`, `Copy`, `PartialEq`, `Debug`,
/// and `Eq` if they can.
///
/// # Errors
/// See [`NotRendered`].
pub fn render(
    cluster: &Cluster,
    plan: &Plan,
    source_name: &str,
    derives: &[String],
) -> Result<String, NotRendered> {
    let digest = plan.calendar().map_err(NotRendered::Calendar)?.digest();
    let filters = crate::node_filters::of_all(cluster, plan).map_err(NotRendered::Filters)?;
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = writeln!(out, "// Made by cosmic-plan of {source_name}. Change that file, not this one.\n");
    let _ = write_calendar(&mut out, cluster, plan, digest);
    let _ = write_clock(&mut out, cluster);
    let _ = write_needs(&mut out, Needs::of(cluster, plan));
    let _ = contents::write(&mut out, cluster, derives);
    let _ = channels::write(&mut out, cluster, plan);
    let _ = admission::write(&mut out, cluster, plan);
    let _ = seal::write(&mut out, cluster);
    let _ = nodes::write(&mut out, cluster, &filters);
    Ok(out)
}

fn write_calendar(out: &mut String, cluster: &Cluster, plan: &Plan, digest: u32) -> fmt::Result {
    let segment = plan.segment();
    let of = format!("{CORE}::calendar::Segment");
    writeln!(out, "/// What holds for all slots of the calendar.")?;
    writeln!(out, "pub const SEGMENT: {of} = {of} {{")?;
    let bits = segment.bit_rate.bits_per_second();
    writeln!(out, "    bit_rate: {CORE}::can::BitRate::new({bits}).unwrap(),")?;
    writeln!(out, "    accuracy: {},", duration(segment.accuracy))?;
    writeln!(out, "    release_jitter: {},", duration(segment.release_jitter))?;
    writeln!(out, "}};\n")?;
    writeln!(out, "/// The slots, by phase.")?;
    let count = plan.slots().len();
    writeln!(out, "pub const SLOTS: [{CORE}::calendar::Slot; {count}] = [")?;
    for planned in plan.slots() {
        write_slot(out, cluster, planned)?;
    }
    writeln!(out, "];\n")?;
    writeln!(out, "/// Δt_p: the span of deadlines that one soft real-time priority stands for.")?;
    writeln!(out, "pub const PRIORITY_STEP: {DURATION} = {};\n", duration(cluster.priority_step))?;
    let calendar = format!("{CORE}::calendar::Calendar");
    writeln!(out, "/// The calendar of segment `{}`. It does not compile if windows overlap.", cluster.name)?;
    if count > MANY_SLOTS {
        let reason = "reason = \"the check compares all pairs of slots\"";
        writeln!(out, "#[allow(long_running_const_eval, {reason})]")?;
    }
    let cycle = duration(plan.cycle());
    writeln!(out, "pub static CALENDAR: {calendar} =")?;
    writeln!(out, "    {calendar}::checked(SEGMENT, {cycle}, &SLOTS).with_priority_step(PRIORITY_STEP);\n")?;
    writeln!(out, "/// CRC-32 of the calendar; nodes with another one keep silent in hard real-time.")?;
    writeln!(out, "pub const DIGEST: u32 = {digest:#010x};\n")?;
    writeln!(out, "const _: () = ::core::assert!(")?;
    writeln!(out, "    CALENDAR.digest() == DIGEST,")?;
    writeln!(out, "    \"this calendar is not what was planned: change the description of the cluster\"")?;
    writeln!(out, ");\n")
}

fn write_slot(out: &mut String, cluster: &Cluster, planned: &PlannedSlot) -> fmt::Result {
    let slot = &planned.slot;
    let channel = &cluster.channels[planned.channel].name;
    let node = &cluster.nodes[planned.node].name;
    writeln!(out, "    // {channel} of {node}: ready {} into every {}", show(slot.phase), show(slot.period))?;
    writeln!(out, "    {CORE}::calendar::Slot {{")?;
    writeln!(out, "        etag: {CORE}::can::Etag::new({}).unwrap(),", slot.etag.get())?;
    writeln!(out, "        publisher: {CORE}::can::TxNode::new({}).unwrap(),", slot.publisher.get())?;
    writeln!(out, "        len: {},", slot.len)?;
    writeln!(out, "        omission_degree: {},", slot.omission_degree)?;
    writeln!(out, "        periodic: {},", slot.periodic)?;
    writeln!(out, "        period: {},", duration(slot.period))?;
    writeln!(out, "        phase: {},", duration(slot.phase))?;
    writeln!(out, "    }},")
}

fn write_clock(out: &mut String, cluster: &Cluster) -> fmt::Result {
    let Some(sync) = cluster.sync() else { return Ok(()) };
    writeln!(out, "/// How the nodes keep their clocks together. Each has its own rank.")?;
    writeln!(out, "pub const SYNC: {SYNC_CONFIG} = {SYNC_CONFIG} {{")?;
    writeln!(out, "    period: {},", duration(sync.period))?;
    writeln!(out, "    stamp_error: {},", duration(sync.stamp_error))?;
    writeln!(out, "    calendar_digest: DIGEST,")?;
    writeln!(out, "    ..{SYNC_CONFIG}::DEFAULT")?;
    writeln!(out, "}};\n")?;
    writeln!(out, "const _: () = ::core::assert!(SYNC.check().is_ok());\n")
}

fn write_needs(out: &mut String, needs: Needs) -> fmt::Result {
    let Needs { slots, channels, subscriptions, events, soft, non_real_time } = needs;
    writeln!(out, "{CORE}::capacity! {{")?;
    writeln!(out, "    /// How much a node of the cluster has room for.")?;
    writeln!(out, "    pub Capacities {{")?;
    for (name, value) in [
        ("slots", slots),
        ("channels", channels),
        ("subscriptions", subscriptions),
        ("events", events),
        ("soft", soft),
        ("non_real_time", non_real_time),
    ] {
        writeln!(out, "        {name}: {value},")?;
    }
    writeln!(out, "    }}\n}}\n")
}

fn subject(subject: u64) -> String {
    format!("{CORE}::Subject::new({subject:#018x}).unwrap()")
}

fn duration(span: Duration) -> String {
    let ticks = span.as_ticks();
    match ticks {
        _ if ticks % 1_000_000 == 0 => format!("{DURATION}::from_millis({})", ticks / 1_000_000),
        _ if ticks % 1_000 == 0 => format!("{DURATION}::from_micros({})", ticks / 1_000),
        _ => format!("{DURATION}::from_ticks({ticks})"),
    }
}

const CORE: &str = "::cosmic_core";
const DURATION: &str = "::cosmic_core::time::Duration";
const SYNC_CONFIG: &str = "::cosmic_core::sync::SyncConfig";

/// From here on the compiler thinks that its check of the calendar takes long.
const MANY_SLOTS: usize = 150;
