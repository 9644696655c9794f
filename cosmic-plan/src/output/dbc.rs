//! The segment as a DBC file, so that other CAN tools decode it.
//!
//! DBC names frames by their whole identifier. A hard or non real-time frame has one. A soft one has as many as it has
//! priorities, since its priority rises as its deadline nears, which DBC cannot say. There are two ways out, and a
//! file for each:
//!
//! * [`Identifiers::One`]: a message stands there once for each publisher, a soft one with its most urgent identifier.
//!   For tools that compare a part of the identifier only, such as `cantools decode -m 0x3FFF`, which leaves the etag;
//!   where there are foreign frames with the number of an etag, [`Identifiers::Every`] is the safe way.
//! * [`Identifiers::Every`]: a soft message stands there once for every priority that it may have, so that any tool
//!   finds any frame by its whole identifier.
//!
//! Fields of the content are signals; of a channel without a content each byte is one. Events of more than 8 bytes
//! travel in fragments, which no signal describes. Channels whose etag the broker gives have no identifier that is known here.

use crate::cluster::{Channel, Cluster, Foreign, PlannedClass};
use crate::contents::{ByteOrder, FieldLayout, FieldType, Layout};
use cosmic_core::can::{Etag, Id, Payload, Priority};
use std::fmt::Write as _;

/// Which identifiers of a soft message are listed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Identifiers {
    /// The most urgent.
    One,
    /// All that it may have.
    Every,
}

/// The text of the file.
pub fn render(cluster: &Cluster, identifiers: Identifiers) -> String {
    let mut out = String::from("VERSION \"\"\n\nNS_ :\n\nBS_:\n\n");
    let nodes: Vec<&str> = cluster.nodes.iter().map(|node| node.name.as_str()).collect();
    // Writing into a string does not fail.
    let _ = writeln!(out, "BU_: {}\n", nodes.join(" "));
    let messages = messages(cluster, identifiers);
    for message in &messages {
        let _ = write_message(&mut out, message);
    }
    let _ = write_comments(&mut out, cluster, &messages);
    let _ = write_attributes(&mut out, &messages);
    for message in &messages {
        let _ = write_values(&mut out, message);
    }
    out
}

/// The text in the character set of DBC files, Windows-1252; what it cannot say becomes a question mark.
pub fn encode(text: &str) -> Vec<u8> {
    text.chars().map(|c| u8::try_from(u32::from(c)).unwrap_or(b'?')).collect()
}

struct DbcMessage<'a> {
    id: u32,
    name: String,
    length: u16,
    layout: Option<&'a Layout>,
    transmitter: String,
    receivers: Vec<String>,
    class: &'static str,
    period_ms: u64,
    comment: String,
}

/// DBC marks identifiers of 29 bits by the highest of 32.
const EXTENDED: u32 = 1 << 31;

fn messages(cluster: &Cluster, identifiers: Identifiers) -> Vec<DbcMessage<'_>> {
    let mut messages = Vec::new();
    for (at, channel) in cluster.channels.iter().enumerate() {
        // Without an etag the frames have no identifier that is known here.
        let Some(etag) = channel.etag else { continue };
        let publishers: Vec<_> = cluster.publishers(at).collect();
        for node in &publishers {
            for priority in priorities(cluster, channel, identifiers) {
                let mut name = channel.name.clone();
                if publishers.len() > 1 {
                    name += &format!("_of_{}", node.name);
                }
                if matches!(channel.class, PlannedClass::Soft) && priority != Priority::SOFT_MOST_URGENT {
                    name += &format!("_p{}", priority.get());
                }
                messages.push(DbcMessage {
                    id: EXTENDED | Id::new(priority, node.tx_node, etag).raw(),
                    name,
                    length: channel.length.min(Payload::MAX_LEN as u16),
                    layout: cluster.layout_of(channel),
                    transmitter: node.name.clone(),
                    receivers: cluster.subscribers(at).map(|node| node.name.clone()).collect(),
                    class: channel.class.abbreviation(),
                    period_ms: channel.recurrence.span().as_millis(),
                    comment: comment(cluster, channel, identifiers),
                });
            }
        }
    }
    messages.extend(sync_messages(cluster));
    messages.extend(cluster.foreign.iter().map(foreign_message));
    messages
}

