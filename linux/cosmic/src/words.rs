//! Words that a list and a screen share.

use cosmic_monitor::{ChannelView, NodeView};

/// What a node does for the others.
pub(crate) fn role(node: &NodeView) -> Option<&'static str> {
    match (node.is_broker, node.is_master) {
        (true, true) => Some("broker, time"),
        (true, false) => Some("broker"),
        (false, true) => Some("time"),
        (false, false) => None,
    }
}

/// The last content, by its fields or in hexadecimal digits.
pub(crate) fn last(channel: &ChannelView) -> Option<String> {
    let last = channel.last.as_ref()?;
    let fields: Vec<String> = last.fields.iter().map(ToString::to_string).collect();
    Some(if fields.is_empty() { last.data.clone() } else { fields.join(" ") })
}
