//! What the example applications share: filters, logs and records.
#![no_std]

pub mod records;
pub mod wiring;