/// The priorities that frames of a channel may have, as far as they are listed.
fn priorities(cluster: &Cluster, channel: &Channel, identifiers: Identifiers) -> Vec<Priority> {
    match &channel.class {
        PlannedClass::Hard { .. } => vec![Priority::HARD],
        PlannedClass::NonRealTime { importance } => vec![PlannedClass::priority_of(*importance)],
        PlannedClass::Soft if identifiers == Identifiers::One => vec![Priority::SOFT_MOST_URGENT],
        PlannedClass::Soft => (Priority::SOFT_MOST_URGENT.get()..=least_urgent(cluster, channel).get())
            .map(Priority::new)
            .collect(),
    }
}

/// The least urgent priority that a soft frame can have: that of an event which has all of its time.
pub fn least_urgent(cluster: &Cluster, channel: &Channel) -> Priority {
    let deadline = channel.deadline.unwrap_or(channel.recurrence.span()).as_ticks();
    let steps = deadline / cluster.priority_step.as_ticks().max(1);
    let first = Priority::SOFT_MOST_URGENT.get();
    let priority = u8::try_from(steps).unwrap_or(u8::MAX).saturating_add(first);
    Priority::new(priority.min(Priority::SOFT_LEAST_URGENT.get()))
}

fn comment(cluster: &Cluster, channel: &Channel, identifiers: Identifiers) -> String {
    let class = channel.class.abbreviation();
    let mut text = format!("{class} channel, subject {:#018x}.", channel.subject);
    if let Some(doc) = cluster.layout_of(channel).and_then(|layout| layout.doc.as_ref()) {
        text = format!("{doc} {text}");
    }
    if matches!(channel.class, PlannedClass::Soft) && identifiers == Identifiers::One {
        let last = least_urgent(cluster, channel).get();
        text += &format!(
            " Its priority (bits 28..21) varies from 1 to {last}: compare bits 13..0 alone, or use the file \
                          with every identifier."
        );
    }
    if usize::from(channel.length) > Payload::MAX_LEN {
        text += &format!(" Events of up to {} bytes, in fragments.", channel.length);
    }
    text
}

/// Sync and follow-up, from the node that becomes master if all are there.
fn sync_messages(cluster: &Cluster) -> Vec<DbcMessage<'_>> {
    let (Some(period), Some(master)) = (cluster.sync_period, cluster.nodes.first()) else {
        return Vec::new();
    };
    let message = |name: &str, etag: Etag| DbcMessage {
        id: EXTENDED | Id::new(Priority::SOFT_MOST_URGENT, master.tx_node, etag).raw(),
        name: name.to_owned(),
        length: 8,
        layout: None,
        transmitter: master.name.clone(),
        receivers: cluster.nodes[1..].iter().map(|node| node.name.clone()).collect(),
        class: "sync",
        period_ms: period.as_millis(),
        comment: "Clock synchronisation; another node may be master, with its own TxNode (bits 20..14)."
            .to_owned(),
    };
    vec![message("cosmic_sync", Etag::SYNC), message("cosmic_follow_up", Etag::FOLLOW_UP)]
}

fn foreign_message(frame: &Foreign) -> DbcMessage<'_> {
    let legal = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = frame.name.chars().map(legal).collect();
    DbcMessage {
        id: if frame.extended { EXTENDED | frame.id } else { frame.id },
        name: if name.starts_with(|c: char| c.is_ascii_digit()) { format!("frame_{name}") } else { name },
        length: u16::from(frame.length),
        layout: None,
        transmitter: "Vector__XXX".to_owned(),
        receivers: Vec::new(),
        class: "foreign",
        period_ms: frame.period.as_millis(),
        comment: "Not a frame of COSMIC.".to_owned(),
    }
}

