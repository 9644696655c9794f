//! Planner and schedulability analysis for COSMIC segments.
//!
//! An engineer writes down the nodes and event channels of a segment in one TOML file
//! ([`cluster`]), and what stands in their events ([`contents`]). This crate finds a calendar for the hard real-time channels ([`plan`]), proves the
//! timing of everything else beside it ([`analysis`]), checks the result again from the definitions
//! ([`verify`]) and writes what the firmware and other tools need ([`output`]).
//!
//! A program's build script calls [`compile`]. The crate needs little for that: the command and all that only it
//! needs is the feature `cli`, which is on by default.
//!
//! ```
//! let source = cosmic_plan::document::Source::new("example.toml", cosmic_plan::cluster::EXAMPLE);
//! let cluster = cosmic_plan::cluster::Cluster::read(&source).expect("the example is well formed");
//! let plan = cosmic_plan::plan::plan(&cluster, &cosmic_plan::plan::Effort::default()).expect("it fits");
//! assert_eq!(plan.slots().len(), 1);
//! ```
#![forbid(unsafe_code)]

pub mod analysis;
pub mod cluster;
mod compile;
pub mod contents;
pub mod document;
pub mod needs;
pub mod node_filters;
pub mod output;
pub mod plan;
pub mod units;
pub mod verify;

pub use compile::{CONTENT, CompileError, Config, compile, try_compile};
