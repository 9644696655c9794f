//! Logs and records over RTT, for RTIC: they hold up no task above those that log.
//!
//! The usual transports mask all interrupts from the first to the last byte of a line, which takes tens of
//! microseconds: jitter for a task that has nothing to do with the log. Here a line masks only the priorities
//! that may log (by BASEPRI): `start` is told the highest of them. A line of a task above it, which could come
//! while another line is half written, is not written, but counted (`lost`).
//!
//! ```ignore
//! // In RTIC's `init`: a buffer of 1024 bytes. The tasks that log have at most priority 3.
//! cosmic_rtt::start!(1024, 3);
//! ```
//!
//! Up-channel 0, `defmt`, carries the log; `channel` sets up another beside it, for data of the application's.
//! Nobody ever waits for a probe: what finds no room is left out whole, and counted.
//!
//! With the feature `panic-handler` a panic is logged, whoever was logging, and ends in a HardFault. It says file,
//! line and the message if that is a literal: formatting others costs some 4 KB of flash; `panic-messages` does it.
#![no_std]
#![cfg_attr(
    not(all(target_arch = "arm", feature = "panic-handler")),
    allow(dead_code, reason = "the tests on the host use it")
)]

#[cfg(test)]
extern crate std;

mod control;
mod line;
#[cfg(target_arch = "arm")]
mod logger;
#[cfg(all(target_arch = "arm", feature = "panic-handler"))]
mod panic;

pub use control::Channel;
#[cfg(target_arch = "arm")]
pub use logger::{lost, start};

/// Sets up up-channel 1, before the log is [started](start()): a probe reads once which channels there are. `None` if it
/// has been set up already, or the log has been started.
#[cfg(target_arch = "arm")]
pub fn channel(name: &'static core::ffi::CStr, buffer: &'static mut [u8]) -> Option<Channel> {
    control::CONTROL.channel(control::DATA, name, buffer)
}

/// Starts the log with a buffer of so many bytes, once: `start!(1024, 3)`. See [`start`](fn@start).
#[cfg(target_arch = "arm")]
#[macro_export]
macro_rules! start {
    ($bytes:expr, $ceiling:expr) => {
        if let Some(log) = $crate::cortex_m::singleton!(: [u8; $bytes] = [0; $bytes]) {
            $crate::start(log, $ceiling);
        }
    };
}

#[cfg(target_arch = "arm")]
#[doc(hidden)]
pub use cortex_m;