/// Names of the signals of a field, each with its first bit.
fn signals(field: &FieldLayout) -> Vec<(String, usize)> {
    let name =
        |position: usize| field.count.map_or(field.name.clone(), |_| format!("{}_{position}", field.name));
    (0..field.values()).map(|position| (name(position), field.bit_of(position))).collect()
}

fn write_message(out: &mut String, message: &DbcMessage<'_>) -> std::fmt::Result {
    writeln!(out, "BO_ {} {}: {} {}", message.id, message.name, message.length, message.transmitter)?;
    let receivers =
        if message.receivers.is_empty() { "Vector__XXX".to_owned() } else { message.receivers.join(",") };
    match message.layout.filter(|layout| layout.len <= Payload::MAX_LEN) {
        Some(layout) => {
            for field in &layout.fields {
                for (name, at) in signals(field) {
                    write_signal(out, layout.order, field, &name, at, &receivers)?;
                }
            }
        }
        None => {
            for byte in 0..message.length {
                writeln!(out, " SG_ byte_{byte} : {}|8@1+ (1,0) [0|255] \"\" {receivers}", byte * 8)?;
            }
        }
    }
    writeln!(out)
}

fn write_signal(
    out: &mut String,
    order: ByteOrder,
    field: &FieldLayout,
    name: &str,
    at: usize,
    receivers: &str,
) -> std::fmt::Result {
    // DBC counts bits from the lowest of each byte; a Motorola signal is named by its highest bit.
    let (start, order) = match order {
        ByteOrder::Big => (at / 8 * 8 + 7 - at % 8, 0),
        ByteOrder::Little => (at, 1),
    };
    let signed = matches!(field.kind, FieldType::Signed(_)) || field.kind.is_float();
    let sign = if signed { '-' } else { '+' };
    let scaling = field.scaling_or_none();
    let (least, greatest) = match (field.range, field.kind.is_float()) {
        (Some((least, greatest)), _) => (least.to_string(), greatest.to_string()),
        // None is stated.
        (None, true) => ("0".to_owned(), "0".to_owned()),
        (None, false) => {
            (scaling.value(field.raw_range.0).to_string(), scaling.value(field.raw_range.1).to_string())
        }
    };
    let bits = field.kind.bits();
    let unit = quoted(field.unit.as_deref().unwrap_or(""));
    let (scale, offset) = (scaling.scale(), scaling.offset());
    writeln!(
        out,
        " SG_ {name} : {start}|{bits}@{order}{sign} ({scale},{offset}) [{least}|{greatest}] {unit} {receivers}"
    )
}

/// As DBC writes a string. A quotation mark has no place in one that all tools agree on.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace(['"', '\\'], "'"))
}

fn write_comments(out: &mut String, cluster: &Cluster, messages: &[DbcMessage<'_>]) -> std::fmt::Result {
    writeln!(out, "CM_ \"COSMIC segment {}.\";", cluster.name)?;
    for message in messages {
        writeln!(out, "CM_ BO_ {} {};", message.id, quoted(&message.comment))?;
        for field in fields(message) {
            for (name, _) in signals(field) {
                if let Some(doc) = &field.doc {
                    writeln!(out, "CM_ SG_ {} {name} {};", message.id, quoted(doc))?;
                }
            }
        }
    }
    Ok(())
}

/// The fields that are signals.
fn fields<'a>(message: &DbcMessage<'a>) -> &'a [FieldLayout] {
    message.layout.filter(|layout| layout.len <= Payload::MAX_LEN).map_or(&[], |layout| &layout.fields)
}

