//! The example cluster, of which every image contains the same: identifiers, qualities, contents and the calendar come
//! from its description, as the module [`plan`].
//!
//! | node | publishes | subscribes to |
//! |---|---|---|
//! | sensor | wheel speed, temperature | logbook |
//! | brake | brake force | wheel speed, temperature, suspension |
//! | diagnostics | suspension, logbook | wheel speed, brake force |

cosmic_core::include_plan!();
