//! Virtual time.
//!
//! The bus knows true physical time, in nanoseconds since the start of the simulation. What a node
//! believes about time ([`cosmic_core::time`]) is a matter of its own clock and its drift.

/// An instant of true physical time, in nanoseconds since the start of the simulation.
pub type VirtualInstant = fugit::MonotonicTimerInstantU64<1_000_000_000>;

/// The start of the simulation.
pub const EPOCH: VirtualInstant = VirtualInstant::from_ticks(0);

/// Later than every instant that will occur.
pub const FAR_FUTURE: VirtualInstant = VirtualInstant::from_ticks(u64::MAX);
