//! What the demo, the experiments and `cargo xtask` share as commands.
//!
//! The options of the demo stand here and not in the demo, so that `cargo xtask demo` can check them before it
//! builds the firmware.

pub mod demo;
pub mod number;
pub mod output;
