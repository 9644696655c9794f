//! The nodes: who each is, what it takes part in, and the filters of its controller.

use super::{CORE, SYNC_CONFIG, subject};
use crate::cluster::Cluster;
use crate::node_filters::is_named_at_run_time;
use cosmic_core::can::Id;
use cosmic_core::can::filter_banks::{Fifo, FilterBank};
use std::fmt::Write as _;

pub(super) fn write(out: &mut String, cluster: &Cluster, filters: &[Vec<FilterBank>]) -> std::fmt::Result {
    writeln!(out, "/// The nodes, one module each.")?;
    writeln!(out, "pub mod nodes {{")?;
    for (at, filters) in filters.iter().enumerate() {
        write_node(out, cluster, at, filters)?;
    }
    writeln!(out, "}}\n")?;
    writeln!(out, "/// All nodes, in the order of the description.")?;
    writeln!(out, "pub const NODES: [{CORE}::plan::NodePlan; {}] = [", cluster.nodes.len())?;
    for node in &cluster.nodes {
        writeln!(out, "    nodes::{}::NODE,", node.name)?;
    }
    writeln!(out, "];")
}

fn write_node(out: &mut String, cluster: &Cluster, at: usize, filters: &[FilterBank]) -> std::fmt::Result {
    let node = &cluster.nodes[at];
    writeln!(out, "    /// Node `{}`.", node.name)?;
    writeln!(out, "    pub mod {} {{", node.name)?;
    let mut constant = |doc: &str, name: &str, of: &str, value: &str| {
        writeln!(out, "        /// {doc}\n        pub const {name}: {of} = {value};")
    };
    constant("Its name.", "NAME", "&str", &format!("{:?}", node.name))?;
    let uid = format!("{CORE}::NodeUid::new({:#018x}).unwrap()", node.uid);
    constant("Its UID.", "UID", "::cosmic_core::NodeUid", &uid)?;
    let tx_node = format!("{CORE}::can::TxNode::new({})", node.tx_node.get());
    let tx_node = if node.asks { "None" } else { &tx_node };
    let doc = "Its short id; `None`: it asks for one.";
    constant(doc, "TX_NODE", "Option<::cosmic_core::can::TxNode>", tx_node)?;
    let rank = match node.rank.filter(|_| cluster.sync_period.is_some()) {
        Some(rank) => format!("{CORE}::protocol::Rank::new({})", rank.get()),
        None => "None".to_owned(),
    };
    let doc = "Its place in the succession of time masters.";
    constant(doc, "RANK", "Option<::cosmic_core::protocol::Rank>", &rank)?;
    let list = "&[::cosmic_core::Subject]";
    constant("What it publishes.", "PUBLISHES", list, &subjects(cluster, &node.publishes))?;
    constant("What it subscribes to.", "SUBSCRIBES", list, &subjects(cluster, &node.subscribes))?;
    let of = format!("[{CORE}::can::filter_banks::FilterBank; {}]", filters.len());
    constant("Which frames its controller accepts.", "FILTERS", &of, &banks(filters))?;
    let sync = match cluster.sync_period {
        Some(_) => format!("Some({SYNC_CONFIG} {{ rank: RANK, ..super::super::SYNC }})"),
        None => "None".to_owned(),
    };
    let seal = if cluster.sealed.is_some() { "Some(&super::super::SEAL)" } else { "None" };
    let admission = if cluster.unplanned.is_some() { "Some(&super::super::ADMISSION)" } else { "None" };
    let fields = format!(
        "name: NAME, uid: UID, tx_node: TX_NODE, sync: {sync}, filters: &FILTERS, \
         named_at_run_time: {}, calendar: &super::super::CALENDAR, seal: {seal}, admission: {admission}, publishes: PUBLISHES, subscribes: SUBSCRIBES",
        is_named_at_run_time(cluster, at)
    );
    let of = "::cosmic_core::plan::NodePlan";
    constant("All of it that a runtime wants to know.", "NODE", of, &format!("{of} {{ {fields} }}"))?;
    writeln!(out, "    }}")
}

fn subjects(cluster: &Cluster, channels: &[usize]) -> String {
    let list: Vec<String> = channels.iter().map(|c| subject(cluster.channels[*c].subject)).collect();
    format!("&[{}]", list.join(", "))
}

fn banks(filters: &[FilterBank]) -> String {
    let mut text = "[\n".to_owned();
    for filter in filters {
        // Writing into a string does not fail.
        let _ = writeln!(text, "            {},", bank(filter));
    }
    text + "        ]"
}

fn bank(filter: &FilterBank) -> String {
    let of = format!("{CORE}::can::filter_banks");
    let fifo = match filter.fifo() {
        Fifo::Urgent => format!("{of}::Fifo::Urgent"),
        Fifo::Other => format!("{of}::Fifo::Other"),
    };
    match filter {
        FilterBank::Mask { id, mask, .. } => {
            format!("{of}::FilterBank::Mask {{ fifo: {fifo}, id: {id:#010x}, mask: {mask:#010x} }}")
        }
        FilterBank::List { ids, .. } => {
            let id = |id: Id| format!("{CORE}::can::Id::from_raw({:#010x}).unwrap()", id.raw());
            let ids = ids.map(id).join(", ");
            format!("{of}::FilterBank::List {{ fifo: {fifo}, ids: [{ids}] }}")
        }
    }
}
