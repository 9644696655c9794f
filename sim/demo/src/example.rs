//! The example cluster as the judge knows it: nodes, channels, calendar.
//!
//! The images are built from the same plan. The digest of the calendar travels in every sync frame, so images
//! of another plan are found out.

use std::sync::LazyLock;

use cosmic_core::Subject;
use cosmic_core::calendar::Calendar;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::SoftAttributes;
use cosmic_core::time::Duration;

/// What the judge has to know of a cluster.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Cluster {
    /// When which hard real-time frame may be on the bus.
    pub calendar: &'static Calendar,
    /// How often the time master sends its time.
    pub sync_period: Duration,
    /// The nodes.
    pub nodes: Vec<Node>,
    /// The event channels.
    pub channels: Vec<Channel>,
}

/// A node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Node {
    /// Its name, which is also that of its image.
    pub name: &'static str,
    /// Its short id.
    pub tx_node: TxNode,
}

/// An event channel.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Channel {
    /// What it is called in tables.
    pub name: &'static str,
    /// Its etag.
    pub etag: Etag,
    /// Its class and what that asks for.
    pub class: Promise,
    /// Who publishes.
    pub publisher: TxNode,
    /// Who subscribes.
    pub subscribers: Vec<TxNode>,
}

/// What a channel promises: its class, and what that asks for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Promise {
    /// Hard real-time; the calendar says the rest.
    Hard,
    /// Soft real-time.
    Soft {
        /// From publication until an event should have been sent.
        deadline: Duration,
        /// From publication until an event is of no use any more.
        validity: Duration,
    },
    /// Non real-time.
    NonRealTime,
}

impl Promise {
    /// The class as it stands in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hard => "HRT",
            Self::Soft { .. } => "SRT",
            Self::NonRealTime => "NRT",
        }
    }
}

impl Cluster {
    /// The node with this id.
    pub fn node(&self, tx_node: TxNode) -> Option<&Node> {
        self.nodes.iter().find(|node| node.tx_node == tx_node)
    }

    /// The name of a node, for messages.
    pub fn name(&self, tx_node: TxNode) -> &'static str {
        self.node(tx_node).map_or("another node", |node| node.name)
    }

    /// The channel with this etag.
    pub fn channel(&self, etag: Etag) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.etag == etag)
    }
}

/// The cluster of the example firmware.
pub static EXAMPLE: LazyLock<Cluster> = LazyLock::new(|| {
    use plan::channels::{brake_force, logbook, suspension, temperature, wheel_speed};
    let nodes = vec![
        node(plan::nodes::sensor::NAME, plan::nodes::sensor::TX_NODE),
        node(plan::nodes::brake::NAME, plan::nodes::brake::TX_NODE),
        node(plan::nodes::diagnostics::NAME, plan::nodes::diagnostics::TX_NODE),
    ];
    let soft = |it: SoftAttributes| Promise::Soft { deadline: it.deadline, validity: it.validity };
    let channels = vec![
        channel("wheel speed", wheel_speed::SUBJECT, wheel_speed::ETAG, Promise::Hard),
        channel("temperature", temperature::SUBJECT, temperature::ETAG, soft(temperature::ATTRIBUTES)),
        channel("brake force", brake_force::SUBJECT, brake_force::ETAG, soft(brake_force::ATTRIBUTES)),
        channel("suspension", suspension::SUBJECT, suspension::ETAG, soft(suspension::ATTRIBUTES)),
        channel("logbook", logbook::SUBJECT, logbook::ETAG, Promise::NonRealTime),
    ];
    let sync_period = plan::SYNC.period;
    Cluster {
        calendar: &plan::CALENDAR,
        sync_period,
        nodes,
        channels: channels.into_iter().flatten().collect(),
    }
});

cosmic_core::include_plan!();

fn node(name: &'static str, tx_node: TxNode) -> Node {
    Node { name, tx_node }
}

/// A channel of the plan; `None` if nobody publishes on it.
fn channel(name: &'static str, subject: Subject, etag: Etag, class: Promise) -> Option<Channel> {
    use plan::nodes::{brake, diagnostics, sensor};
    let nodes = [
        (sensor::TX_NODE, sensor::PUBLISHES, sensor::SUBSCRIBES),
        (brake::TX_NODE, brake::PUBLISHES, brake::SUBSCRIBES),
        (diagnostics::TX_NODE, diagnostics::PUBLISHES, diagnostics::SUBSCRIBES),
    ];
    let publisher = nodes.iter().find(|(_, publishes, _)| publishes.contains(&subject))?.0;
    let subscribers = nodes.iter().filter(|(.., subscribes)| subscribes.contains(&subject));
    Some(Channel { name, etag, class, publisher, subscribers: subscribers.map(|it| it.0).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_example_is_whole() {
        let names: Vec<_> = EXAMPLE.channels.iter().map(|channel| channel.name).collect();
        assert_eq!(names, ["wheel speed", "temperature", "brake force", "suspension", "logbook"]);
        for channel in &EXAMPLE.channels {
            assert!(!channel.subscribers.is_empty(), "{}", channel.name);
            assert_eq!(channel.class == Promise::Hard, channel.etag.is_hard());
            assert!(EXAMPLE.node(channel.publisher).is_some());
        }
        let hard = EXAMPLE.channels.iter().filter(|channel| channel.class == Promise::Hard);
        assert!(hard.map(|it| it.etag).eq(EXAMPLE.calendar.slots().iter().map(|slot| slot.etag)));
    }
}
