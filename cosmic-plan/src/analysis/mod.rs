//! Schedulability analysis: how late a frame can be at worst, proven.
//!
//! [`fixed`] has the exact and the sufficient test for fixed priorities, on plain sets of
//! messages (`set`). [`segment`] applies them, and the test for [earliest deadline first](soft), beside the
//! calendar. [`reserved`] gives them to nodes that admit channels at run time. [`sensitivity`] asks how far things could grow. Arithmetic is in whole nanoseconds
//! throughout, so that no rounding decides.

pub mod advice;
pub mod bus;
pub mod calendar_load;
pub mod errors;
pub mod fixed;
pub mod frame;
mod hard;
pub mod proof;
pub mod reserved;
pub mod segment;
pub mod sensitivity;
#[cfg(feature = "cli")]
pub mod set;
pub mod soft;
