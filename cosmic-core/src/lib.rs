//! COSMIC: event channels on the CAN bus.
//!
//! Applications on smart sensors and actuators announce and subscribe to *event channels*, named by a
//! 64-bit subject, and state the quality they need. This crate turns that into CAN identifiers, a
//! time-triggered calendar and an earliest-deadline-first queue.
//!
//! The crate is sans-IO: it never reads a clock and never touches hardware. `now` is a parameter,
//! frames and mailbox commands go in and out as values. It does not allocate, contains no `unsafe`,
//! and all work per call is bounded; the bound is written beside the call.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod broker;
pub mod calendar;
pub mod can;
pub mod event_half;
pub mod event_layer;
mod explain;
pub mod membership;
pub mod network;
pub mod protocol;
mod ring;
pub mod services;
pub mod time;
pub mod uid;

pub use event_half::{Capacity, Due, EventHalf, Half, HardAccess, Input, Step};
pub use event_layer::Delivered;
pub use uid::{NodeUid, Subject};
