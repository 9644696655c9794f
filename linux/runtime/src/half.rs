//! The event half of a Linux node: how many of all it has.

use cosmic_core::event_half::EventHalf;
use cosmic_core::services::{AdmittingBroker, NodeServices};
use cosmic_core::{broker, network};

/// Nodes that a hosted broker has ids for.
pub const BROKER_NODES: usize = 127;
/// Subjects that a hosted broker has etags for.
pub const BROKER_SUBJECTS: usize = 4096;

/// A broker that a Linux node hosts.
pub type Broker = broker::Broker<BROKER_NODES, BROKER_SUBJECTS>;

/// Soft real-time channels beside the plan that the node of a hosted broker can admit.
pub const BROKER_ADMITS: usize = 128;

pub(crate) type Hosting = AdmittingBroker<BROKER_NODES, BROKER_SUBJECTS, BROKER_ADMITS>;

pub(crate) const CHANNELS: usize = 128;
pub(crate) type Services = NodeServices<CHANNELS, { 2 * CHANNELS }, 126, 1024, Option<Hosting>>;
/// A Linux node has memory: as much as the core can number. It takes part in no slot, so one buffer does.
pub(crate) type Half = EventHalf<1, CHANNELS, 254, 255, 128, 128, Services>;

const _: () = assert!(CHANNELS <= 128 && network::soft::RESERVED < 128);
