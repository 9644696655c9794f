//! Nodes that ask the broker for their short id: `tx_node = "ask"`.

use super::Checker;
use crate::cluster::format::NodeTable;
use crate::cluster::{Binding, Cluster, PlannedClass};

impl Checker<'_> {
    /// Somebody must be there to ask, and the calendar must not need what is not known.
    pub(super) fn asking(&self, tables: &[NodeTable], cluster: &Cluster) {
        for (table, node) in tables.iter().zip(&cluster.nodes).filter(|(_, node)| node.asks) {
            let Some(at) = &table.tx_node else { continue };
            let field = || format!("node.{}.tx_node", node.name);
            if cluster.sealed.is_some() {
                let help =
                    "write a number, or leave it out: in a sealed cluster each node is known by its id";
                self.problem(&at.place, field(), "nobody gives ids in a sealed cluster", help);
            } else if cluster.binding == Binding::Static {
                let help = "write binding = \"broker\" in [segment], or a number, or leave it out";
                self.problem(&at.place, field(), "there is no broker to ask with binding = \"static\"", help);
            }
            let hard = node.publishes.iter().map(|at| &cluster.channels[*at]);
            for channel in hard.filter(|channel| matches!(channel.class, PlannedClass::Hard { .. })) {
                let what = format!(
                    "a slot belongs to a short id that the plan knows, and it publishes `{}`, which is hard",
                    channel.name
                );
                let help = "write a number, or leave it out, or let another node publish that channel";
                self.problem(&at.place, field(), what, help);
            }
        }
    }
}
