//! An emulated cluster: STM32F405 microcontrollers that run the very ELF files that are flashed, on the
//! bit-accurate bus of [`cosmic_bus`], in virtual time.
//!
//! ```no_run
//! use cosmic_bus::{Bus, FaultModel, VirtualInstant};
//! use cosmic_core::can::BitRate;
//! use cosmic_emu::{ClockError, Cluster, NodeConfig};
//!
//! let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::seeded(1)));
//! let mut sensor = NodeConfig::new("sensor", "target/thumbv7em-none-eabihf/firmware/sensor");
//! sensor.clock_error = ClockError::parts_per_million(30).unwrap_or_default();
//! cluster.add_node(sensor)?;
//! cluster.run_until(VirtualInstant::from_ticks(1_000_000_000));
//! for seen in cluster.take_observations() {
//!     println!("{} {}", seen.at, seen.kind);
//! }
//! # Ok::<(), cosmic_emu::LoadError>(())
//! ```
//!
//! # What is emulated
//! A Cortex-M4F core with its interrupt controller, SysTick and cycle counter; flash memory, RAM, RCC,
//! GPIO, TIM2 to TIM5, bxCAN1 and bxCAN2, the independent watchdog. What the firmware touches beyond that is reported
//! ([`ObservationKind::NotModelled`]), never ignored in silence. Nothing in the image knows that it is
//! emulated: logs and records are read out of its RTT buffers as a debug probe would, measuring points are
//! edges of its pins.
//!
//! # Time
//! Instants are exact within the model: interrupts are taken at instruction boundaries, frames have their
//! real lengths, and each node has its own clock error. The model of instruction times is that of the
//! Cortex-M4 reference manual, without flash wait states and pipeline stalls, so it flatters the hardware
//! by some per cent. Instruction counts are exact.
//!
//! One seed gives one sequence of observations, byte for byte, however fast the host is.
//!
//! # Known limits
//! The floating point unit is always enabled, rounds to nearest, and keeps no exception flags. Code always
//! runs privileged, and the memory protection unit is not modelled. A fault ends the node instead of
//! entering HardFault, until its watchdog resets it.
//!
//! # The core
//! It is an interpreter of our own, behind a trait. With the feature `unicorn` (GPL-2.0, needs cmake and
//! libclang; for tests only) it is compared with the Unicorn emulator on random instructions:
//! `cargo test -p cosmic-emu --features unicorn differential`.

mod clock;
mod cluster;
mod cpu;
mod exception;
mod hardware;
mod image;
mod log;
mod memory;
mod node;
mod node_config;
mod observation;
mod rtt;
mod soc;
mod station;

pub use clock::ClockError;
pub use cluster::{Cluster, NoSuchFunction, NotJoined};
pub use cpu::{AccessKind, CpuFault};
pub use image::LoadError;
pub use log::LogLine;
pub use node_config::{Firmware, NodeConfig};
pub use observation::{Masked, NodeId, Observation, ObservationKind, Pin, Place, ResetCause, StopReason};
pub use soc::can::CanController;
pub use station::{BackgroundLoad, Port, Station};