fn write_attributes(out: &mut String, messages: &[DbcMessage<'_>]) -> std::fmt::Result {
    writeln!(out, "BA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 3600000;")?;
    writeln!(out, "BA_DEF_ BO_ \"CosmicClass\" STRING;")?;
    writeln!(out, "BA_DEF_DEF_ \"GenMsgCycleTime\" 0;")?;
    writeln!(out, "BA_DEF_DEF_ \"CosmicClass\" \"\";")?;
    for message in messages {
        writeln!(out, "BA_ \"GenMsgCycleTime\" BO_ {} {};", message.id, message.period_ms)?;
        writeln!(out, "BA_ \"CosmicClass\" BO_ {} \"{}\";", message.id, message.class)?;
    }
    Ok(())
}

/// Names of values, and which signals are floating-point numbers.
fn write_values(out: &mut String, message: &DbcMessage<'_>) -> std::fmt::Result {
    for field in fields(message) {
        for (name, _) in signals(field) {
            if !field.labels.is_empty() {
                let of = |label: &crate::contents::Label| format!("{} {}", label.raw, quoted(&label.name));
                let labels: Vec<String> = field.labels.iter().map(of).collect();
                writeln!(out, "VAL_ {} {name} {} ;", message.id, labels.join(" "))?;
            }
            match field.kind {
                FieldType::Single => writeln!(out, "SIG_VALTYPE_ {} {name} : 1;", message.id)?,
                FieldType::Double => writeln!(out, "SIG_VALTYPE_ {} {name} : 2;", message.id)?,
                _ => {}
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;

    #[test]
    fn another_parser_reads_it() {
        let cluster =
            Cluster::read(&Source::new("a.toml", crate::cluster::EXAMPLE)).expect("the example is good");
        let text = render(&cluster, Identifiers::One);
        let read = can_dbc::Dbc::try_from(text.as_str()).expect("it is a DBC file");
        assert_eq!(read.messages.len(), cluster.channels.len() + 2);
        let wheel_speed = read.messages.iter().find(|m| m.name == "wheel_speed").expect("it is there");
        assert_eq!(wheel_speed.id, can_dbc::MessageId::Extended(1 << 14 | 100));
        let signals: Vec<_> = wheel_speed.signals.iter().map(|signal| &*signal.name).collect();
        assert_eq!(signals, ["sequence", "speed", "valid"]);
        assert_eq!(wheel_speed.transmitter.as_deref(), Some("sensor"));
    }

    #[test]
    fn without_a_content_each_byte_is_a_signal() {
        let text = crate::cluster::EXAMPLE.replace("content = \"wheel_speed\"", "length = 7");
        let cluster = Cluster::read(&Source::new("a.toml", text)).expect("it is good, too");
        let text = render(&cluster, Identifiers::One);
        let read = can_dbc::Dbc::try_from(text.as_str()).expect("it is a DBC file");
        let wheel_speed = read.messages.iter().find(|m| m.name == "wheel_speed").expect("it is there");
        assert_eq!(wheel_speed.signals.len(), 7);
    }

    #[test]
    fn every_identifier_that_a_soft_frame_may_have_is_listed() {
        let cluster =
            Cluster::read(&Source::new("a.toml", crate::cluster::EXAMPLE)).expect("the example is good");
        let text = render(&cluster, Identifiers::Every);
        let read = can_dbc::Dbc::try_from(text.as_str()).expect("it is a DBC file");
        let suspension = read.messages.iter().filter(|m| m.name.starts_with("suspension")).count();
        // 2 ms of deadline in steps of 160 us.
        assert_eq!(suspension, 13);
        let temperature = read.messages.iter().filter(|m| m.name.starts_with("temperature")).count();
        assert_eq!(temperature, 63);
    }

    #[test]
    fn its_character_set_is_that_of_other_tools() {
        assert_eq!(encode("°C µ Ω"), [0xB0, b'C', b' ', 0xB5, b' ', b'?']);
    }
}
