//! The plan as Rust constants, from which the firmware is built.
//!
//! The file is meant for `include!`, so it has no inner attributes and names everything by its full
//! path. The compiler checks the calendar again ([`Calendar::checked`]), and the file's digest against the
//! calendar's: a file that was edited by hand does not compile.
//!
//! [`Calendar::checked`]: cosmic_core::calendar::Calendar::checked

use crate::cluster::{Channel, Class, Cluster, Node, Recurrence};
use crate::plan::{Plan, PlannedSlot};
use crate::units::show;
use cosmic_core::calendar::CalendarError;
use cosmic_core::time::Duration;
use std::fmt::Write as _;

/// The text of the file.
///
/// # Errors
/// The calendar's own check finds something wrong, which would be a fault of the planner.
pub fn render(cluster: &Cluster, plan: &Plan, source_name: &str) -> Result<String, CalendarError> {
    let digest = plan.calendar()?.digest();
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = write_calendar(&mut out, cluster, plan, source_name, digest);
    let _ = write_channels(&mut out, cluster, plan);
    let _ = write_nodes(&mut out, cluster);
    Ok(out)
}

fn write_calendar(
    out: &mut String,
    cluster: &Cluster,
    plan: &Plan,
    source_name: &str,
    digest: u32,
) -> std::fmt::Result {
    let segment = plan.segment();
    writeln!(out, "// Made by `cosmic-plan build {source_name}`. Change that file, not this one.\n")?;
    writeln!(out, "/// What holds for all slots of the calendar.")?;
    writeln!(
        out,
        "pub const SEGMENT: ::cosmic_core::calendar::Segment = ::cosmic_core::calendar::Segment {{"
    )?;
    let bits = segment.bit_rate.bits_per_second();
    writeln!(out, "    bit_rate: ::cosmic_core::can::BitRate::new({bits}).unwrap(),")?;
    writeln!(out, "    accuracy: {},", duration(segment.accuracy))?;
    writeln!(out, "    release_jitter: {},", duration(segment.release_jitter))?;
    writeln!(out, "}};\n")?;
    writeln!(out, "/// The slots, by phase.")?;
    let count = plan.slots().len();
    writeln!(out, "pub const SLOTS: [::cosmic_core::calendar::Slot; {count}] = [")?;
    for planned in plan.slots() {
        write_slot(out, cluster, planned)?;
    }
    writeln!(out, "];\n")?;
    let calendar = "::cosmic_core::calendar::Calendar";
    writeln!(out, "/// The calendar of segment `{}`. It does not compile if windows overlap.", cluster.name)?;
    if count > MANY_SLOTS {
        writeln!(
            out,
            "#[allow(long_running_const_eval, reason = \"the check compares all pairs of slots\")]"
        )?;
    }
    writeln!(
        out,
        "pub static CALENDAR: {calendar} = {calendar}::checked(SEGMENT, {}, &SLOTS);\n",
        duration(plan.cycle())
    )?;
    writeln!(out, "/// CRC-32 of the calendar; nodes with another one keep silent in hard real-time.")?;
    writeln!(out, "pub const DIGEST: u32 = {digest:#010x};\n")?;
    if let Some(period) = cluster.sync_period {
        writeln!(out, "/// How often the clock master sends sync and follow-up.")?;
        writeln!(out, "pub const SYNC_PERIOD: {DURATION} = {};\n", duration(period))?;
    }
    writeln!(out, "/// Δt_p: the span of deadlines that one soft real-time priority stands for.")?;
    writeln!(out, "pub const PRIORITY_STEP: {DURATION} = {};\n", duration(cluster.priority_step))
}

fn write_slot(out: &mut String, cluster: &Cluster, planned: &PlannedSlot) -> std::fmt::Result {
    let slot = &planned.slot;
    let channel = &cluster.channels[planned.channel].name;
    let node = &cluster.nodes[planned.node].name;
    writeln!(out, "    // {channel} of {node}: ready {} into every {}", show(slot.phase), show(slot.period))?;
    writeln!(out, "    ::cosmic_core::calendar::Slot {{")?;
    writeln!(out, "        etag: ::cosmic_core::can::Etag::new({}).unwrap(),", slot.etag.get())?;
    writeln!(out, "        publisher: ::cosmic_core::can::TxNode::new({}).unwrap(),", slot.publisher.get())?;
    writeln!(out, "        len: {},", slot.len)?;
    writeln!(out, "        omission_degree: {},", slot.omission_degree)?;
    writeln!(out, "        periodic: {},", slot.periodic)?;
    writeln!(out, "        period: {},", duration(slot.period))?;
    writeln!(out, "        phase: {},", duration(slot.phase))?;
    writeln!(out, "    }},")
}

fn write_channels(out: &mut String, cluster: &Cluster, plan: &Plan) -> std::fmt::Result {
    writeln!(out, "/// The event channels, one module each.")?;
    writeln!(out, "pub mod channels {{")?;
    for (at, channel) in cluster.channels.iter().enumerate() {
        let slots: Vec<usize> = (0..plan.slots().len()).filter(|s| plan.slots()[*s].channel == at).collect();
        let degree = slots.first().map(|slot| plan.slots()[*slot].slot.omission_degree);
        write_channel(out, channel, &slots, degree)?;
    }
    writeln!(out, "}}\n")
}

