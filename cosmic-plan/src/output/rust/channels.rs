//! The event channels: a module of constants for each, and the channel itself for whatever content fits.

use super::{CORE, DURATION, duration, subject};
use crate::cluster::{Channel, Cluster, PlannedClass, Recurrence};
use crate::contents::Layout;
use crate::plan::Plan;
use cosmic_core::can::Payload;
use cosmic_core::protocol::LayoutHash;
use std::fmt::Write as _;

pub(super) fn write(out: &mut String, cluster: &Cluster, plan: &Plan) -> std::fmt::Result {
    writeln!(out, "/// The event channels, one module each.")?;
    writeln!(out, "pub mod channels {{")?;
    for (at, channel) in cluster.channels.iter().enumerate() {
        let slots: Vec<usize> = (0..plan.slots().len()).filter(|s| plan.slots()[*s].channel == at).collect();
        let degree = slots.first().map(|slot| plan.slots()[*slot].slot.omission_degree);
        let publishers = cluster.nodes.iter().filter(|node| node.publishes.contains(&at)).count();
        write_channel(out, channel, publishers, cluster.layout_of(channel), &slots, degree)?;
    }
    writeln!(out, "}}\n")?;
    writeln!(out, "/// All channels, in the order of the description.")?;
    let of = format!("{CORE}::plan::ChannelPlan");
    writeln!(out, "pub const CHANNELS: [{of}; {}] = [", cluster.channels.len())?;
    for channel in &cluster.channels {
        let name = &channel.name;
        let etag = channel.etag.map_or("None".to_owned(), |_| format!("Some(channels::{name}::ETAG)"));
        let fields =
            format!("subject: channels::{name}::SUBJECT, etag: {etag}, len: channels::{name}::LENGTH");
        writeln!(out, "    {of} {{ name: {name:?}, {fields} }},")?;
    }
    writeln!(out, "];\n")
}

/// `degree`: that of the channel's slots, which is its pool's if it is in one.
fn write_channel(
    out: &mut String,
    channel: &Channel,
    publishers: usize,
    layout: Option<&Layout>,
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
        let value = format!("{CORE}::can::Etag::new({}).unwrap()", etag.get());
        constant("Its etag on this segment.", "ETAG", "::cosmic_core::can::Etag", value)?;
    }
    constant("Bytes of an event at most.", "LENGTH", "usize", channel.length.to_string())?;
    let (doc, name) = match channel.recurrence {
        Recurrence::Periodic(_) => ("One event in every period.", "PERIOD"),
        Recurrence::Sporadic(_) => ("Events come at least this far apart.", "MIN_INTERARRIVAL"),
    };
    constant(doc, name, DURATION, duration(channel.recurrence.span()))?;
    if let Some(value) = rate(channel) {
        let doc = "How often events come at most: what a publisher is held to.";
        constant(doc, "RATE", "::cosmic_core::event_layer::EventRate", value)?;
    }
    if let [slot] = slots {
        let value = format!("super::super::SLOTS[{slot}]");
        constant("Its slot in the calendar.", "SLOT", "::cosmic_core::calendar::Slot", value)?;
    }
    let (of, value) = attributes(channel, degree);
    constant("The quality that the channel is announced with.", "ATTRIBUTES", &of, value)?;
    write_constructor(out, channel, publishers, layout)?;
    writeln!(out, "    }}")
}

