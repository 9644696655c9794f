//! The soft and non real-time path: the event-triggered channel handler (ETCH).
//!
//! Soft real-time events wait in the order of their deadlines, non real-time events in the order of
//! their importance, each class in a queue of its own and with one transmit mailbox of its own (a
//! lane). Only the head of a queue is in its mailbox. The [`Etch`] maps the remaining time of the
//! head on the priority field of the identifier, so that the bus as a whole serves the earliest deadline
//! first (COSMIC section IV; Livani, Kaiser, Jia 1999):
//!
//! ```text
//! priority = clamp(1 + (deadline − now) / Δt_p, 1, 249)
//! ```
//!
//! As time passes, and when a more urgent event arrives, the frame is withdrawn and loaded again with its
//! new identifier. Nothing waits for a withdrawal: the outcome arrives as a call of its own.

mod etch;
mod lane;
mod queue;

pub use etch::{Etch, EtchCounters, EtchStep, PriorityMap};
pub use lane::{Departure, Full, Incident, IncidentKind, Outgoing, RESERVED, Sent, Tag, Unsent};
