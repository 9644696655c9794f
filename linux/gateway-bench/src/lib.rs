//! What the gateway costs: latency beside zenoh and the link alone, throughput on one core, memory, and how all that grows
//! with segments and subjects. `docs/measurements.md` has the figures.
//!
//! What is measured runs in processes of its own, this program again in a [role](child); the kernel counts their time.
//! Segments are [wires](wire): links without a bus, so that a frame takes no time but that of the link.

pub mod alone;
pub mod child;
pub mod churn;
pub mod config;
pub mod cost;
pub mod failed;
pub mod gateways;
pub mod latency;
pub mod picture;
pub mod scale;
pub mod throughput;
pub mod wire;