/// `degree`: that of the channel's slots, which is its pool's if it is in one.
fn write_channel(
    out: &mut String,
    channel: &Channel,
    slots: &[usize],
    degree: Option<u8>,
) -> std::fmt::Result {
    let class = channel.class.abbreviation();
    writeln!(out, "    /// {class} channel `{}`: at most {} bytes.", channel.name, channel.length)?;
    writeln!(out, "    pub mod {} {{", channel.name)?;
    let mut constant = |doc: &str, name: &str, of: &str, value: String| {
        writeln!(out, "        /// {doc}\n        pub const {name}: {of} = {value};")
    };
    constant("Its subject.", "SUBJECT", "::cosmic_core::Subject", subject(channel.subject))?;
    if let Some(etag) = channel.etag {
        let value = format!("::cosmic_core::can::Etag::new({}).unwrap()", etag.get());
        constant("Its etag on this segment.", "ETAG", "::cosmic_core::can::Etag", value)?;
    }
    constant("Bytes of an event at most.", "LENGTH", "usize", channel.length.to_string())?;
    let (doc, name) = match channel.recurrence {
        Recurrence::Periodic(_) => ("One event in every period.", "PERIOD"),
        Recurrence::Sporadic(_) => ("Events come at least this far apart.", "MIN_INTERARRIVAL"),
    };
    constant(doc, name, DURATION, duration(channel.recurrence.span()))?;
    if let [slot] = slots {
        let value = format!("super::super::SLOTS[{slot}]");
        constant("Its slot in the calendar.", "SLOT", "::cosmic_core::calendar::Slot", value)?;
    }
    let (of, value) = attributes(channel, degree);
    constant("The quality that the channel is announced with.", "ATTRIBUTES", of, value)?;
    writeln!(out, "    }}")
}

fn attributes(channel: &Channel, degree: Option<u8>) -> (&'static str, String) {
    match &channel.class {
        Class::Hard { omission_degree, .. } => {
            let periodic = matches!(channel.recurrence, Recurrence::Periodic(_));
            let period = duration(channel.recurrence.span());
            let omission_degree = degree.unwrap_or(*omission_degree);
            let of = "::cosmic_core::event_layer::HardAttributes";
            let fields =
                format!("period: {period}, periodic: {periodic}, omission_degree: {omission_degree}");
            (of, format!("{of} {{ {fields} }}"))
        }
        Class::Soft => {
            let deadline = channel.deadline.unwrap_or(channel.recurrence.span());
            let validity = duration(channel.validity.unwrap_or(deadline));
            let of = "::cosmic_core::event_layer::SoftAttributes";
            (of, format!("{of} {{ deadline: {}, validity: {validity} }}", duration(deadline)))
        }
        Class::NonRealTime { importance } => {
            let validity = match channel.validity {
                Some(validity) => format!("Some({})", duration(validity)),
                None => "None".to_owned(),
            };
            let of = "::cosmic_core::event_layer::NonRealTimeAttributes";
            let importance = format!("::cosmic_core::event_layer::Importance::new({importance}).unwrap()");
            (of, format!("{of} {{ importance: {importance}, validity: {validity} }}"))
        }
    }
}

fn write_nodes(out: &mut String, cluster: &Cluster) -> std::fmt::Result {
    writeln!(out, "/// The nodes, one module each.")?;
    writeln!(out, "pub mod nodes {{")?;
    for node in &cluster.nodes {
        write_node(out, cluster, node)?;
    }
    writeln!(out, "}}")
}

fn write_node(out: &mut String, cluster: &Cluster, node: &Node) -> std::fmt::Result {
    let subjects = |channels: &[usize]| {
        let list: Vec<String> = channels.iter().map(|c| subject(cluster.channels[*c].subject)).collect();
        format!("&[{}]", list.join(", "))
    };
    writeln!(out, "    /// Node `{}`.", node.name)?;
    writeln!(out, "    pub mod {} {{", node.name)?;
    writeln!(out, "        /// Its name.\n        pub const NAME: &str = {:?};", node.name)?;
    let uid = format!("::cosmic_core::NodeUid::new({:#018x}).unwrap()", node.uid);
    writeln!(out, "        /// Its UID.\n        pub const UID: ::cosmic_core::NodeUid = {uid};")?;
    let tx_node = format!("::cosmic_core::can::TxNode::new({}).unwrap()", node.tx_node.get());
    writeln!(
        out,
        "        /// Its short id.\n        pub const TX_NODE: ::cosmic_core::can::TxNode = {tx_node};"
    )?;
    let list = "&[::cosmic_core::Subject]";
    let (publishes, subscribes) = (subjects(&node.publishes), subjects(&node.subscribes));
    writeln!(out, "        /// What it publishes.\n        pub const PUBLISHES: {list} = {publishes};")?;
    writeln!(
        out,
        "        /// What it subscribes to.\n        pub const SUBSCRIBES: {list} = {subscribes};"
    )?;
    writeln!(out, "    }}")
}

fn subject(subject: u64) -> String {
    format!("::cosmic_core::Subject::new({subject:#018x}).unwrap()")
}

fn duration(span: Duration) -> String {
    let ticks = span.as_ticks();
    match ticks {
        _ if ticks % 1_000_000 == 0 => format!("{DURATION}::from_millis({})", ticks / 1_000_000),
        _ if ticks % 1_000 == 0 => format!("{DURATION}::from_micros({})", ticks / 1_000),
        _ => format!("{DURATION}::from_ticks({ticks})"),
    }
}

const DURATION: &str = "::cosmic_core::time::Duration";

/// From here on the compiler thinks that its check of the calendar takes long.
const MANY_SLOTS: usize = 150;
