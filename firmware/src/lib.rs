//! What the vehicle's applications share: the cluster, and an observer who shows what happens in it.
//!
//! An application in `src/bin/` is an RTIC app. Its first tasks run the parts of the node, as `cosmic-rtic`
//! describes them; the others are the application. The observer is there so that the demo can judge every event;
//! an application of yours needs none: `examples/robot` has none.
#![no_std]

pub mod cluster;
pub mod records;
pub mod signals;
pub mod vehicle;