fn write_constructor(
    out: &mut String,
    channel: &Channel,
    publishers: usize,
    layout: Option<&Layout>,
) -> std::fmt::Result {
    let mut of = format!("{CORE}::event_layer::Channel");
    let etag = if channel.etag.is_some() { ".with_etag(ETAG)" } else { "" };
    let is_of_messages = usize::from(channel.length) > Payload::MAX_LEN;
    let value = match channel.class {
        PlannedClass::NonRealTime { .. } if is_of_messages => {
            let general = format!("{CORE}::event_layer::MessageChannel");
            writeln!(
                out,
                "        /// The channel's type. A message of each publisher may be under way at a time."
            )?;
            writeln!(out, "        pub type MessageChannel<C> = {general}<C, LENGTH, {publishers}>;")?;
            "MessageChannel".clone_into(&mut of);
            format!("{general}::new(SUBJECT, ATTRIBUTES).with_rate(RATE){etag}")
        }
        PlannedClass::Hard { .. } => format!("{of}::hard(SUBJECT, ETAG, ATTRIBUTES)"),
        PlannedClass::Soft => format!("{of}::soft(SUBJECT, ATTRIBUTES).with_rate(RATE){etag}"),
        PlannedClass::NonRealTime { .. } => {
            format!("{of}::non_real_time(SUBJECT, ATTRIBUTES).with_rate(RATE){etag}")
        }
    };
    write_docs(out, layout, &of)?;
    writeln!(out, "        pub const fn channel<C: {CORE}::event_layer::Content>() -> {of}<C> {{")?;
    let problem = format!("the content is longer than the plan says of channel {}", channel.name);
    writeln!(out, "            const {{ ::core::assert!(C::LEN <= LENGTH, {problem:?}) }};")?;
    if let Some(layout) = layout {
        let hash = |hash: LayoutHash| format!("{CORE}::protocol::LayoutHash::new({:#010x})", hash.get());
        let (wire, layout_hash) = (hash(layout.wire_hash()), hash(layout.layout_hash()));
        let problem =
            format!("the fields of this type are not those that the plan states of content {}", layout.name);
        writeln!(out, "            const LAYOUT: {CORE}::protocol::LayoutHash = {layout_hash};")?;
        writeln!(out, "            const WIRE: {CORE}::protocol::LayoutHash = {wire};")?;
        let fits = format!("{CORE}::plan::content_fits(C::LAYOUT, WIRE, LAYOUT)");
        writeln!(out, "            const {{ ::core::assert!({fits}, {problem:?}) }};")?;
        writeln!(out, "            {value}.with_layout(LAYOUT)")?;
    } else {
        writeln!(out, "            {value}")?;
    }
    writeln!(out, "        }}")
}

/// What the channel's constructor is for; and the channel of the content that the description states.
fn write_docs(out: &mut String, layout: Option<&Layout>, of: &str) -> std::fmt::Result {
    let Some(layout) = layout else {
        return writeln!(
            out,
            "        /// The channel, for events of this content. It does not compile if they are longer."
        );
    };
    writeln!(out, "        /// The channel, for events of its content.")?;
    let content = layout.type_name();
    writeln!(out, "        pub const CHANNEL: {of}<super::super::contents::{content}> = channel();")?;
    writeln!(
        out,
        "        /// The channel, for content that was written in Rust or is taken as bytes. It does not"
    )?;
    writeln!(out, "        /// compile if its fields have other types than those of the description.")
}

/// The rate of a soft or non real-time channel; that of a hard one stands in the calendar.
fn rate(channel: &Channel) -> Option<String> {
    if matches!(channel.class, PlannedClass::Hard { .. }) {
        return None;
    }
    let of = format!("{CORE}::event_layer::EventRate");
    let mut rate = match channel.recurrence {
        Recurrence::Periodic(_) => format!("{of}::periodic(PERIOD)"),
        Recurrence::Sporadic(_) => format!("{of}::sporadic(MIN_INTERARRIVAL)"),
    };
    if channel.burst > 1 {
        rate += &format!(".with_burst({})", channel.burst);
    }
    if !channel.allowed_jitter.is_zero() {
        rate += &format!(".with_jitter({})", duration(channel.allowed_jitter));
    }
    Some(rate)
}

fn attributes(channel: &Channel, degree: Option<u8>) -> (String, String) {
    let of = |name: &str| format!("{CORE}::event_layer::{name}");
    match &channel.class {
        PlannedClass::Hard { omission_degree, .. } => {
            let periodic = matches!(channel.recurrence, Recurrence::Periodic(_));
            let period = duration(channel.recurrence.span());
            let omission_degree = degree.unwrap_or(*omission_degree);
            let of = of("HardAttributes");
            let fields =
                format!("period: {period}, periodic: {periodic}, omission_degree: {omission_degree}");
            (of.clone(), format!("{of} {{ {fields} }}"))
        }
        PlannedClass::Soft => {
            let deadline = channel.deadline.unwrap_or(channel.recurrence.span());
            let validity = duration(channel.validity.unwrap_or(deadline));
            let of = of("SoftAttributes");
            (of.clone(), format!("{of} {{ deadline: {}, validity: {validity} }}", duration(deadline)))
        }
        PlannedClass::NonRealTime { importance } => {
            let validity = match channel.validity {
                Some(validity) => format!("Some({})", duration(validity)),
                None => "None".to_owned(),
            };
            let importance = format!("{}::new({importance}).unwrap()", of("Importance"));
            let of = of("NonRealTimeAttributes");
            (of.clone(), format!("{of} {{ importance: {importance}, validity: {validity} }}"))
        }
    }
}
