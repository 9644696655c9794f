//! What a node with all services is told at its start, and what it tells.

use crate::admission::{AdmissionPlan, AdmissionTiming};
use crate::broker::BrokerEvent;
use crate::calendar::Calendar;
use crate::can::TxNode;
use crate::client::{AdmissionEvent, BindingTiming, ConfigurationEvent, ConfigurationTiming, OnDuplicate};
use crate::membership::{InterestEvent, MemberEvent};
use crate::plan::NodePlan;
use crate::protocol::Lease;
use crate::seal::Seal;
use crate::sync::{ClockEvent, SyncConfig};
use crate::time::Duration;
use crate::uid::NodeUid;

/// What a node must know to take part in all services.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NodeConfig {
    /// Its long name.
    pub uid: NodeUid,
    /// Its TxNode, if that is fixed. The first broker of a cluster needs one.
    pub tx_node: Option<TxNode>,
    /// What it does when another node uses its fixed TxNode, too. `None` leaves it to the plan: it
    /// [holds](OnDuplicate::Hold) its TxNode if the calendar names that as a publisher, for nobody else can
    /// send in these slots; any other yields.
    pub on_duplicate: Option<OnDuplicate>,
    /// Anything that differs between nodes and starts; see [`Configuration::new`](crate::client::Configuration::new).
    pub noise: u64,
    /// Of the clock synchronisation.
    pub clock: SyncConfig,
    /// Of the configuration client.
    pub configuration: &'static ConfigurationTiming,
    /// Of the binding client.
    pub binding: &'static BindingTiming,
    /// How long the interest of this node holds if it is not refreshed.
    pub lease: Lease,
    /// The span between two status frames; a node is taken for dead after three and a half.
    pub status_period: Duration,
    /// What the node believes of others, in a sealed cluster. Its TxNode is then that of the seal, and it
    /// [stays](OnDuplicate::Stay), whoever else uses it. A node whose UID is not there keeps silent.
    pub seal: Option<&'static Seal>,
    /// What becomes of soft real-time channels that the plan does not know; `None`: any may be published, unproven.
    pub admission: Option<&'static AdmissionPlan>,
    /// Of the admission client.
    pub admission_timing: &'static AdmissionTiming,
}

impl NodeConfig {
    /// Usual values for a node with this name.
    pub const fn new(uid: NodeUid) -> Self {
        Self {
            uid,
            tx_node: None,
            on_duplicate: None,
            noise: 0,
            clock: SyncConfig::DEFAULT,
            configuration: &ConfigurationTiming::DEFAULT,
            binding: &BindingTiming::DEFAULT,
            lease: DEFAULT_LEASE,
            status_period: Duration::from_millis(500),
            seal: None,
            admission: None,
            admission_timing: &AdmissionTiming::DEFAULT,
        }
    }

    /// A node as the plan of its cluster has it, with the TxNode that it has there, or none; `None` if the cluster has no
    /// clock synchronisation.
    pub const fn planned(node: &NodePlan) -> Option<Self> {
        let Some(clock) = node.sync else { return None };
        let &NodePlan { uid, tx_node, seal, admission, .. } = node;
        Some(Self { tx_node, clock, seal, admission, ..Self::new(uid) })
    }

    pub(super) fn on_duplicate(&self, tx_node: TxNode, calendar: &Calendar) -> OnDuplicate {
        let publishes = || calendar.slots().iter().any(|slot| slot.publisher == tx_node);
        let by_plan = || if publishes() { OnDuplicate::Hold } else { OnDuplicate::Yield };
        self.on_duplicate.unwrap_or_else(by_plan)
    }
}

/// Something that the application may want to know of the cluster.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum News {
    /// This node has its TxNode, or has lost it.
    Configuration(ConfigurationEvent),
    /// Another node has come or gone.
    Member(MemberEvent),
    /// Interest in a channel has begun or ended.
    Interest(InterestEvent),
    /// The clock has another master, or something happened to it.
    Clock(ClockEvent),
    /// The broker that this node hosts did something.
    Broker(BrokerEvent),
    /// A channel that the plan does not know was admitted, or not.
    Admission(AdmissionEvent),
}

const DEFAULT_LEASE: Lease = Lease::new(Duration::from_secs(10)).expect("ten seconds are a lease");
