//! Whether the cluster is sealed, what becomes of what is not in its file, and what no cluster may use.

use super::{Checker, name_of};
use crate::cluster::Binding;
use crate::cluster::format::{ChannelTable, NodeTable, SegmentTable};
use crate::cluster::values::{BindingName, UnplannedName};
use crate::document::nearest;
use cosmic_core::Subject;
use cosmic_core::admission::Unplanned;

impl Checker<'_> {
    /// The nodes that may host a broker, if the cluster is sealed.
    pub(super) fn sealing(&self, table: &SegmentTable, nodes: &[NodeTable]) -> Option<Vec<usize>> {
        let sealed = table.sealed.as_ref().filter(|at| at.value);
        if let (None, Some(at)) = (sealed, table.brokers.first()) {
            let help = "write sealed = true beside it, or leave it out: in an open cluster any node may be";
            self.problem(&at.place, "segment.brokers".to_owned(), "has no effect in an open cluster", help);
        }
        let sealed = sealed?;
        if table.binding.as_ref().is_some_and(|at| matches!(at.value, BindingName::Broker)) {
            let help = "write binding = \"static\", so that the plan fixes them, or leave `sealed` out";
            let what = "the etags of a sealed cluster are fixed, and not found by a broker";
            self.problem(&sealed.place, "segment.sealed".to_owned(), what, help);
        }
        let names: Vec<&str> = nodes.iter().map(|node| name_of(&node.name)).collect();
        let position = |at: &crate::document::At<String>| {
            let found = names.iter().position(|name| *name == at.value);
            if found.is_none() {
                let help = match nearest(&at.value, names.iter().copied()) {
                    Some(name) => format!("did you mean `{name}`?"),
                    None => "name a [[node]]".to_owned(),
                };
                let what = format!("there is no node {:?}", at.value);
                self.problem(&at.place, "segment.brokers".to_owned(), what, help);
            }
            found
        };
        Some(table.brokers.iter().filter_map(position).collect())
    }

    /// What becomes of soft real-time channels that are not in the file.
    pub(super) fn unplanned(&self, table: &SegmentTable, binding: Binding) -> Option<Unplanned> {
        let sealed = table.sealed.as_ref().is_some_and(|at| at.value);
        match &table.unplanned {
            Some(at) if sealed => {
                let help = "leave it out: a sealed cluster refuses whatever is not in its file";
                self.problem(
                    &at.place,
                    "segment.unplanned".to_owned(),
                    "has no effect in a sealed cluster",
                    help,
                );
                None
            }
            Some(at) => match at.value {
                UnplannedName::Allow => None,
                UnplannedName::Ask => Some(Unplanned::Ask),
                UnplannedName::Refuse => Some(Unplanned::Refuse),
                UnplannedName::NonRealTime => Some(Unplanned::NonRealTime),
            },
            None => (binding == Binding::Broker && !sealed).then_some(Unplanned::Ask),
        }
    }

    /// Brokers find each other by a subject that no channel has.
    pub(super) fn reserved_subjects(&self, tables: &[ChannelTable]) {
        for table in tables {
            let Some(at) = table.subject.as_ref().filter(|at| at.value.0 == Subject::RESERVED.get()) else {
                continue;
            };
            let field = format!("channel.{}.subject", name_of(&table.name));
            self.problem(&at.place, field, "is reserved for brokers", "choose another subject");
        }
    }
}
