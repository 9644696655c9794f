//! An emulated cluster of STM32F405 nodes.
mod clock;
mod cluster;
mod cpu;
mod exception;
mod image;
mod log;
mod memory;
mod node;
mod observation;
mod rtt;
mod soc;
mod station;

pub use clock::ClockError;
pub use cluster::{Cluster, NoSuchFunction};
pub use cpu::{Access, Fault};
pub use image::LoadError;
pub use log::LogLine;
pub use node::{Firmware, NodeConfig};
pub use observation::{NodeId, Observation, ObservationKind, Pin, Place, StopReason};
pub use station::{BackgroundLoad, Port, Station};
