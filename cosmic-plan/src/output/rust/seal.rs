//! What the nodes of a sealed cluster believe.

use super::{CORE, subject};
use crate::cluster::{Cluster, Node, PlannedClass};
use std::fmt::Write as _;

pub(super) fn write(out: &mut String, cluster: &Cluster) -> std::fmt::Result {
    let Some(brokers) = &cluster.sealed else { return Ok(()) };
    writeln!(out, "/// What a node believes of others, and nothing else.")?;
    writeln!(out, "pub static SEAL: {CORE}::seal::Seal = {CORE}::seal::Seal {{")?;
    writeln!(out, "    nodes: &[")?;
    for node in &cluster.nodes {
        let rank = match node.rank.filter(|_| cluster.sync_period.is_some()) {
            Some(rank) => format!("{CORE}::protocol::Rank::new({})", rank.get()),
            None => "None".to_owned(),
        };
        let fields = format!("uid: {}, tx_node: {}, rank: {rank}", uid(node), tx_node(node));
        writeln!(out, "        {CORE}::seal::SealedNode {{ {fields} }},")?;
    }
    writeln!(out, "    ],\n    channels: &[")?;
    for (at, channel) in cluster.channels.iter().enumerate() {
        // Each has one: the description of a sealed cluster says so.
        let Some(etag) = channel.etag else { continue };
        let class = match channel.class {
            PlannedClass::Hard { .. } => "Hard",
            PlannedClass::Soft => "Soft",
            PlannedClass::NonRealTime { .. } => "NonRealTime",
        };
        let publishers: Vec<String> = cluster.publishers(at).map(tx_node).collect();
        writeln!(out, "        {CORE}::seal::SealedChannel {{")?;
        writeln!(out, "            subject: {},", subject(channel.subject))?;
        writeln!(out, "            etag: {CORE}::can::Etag::new({}).unwrap(),", etag.get())?;
        writeln!(out, "            class: {CORE}::event_layer::Class::{class},")?;
        writeln!(out, "            publishers: {CORE}::can::TxNodes::of(&[{}]),", publishers.join(", "))?;
        writeln!(out, "        }},")?;
    }
    let brokers: Vec<String> = brokers.iter().map(|at| uid(&cluster.nodes[*at])).collect();
    writeln!(out, "    ],\n    brokers: &[{}],\n}};\n", brokers.join(", "))
}

fn uid(node: &Node) -> String {
    format!("{CORE}::NodeUid::new({:#018x}).unwrap()", node.uid)
}

fn tx_node(node: &Node) -> String {
    format!("{CORE}::can::TxNode::new({}).unwrap()", node.tx_node.get())
}
