//! The CAN layer: identifiers, frames, frame times, and what the middleware asks of a controller.
//!
//! COSMIC uses extended (29-bit) data frames of CAN 2.0B only; frames of other kinds on the same bus
//! are filtered out by the driver.

mod controller;
#[cfg(feature = "embedded-can")]
pub mod embedded;
pub mod filter_banks;
mod frame;
mod id;
mod mailbox;
mod timing;
mod tx_nodes;

pub use controller::{Controller, Status};
pub use frame::{Frame, Payload};
pub use id::{Etag, Id, Priority, TxNode};
pub use mailbox::{Command, ErrorCounters, Mailbox, Outcome};
pub use timing::{BitRate, ERROR_RECOVERY_BITS, LONGEST_FRAME_BITS, longest_frame_bits};
pub use tx_nodes::TxNodes;
