//! The segment as a DBC file, so that other CAN tools decode it.
//!
//! DBC names frames by their whole identifier. A hard real-time frame has one; a soft one has as many as it
//! has priorities, which DBC cannot say: it stands here with its most urgent one, and a comment and the
//! attribute `CosmicClass` say so. (Tools that mask the priority, as for J1939, then match all.) The
//! content of events is the application's, so each byte is a signal.

use crate::cluster::{Class, Cluster, Foreign};
use cosmic_core::can::{Etag, Id, Priority};
use std::fmt::Write as _;

/// The text of the file.
pub fn render(cluster: &Cluster) -> String {
    let mut out = String::from("VERSION \"\"\n\nNS_ :\n\nBS_:\n\n");
    let nodes: Vec<&str> = cluster.nodes.iter().map(|node| node.name.as_str()).collect();
    // Writing into a string does not fail.
    let _ = writeln!(out, "BU_: {}\n", nodes.join(" "));
    let messages = messages(cluster);
    for message in &messages {
        let _ = write_message(&mut out, message);
    }
    let _ = write_attributes(&mut out, cluster, &messages);
    out
}

struct DbcMessage {
    id: u32,
    name: String,
    length: u16,
    transmitter: String,
    receivers: Vec<String>,
    class: &'static str,
    period_ms: u64,
    comment: String,
}

/// DBC marks identifiers of 29 bits by the highest of 32.
const EXTENDED: u32 = 1 << 31;

fn messages(cluster: &Cluster) -> Vec<DbcMessage> {
    let mut messages = Vec::new();
    for (at, channel) in cluster.channels.iter().enumerate() {
        // Without an etag the frames have no identifier that is known here.
        let Some(etag) = channel.etag else { continue };
        let publishers: Vec<_> = cluster.publishers(at).collect();
        for node in &publishers {
            let priority = match &channel.class {
                Class::Hard { .. } => Priority::HARD,
                Class::Soft => Priority::SOFT_MOST_URGENT,
                Class::NonRealTime { importance } => Class::priority_of(*importance),
            };
            let shared = publishers.len() > 1;
            let name =
                if shared { format!("{}_of_{}", channel.name, node.name) } else { channel.name.clone() };
            let class = channel.class.abbreviation();
            let varies = match channel.class {
                Class::Soft => " Its priority field (bits 28..21) varies from 1 to 249.",
                _ => "",
            };
            messages.push(DbcMessage {
                id: EXTENDED | Id::new(priority, node.tx_node, etag).raw(),
                name,
                length: channel.length.min(8),
                transmitter: node.name.clone(),
                receivers: cluster.subscribers(at).map(|node| node.name.clone()).collect(),
                class,
                period_ms: channel.recurrence.span().as_millis(),
                comment: format!("{class} channel, subject {:#018x}.{varies}", channel.subject),
            });
        }
    }
    messages.extend(sync_messages(cluster));
    messages.extend(cluster.foreign.iter().map(foreign_message));
    messages
}

/// Sync and follow-up, from the node that becomes master if all are there.
fn sync_messages(cluster: &Cluster) -> Vec<DbcMessage> {
    let (Some(period), Some(master)) = (cluster.sync_period, cluster.nodes.first()) else {
        return Vec::new();
    };
    let message = |name: &str, etag: Etag| DbcMessage {
        id: EXTENDED | Id::new(Priority::SOFT_MOST_URGENT, master.tx_node, etag).raw(),
        name: name.to_owned(),
        length: 8,
        transmitter: master.name.clone(),
        receivers: cluster.nodes[1..].iter().map(|node| node.name.clone()).collect(),
        class: "sync",
        period_ms: period.as_millis(),
        comment: "Clock synchronisation; another node may be master, with its own TxNode (bits 20..14)."
            .to_owned(),
    };
    vec![message("cosmic_sync", Etag::SYNC), message("cosmic_follow_up", Etag::FOLLOW_UP)]
}

fn foreign_message(frame: &Foreign) -> DbcMessage {
    let legal = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = frame.name.chars().map(legal).collect();
    DbcMessage {
        id: if frame.extended { EXTENDED | frame.id } else { frame.id },
        name: if name.starts_with(|c: char| c.is_ascii_digit()) { format!("frame_{name}") } else { name },
        length: u16::from(frame.length),
        transmitter: "Vector__XXX".to_owned(),
        receivers: Vec::new(),
        class: "foreign",
        period_ms: frame.period.as_millis(),
        comment: "Not a frame of COSMIC.".to_owned(),
    }
}

fn write_message(out: &mut String, message: &DbcMessage) -> std::fmt::Result {
    writeln!(out, "BO_ {} {}: {} {}", message.id, message.name, message.length, message.transmitter)?;
    let receivers =
        if message.receivers.is_empty() { "Vector__XXX".to_owned() } else { message.receivers.join(",") };
    for byte in 0..message.length {
        writeln!(out, " SG_ byte_{byte} : {}|8@1+ (1,0) [0|255] \"\" {receivers}", byte * 8)?;
    }
    writeln!(out)
}

fn write_attributes(out: &mut String, cluster: &Cluster, messages: &[DbcMessage]) -> std::fmt::Result {
    writeln!(out, "CM_ \"COSMIC segment {}.\";", cluster.name)?;
    for message in messages {
        writeln!(out, "CM_ BO_ {} \"{}\";", message.id, message.comment)?;
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;

    #[test]
    fn another_parser_reads_it() {
        let cluster =
            Cluster::read(&Source::new("a.toml", crate::cluster::EXAMPLE)).expect("the example is good");
        let text = render(&cluster);
        let read = can_dbc::Dbc::try_from(text.as_str()).expect("it is a DBC file");
        assert_eq!(read.messages.len(), cluster.channels.len() + 2);
        let wheel_speed = read.messages.iter().find(|m| m.name == "wheel_speed").expect("it is there");
        assert_eq!(wheel_speed.id, can_dbc::MessageId::Extended(1 << 14 | 100));
        assert_eq!(wheel_speed.signals.len(), 7);
        assert_eq!(wheel_speed.transmitter.as_deref(), Some("sensor"));
    }
}
