//! The demonstration: runs the example cluster, judges what happened, and shows it. `cargo xtask demo` starts it.
//!
//! | module | does |
//! |---|---|
//! | [`cluster`] | the cluster that runs: nodes, channels, calendar; [`example`]: the one of the repository |
//! | [`load`] | the background load |
//! | [`record`], [`bus_log`], [`clock`] | what can be observed: records of the nodes, frames on the wire, time |
//! | [`journal`], [`ledger`] | what is left of a run, and the life of each event |
//! | [`run`], [`progress`] | the run itself, what it says meanwhile |
//! | [`hard`], [`order`], [`sync`], [`verdict`], [`violation`] | the judgement: slots, order of deadlines, lost clocks, losses against exceptions |
//! | [`report`], [`table`], [`picture`], [`perfetto`] | what is shown of it |
//! | [`workshop`] | the cluster that configures itself, run and judged beside the other |
//!
//! The judge trusts no node: windows follow from the calendar and the sync frames on the wire, instants from
//! the records that the firmware writes into its RTT buffer, in its own local time.

pub mod bus_log;
pub mod clock;
pub mod cluster;
mod columns;
pub mod example;
mod handlers;
pub mod hard;
pub mod journal;
pub mod ledger;
pub mod load;
pub mod order;
pub mod perfetto;
pub mod picture;
pub mod progress;
pub mod record;
pub mod report;
pub mod run;
pub mod span;
pub mod sync;
pub mod table;
pub mod verdict;
pub mod violation;
pub mod workshop;
