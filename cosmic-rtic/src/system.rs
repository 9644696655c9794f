//! What a node is made of, as one type.

use cosmic_core::admission::AdmissionTiming;
use cosmic_core::broker::{Broker, BrokerTiming, Nodes, Subjects};
use cosmic_core::can::TxNode;
use cosmic_core::plan::NodePlan;
use cosmic_core::protocol::ResetCause;
use cosmic_core::services::{
    AdmittingBroker, ClockService, Hosted, NamingService, News, NodeConfig, NodeServices, Services,
};
use cosmic_core::sync::SyncConfigError;
use cosmic_core::time::{GlobalClock, Instant};
use cosmic_core::{Capacity, Half as _, Subject};

use crate::board::Board;
use crate::hard::Hard;
use crate::inbox::Queued;
use crate::observer::Observer;

/// What a node is made of: everything in this crate is generic over it.
///
/// ```ignore
/// cosmic_core::capacity! {
///     Room { slots: 4, channels: 8, subscriptions: 8, events: 32, soft: 8, non_real_time: 8 }
/// }
///
/// struct Robot;
///
/// impl cosmic_rtic::System for Robot {
///     type Board = boards::Stm32F405;
///     type Capacity = Room;
///     type Services = cosmic_core::services::ClockService;
///     type Observer = ();
/// }
///
/// type Node = cosmic_rtic::Node<Robot>;
/// ```
pub trait System: 'static {
    /// The board.
    type Board: Board;
    /// How much the node has room for.
    type Capacity: Queued;
    /// The services that it takes part in.
    type Services: Timed;
    /// Who is told of what happens: `()` is nobody, and costs nothing.
    type Observer: Observer;
}

/// Services that know the time of the cluster.
pub trait Timed: Services + Sized {
    /// The services as the plan of the node has them.
    ///
    /// # Errors
    /// The plan lacks what they need.
    fn planned(node: &NodePlan, now: Instant) -> Result<Self, StartError>;

    /// The TxNode with which the node starts, which the services may still have to claim; `None` if it asks for one.
    fn tx_node(&self, node: &NodePlan) -> Option<TxNode> {
        node.tx_node
    }

    /// Returns whether the node has the names that frames of this channel bear: its own, and the channel's.
    fn is_bound(&self, subject: Subject) -> bool {
        let _ = subject;
        true
    }

    /// Why the node has started, for services that tell others.
    fn set_reset_cause(&mut self, cause: ResetCause) {
        let _ = cause;
    }

    /// The oldest piece of news that has not been fetched, of services that tell of the cluster.
    fn take_news(&mut self) -> Option<News> {
        None
    }

    /// Returns whether there is one.
    fn has_news(&self) -> bool {
        false
    }
}

/// All services, and a broker if the node hosts one. A node to which the plan gives no TxNode asks for one.
impl<
    const CHANNELS: usize,
    const DECLARATIONS: usize,
    const PEERS: usize,
    const INTERESTS: usize,
    B: PlannedHost,
    const ADMISSIONS: usize,
    const SEALS: usize,
    const CANDIDATE: bool,
    const NEWS: usize,
> Timed for NodeServices<CHANNELS, DECLARATIONS, PEERS, INTERESTS, B, ADMISSIONS, SEALS, CANDIDATE, NEWS>
{
    fn planned(node: &NodePlan, now: Instant) -> Result<Self, StartError> {
        if node.seal.is_some() && SEALS == 0 {
            return Err(StartError::Services);
        }
        let config = NodeConfig::planned(node).ok_or(StartError::NoSync)?;
        Self::new(&config, node.calendar, B::planned(node), now).map_err(StartError::Sync)
    }

    fn tx_node(&self, _: &NodePlan) -> Option<TxNode> {
        self.claimed()
    }

    fn is_bound(&self, subject: Subject) -> bool {
        self.tx_node().is_some() && self.etag_of(subject).is_some()
    }

    fn set_reset_cause(&mut self, cause: ResetCause) {
        self.set_reset_cause(cause);
    }

    fn take_news(&mut self) -> Option<News> {
        self.take_news()
    }

    fn has_news(&self) -> bool {
        self.has_news()
    }
}

/// What a node hosts, as its plan has it: a broker, or `()`.
pub trait PlannedHost: Hosted {
    /// For this node.
    fn planned(node: &NodePlan) -> Self;
}

impl PlannedHost for () {
    fn planned(_: &NodePlan) {}
}

impl<const NODES: usize, const SUBJECTS: usize> PlannedHost for Broker<NODES, SUBJECTS> {
    fn planned(node: &NodePlan) -> Self {
        Self::new(node.uid, BrokerTiming::DEFAULT, Nodes::new(), Subjects::new())
    }
}

/// Without what its plan says of soft real-time channels beside it, the node admits none.
impl<const NODES: usize, const SUBJECTS: usize, const ADMITTED: usize> PlannedHost
    for AdmittingBroker<NODES, SUBJECTS, ADMITTED>
{
    fn planned(node: &NodePlan) -> Self {
        Self::new(Broker::planned(node), node.admission, AdmissionTiming::DEFAULT)
    }
}

impl Timed for ClockService {
    fn planned(node: &NodePlan, now: Instant) -> Result<Self, StartError> {
        let config = node.sync.ok_or(StartError::NoSync)?;
        // It asks nobody.
        let tx_node = node.tx_node.ok_or(StartError::NoTxNode)?;
        let new = Self::new(config, node.calendar, Some(tx_node), now).map_err(StartError::Sync)?;
        Ok(new.sealed(node.seal).admitting(node.admission, node.uid))
    }
}

/// A node that claims the TxNode of its plan, or asks the broker for one if the plan gives it none. It has no clock, and so
/// it keeps silent in hard real-time.
impl<const CHANNELS: usize> Timed for NamingService<CHANNELS> {
    fn planned(node: &NodePlan, now: Instant) -> Result<Self, StartError> {
        // It cannot keep to these.
        if node.seal.is_some() || node.admission.is_some() {
            return Err(StartError::Services);
        }
        Ok(match node.tx_node {
            Some(tx_node) => Self::fixed(node.uid, tx_node, 0, now),
            None => Self::new(node.uid, 0, now),
        })
    }

    fn tx_node(&self, _: &NodePlan) -> Option<TxNode> {
        self.claimed()
    }

    fn is_bound(&self, subject: Subject) -> bool {
        self.tx_node().is_some() && self.etag_of(subject).is_some()
    }
}

/// A cluster without hard real-time, or of one node: local time is global time.
impl Timed for () {
    fn planned(_: &NodePlan, _: Instant) -> Result<Self, StartError> {
        Ok(())
    }
}

/// Why a node cannot be started.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StartError {
    /// The services need clock synchronisation, and the plan says that the cluster has none.
    NoSync,
    /// The plan gives the node no TxNode, and the services do not ask for one.
    NoTxNode,
    /// The plan wants a seal or admission to be kept to, which these services cannot.
    Services,
    /// The settings of clock synchronisation are refused.
    Sync(SyncConfigError),
}

pub(crate) type Buffers<T> = <<T as System>::Capacity as Capacity>::Buffers;
pub(crate) type Dispatcher<T> = <<T as System>::Capacity as Capacity>::Dispatcher;
pub(crate) type Access<T> = Hard<Buffers<T>>;
/// The event-triggered half of a node.
pub(crate) type Half<T> = <<T as System>::Capacity as Capacity>::Half<<T as System>::Services, Access<T>>;

pub(crate) fn clock<T: System>(half: &Half<T>) -> GlobalClock {
    half.services().global_clock()
}
