//! What the demo, the experiments and `cargo xtask` share as commands.
//!
//! The options stand here and not in the programs, so that `cargo xtask` can check them before it builds anything.

pub mod demo;
pub mod experiment;
pub mod gateway;
pub mod number;
pub mod output;
pub mod wan;
