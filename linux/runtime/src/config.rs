//! What a node is told at its start.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Mutex, PoisonError};

use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::NodeConfig;
use cosmic_core::sync::{SyncConfig, SyncConfigError};
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};

/// What a node is told at its start.
#[derive(Clone, Debug)]
pub struct Config {
    /// Its name, fixed TxNode and the spans of its services.
    pub node: NodeConfig,
    /// The calendar of the segment; one [without slots](calendar_without_slots) if it has no hard real-time.
    pub calendar: &'static Calendar,
    /// Hosts the broker of the segment, or a standby, with this table.
    pub broker: Option<BrokerTables>,
}

/// The ids and etags that a broker has handed out.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct BrokerTables {
    /// The ids of the nodes.
    pub nodes: Vec<(NodeUid, TxNode)>,
    /// The etags of the subjects.
    pub subjects: Vec<(Subject, Etag)>,
}

impl Config {
    /// A node that is given its TxNode by the segment's broker, on a segment of 1 Mbit/s without calendar.
    pub fn new(uid: NodeUid) -> Self {
        Self {
            node: NodeConfig { noise: noise(), ..NodeConfig::new(uid) },
            calendar: calendar_without_slots(BitRate::MAX),
            broker: None,
        }
    }

    /// A node as the plan of its cluster has it.
    pub fn of_plan(plan: &NodePlan) -> Self {
        let clock = plan.sync.unwrap_or(SyncConfig::DEFAULT);
        let new = Self::new(plan.uid);
        let (tx_node, admission) = (plan.tx_node, plan.admission);
        let node = NodeConfig { tx_node, clock, seal: plan.seal, admission, ..new.node };
        Self { node, calendar: plan.calendar, ..new }
    }

    /// With this fixed TxNode.
    pub fn tx_node(mut self, tx_node: TxNode) -> Self {
        self.node.tx_node = Some(tx_node);
        self
    }

    /// On a segment with this calendar.
    pub fn calendar(self, calendar: &'static Calendar) -> Self {
        Self { calendar, ..self }
    }

    /// Hosting a broker with the table of its last run.
    pub fn broker(self, tables: BrokerTables) -> Self {
        Self { broker: Some(tables), ..self }
    }
}

/// The calendar of a segment of this bit rate without hard real-time channels. One is kept for each bit rate.
pub fn calendar_without_slots(bit_rate: BitRate) -> &'static Calendar {
    static CALENDARS: Mutex<Option<HashMap<BitRate, &'static Calendar>>> = Mutex::new(None);
    let mut calendars = CALENDARS.lock().unwrap_or_else(PoisonError::into_inner);
    calendars.get_or_insert_default().entry(bit_rate).or_insert_with(|| {
        let segment = Segment {
            bit_rate,
            accuracy: Duration::from_micros(5),
            release_jitter: Duration::from_micros(10),
        };
        Box::leak(Box::new(Calendar::checked(segment, Duration::from_millis(10), &[])))
    })
}

/// A UID of nobody else's, by chance: for a program that comes and goes, and need not be known again.
pub fn drawn_uid() -> NodeUid {
    NodeUid::new(noise() | 1).unwrap_or(NodeUid::MIN)
}

/// Why a node cannot be started.
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum StartError {
    /// The settings of the clock synchronisation are refused.
    Clock(SyncConfigError),
    /// The table of the broker contradicts itself; the text says where.
    BrokerTable(String),
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Clock(error) => error.fmt(f),
            Self::BrokerTable(why) => write!(f, "the table of the broker is of no use: {why}"),
        }
    }
}

impl std::error::Error for StartError {}

/// Differs between starts, so that nodes that failed together do not try again together.
fn noise() -> u64 {
    use std::hash::{BuildHasher as _, RandomState};
    RandomState::new().hash_one(std::process::id())
}
