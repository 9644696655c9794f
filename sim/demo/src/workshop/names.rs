//! Who has which id, and which subject which etag.

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::protocol::{Answer, ControlMessage, SupplyEtag};
use cosmic_plan::cluster::Cluster;

use super::{LAMP, LAMP_STARTS_ANEW, Story, starts};

/// An id that a node came to have.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Name {
    /// The node.
    pub(super) node: String,
    /// Its id.
    pub(super) tx_node: TxNode,
    /// How long after it was switched on, in milliseconds.
    pub(super) after: u64,
}

/// A subject, and the etag that it was bound to.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Bound {
    /// The channel, if the plan has it.
    pub(super) channel: Option<String>,
    /// Its subject.
    pub(super) subject: u64,
    /// The etag.
    pub(super) etag: Etag,
}

/// The ids, in the order in which nodes had them.
pub(super) fn ids(workshop: &Cluster, story: &Story) -> Vec<Name> {
    let started = |node: &str, at: u64| match workshop.nodes.iter().position(|it| it.name == node) {
        _ if node == LAMP && at >= LAMP_STARTS_ANEW => LAMP_STARTS_ANEW,
        place => starts(place.unwrap_or(0) as u64),
    };
    let name = |line: &super::Line| {
        let id = line.text.strip_prefix("Configured(TxNode(")?.strip_suffix("))")?.parse().ok()?;
        let after = line.at.saturating_sub(started(&line.node, line.at));
        Some(Name { node: line.node.clone(), tx_node: TxNode::new(id)?, after })
    };
    story.lines.iter().filter_map(name).collect()
}

/// What the broker told on the bus, each once, in the order of time.
pub(super) fn bound(workshop: &Cluster, story: &Story) -> Vec<Bound> {
    let mut all: Vec<Bound> = Vec::new();
    let mut first: Option<SupplyEtag> = None;
    for sent in &story.frames {
        let Some(ControlMessage::SupplyEtag(half)) = ControlMessage::decode(&sent.frame) else { continue };
        let subject = first.replace(half).and_then(|first| first.joined(&half));
        let (Some(subject), Answer::Bound(etag)) = (subject, half.answer()) else { continue };
        let channel = workshop.channels.iter().find(|it| it.subject == subject.get());
        let one = Bound { channel: channel.map(|it| it.name.clone()), subject: subject.get(), etag };
        if !all.contains(&one) {
            all.push(one);
        }
    }
    all
}
