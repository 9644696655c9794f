//! STM32F405, F407 and F446 boards: clocks, pins, the bxCAN controller and the timer. No protocol.
//!
//! The middleware speaks in values: [`Command`](cosmic_core::can::Command)s go in,
//! [`Outcome`](cosmic_core::can::Outcome)s and frames come out, and time is a parameter. This crate is
//! the other end: it turns them into register accesses of one microcontroller.
//!
//! * [`bxcan`]: brings the controller up, and takes it apart.
//! * [`bxcan_filters`]: its acceptance filters, also those that change as the node runs.
//! * [`bxcan_tx`]: the three transmit mailboxes, each a type of its own, so that the time-triggered half
//!   of the middleware needs no lock to use its mailbox.
//! * [`bxcan_rx`]: the two receive FIFOs.
//! * [`bxcan_status`]: the error counters, and the interrupt that tells when they have become bad.
//! * [`bit_timing`]: the bit timing register for a bit rate.
//! * [`clock`]: the monotonic timer, and its conversion to the middleware's local time.
//! * [`watchdog`], [`reset`]: the independent watchdog; why the part has started, and what it knew before.
//! * [`stm32f4`]: brings a board up and hands out the parts; [`wiring`]: what is each board's own.
//!
//! All but [`clock`], [`stm32f4`] and [`wiring`] also builds on the host, where memory stands in for the registers.
#![no_std]

#[cfg(test)]
extern crate std;

#[cfg(any(target_arch = "arm", test))]
mod alarm;
pub mod bit_timing;
pub mod bxcan;
pub mod bxcan_filters;
pub mod bxcan_rx;
pub mod bxcan_status;
pub mod bxcan_tx;
#[cfg(target_arch = "arm")]
pub mod clock;
#[cfg(target_arch = "arm")]
mod failure;
#[cfg(target_arch = "arm")]
mod pll;
mod registers;
pub mod reset;
mod runtime;
#[cfg(target_arch = "arm")]
pub mod stm32f4;
pub mod watchdog;
#[cfg(target_arch = "arm")]
pub mod wiring;

#[cfg(target_arch = "arm")]
pub use stm32f4::{Stm32F4, Stm32F405};
#[cfg(target_arch = "arm")]
pub use stm32f4xx_hal::{self as hal, pac};
