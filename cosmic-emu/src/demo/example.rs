//! The example cluster as the judge knows it: nodes, channels, calendar.
//!
//! The images carry the same facts (`firmware/src/cluster.rs`). The digest of the calendar travels in every
//! sync frame, so a calendar that differs from this one is found out, not assumed.

use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::time::Duration;

/// What the judge has to know of a cluster.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cluster {
    /// When which hard real-time frame may be on the bus.
    pub calendar: &'static Calendar,
    /// The nodes.
    pub nodes: &'static [Node],
    /// The event channels.
    pub channels: &'static [Channel],
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
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Channel {
    /// What it is called in tables.
    pub name: &'static str,
    /// Its etag.
    pub etag: Etag,
    /// Its class and what that asks for.
    pub class: Class,
    /// Who publishes.
    pub publisher: TxNode,
    /// Who subscribes.
    pub subscribers: &'static [TxNode],
}

/// The class of a channel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Class {
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

impl Class {
    /// As it stands in tables.
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
    pub fn node(&self, tx_node: TxNode) -> Option<&'static Node> {
        self.nodes.iter().find(|node| node.tx_node == tx_node)
    }

    /// The name of a node, for messages.
    pub fn name(&self, tx_node: TxNode) -> &'static str {
        self.node(tx_node).map_or("another node", |node| node.name)
    }

    /// The channel with this etag.
    pub fn channel(&self, etag: Etag) -> Option<&'static Channel> {
        self.channels.iter().find(|channel| channel.etag == etag)
    }
}

/// The cluster of the example firmware.
pub static EXAMPLE: Cluster = Cluster { calendar: &CALENDAR, nodes: &NODES, channels: &CHANNELS };

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(50),
        release_jitter: Duration::from_micros(20),
    },
    Duration::from_millis(10),
    &[Slot {
        etag: WHEEL_SPEED,
        publisher: SENSOR,
        len: 8,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(2),
    }],
);

static NODES: [Node; 3] = [
    Node { name: "sensor", tx_node: SENSOR },
    Node { name: "brake", tx_node: BRAKE },
    Node { name: "diagnostics", tx_node: DIAGNOSTICS },
];

static CHANNELS: [Channel; 5] = [
    Channel {
        name: "wheel speed",
        etag: WHEEL_SPEED,
        class: Class::Hard,
        publisher: SENSOR,
        subscribers: &[BRAKE, DIAGNOSTICS],
    },
    Channel {
        name: "temperature",
        etag: etag(0x3FFF),
        class: Class::Soft { deadline: Duration::from_millis(10), validity: Duration::from_millis(40) },
        publisher: SENSOR,
        subscribers: &[BRAKE],
    },
    Channel {
        name: "brake force",
        etag: etag(0x3FFE),
        class: Class::Soft { deadline: Duration::from_millis(4), validity: Duration::from_millis(20) },
        publisher: BRAKE,
        subscribers: &[DIAGNOSTICS],
    },
    Channel {
        name: "suspension",
        etag: etag(0x3FFD),
        class: Class::Soft { deadline: Duration::from_millis(2), validity: Duration::from_millis(8) },
        publisher: DIAGNOSTICS,
        subscribers: &[BRAKE],
    },
    Channel {
        name: "logbook",
        etag: etag(0x3FFC),
        class: Class::NonRealTime,
        publisher: DIAGNOSTICS,
        subscribers: &[SENSOR],
    },
];

const WHEEL_SPEED: Etag = etag(100);
const SENSOR: TxNode = tx_node(1);
const BRAKE: TxNode = tx_node(2);
const DIAGNOSTICS: TxNode = tx_node(3);

const fn etag(value: u16) -> Etag {
    Etag::new(value).unwrap()
}

const fn tx_node(value: u8) -> TxNode {
    TxNode::new(value).unwrap()
}
