//! The clients that every node runs: how it gets its short names from the event channel broker (ECB), and keeps
//! watch over them.
//!
//! * [`Configuration`] turns the node's long UID into a TxNode that no other node has, and keeps watch
//!   that it stays so.
//! * [`Binding`] turns subjects into etags.
//! * [`AdmissionClient`] asks for soft real-time channels that the plan does not know.
//!
//! The [broker](crate::broker) serves the first two, [admission control](crate::admission) beside it the third. A cluster in which all ids and etags are fixed needs none.
//!
//! # Contract
//! Each is a state machine that owns no clock and no mailbox; `now` is local time and never goes back.
//!
//! 1. Feed every received frame to `on_frame`, and only received ones: a node does not hear itself. The
//!    exception is a node that hosts a broker: what its broker sends must also be fed to its own
//!    `Binding`, and what its `Binding` and its
//!    [`Declarations`](crate::membership::Declarations) send to its own broker.
//! 2. After that and after any other call that changes something, and when `next_wakeup` is due, call
//!    `poll` until it returns `None`, or stop while the node's transmit queue is full, and go on when it
//!    has room. When `poll` has returned `None`, the next wake-up lies ahead; before that it may not.
//! 3. Carry out each [`Output`](crate::protocol::Output) in its order.
//!
//! A `poll` that comes late delays the protocol, and one that comes early does nothing. Lost, repeated
//! and delayed frames cost time, never a wrong id: each step is repeated until it is answered.

mod admission;
mod binding;
mod configuration;
mod report;

pub use admission::{AdmissionClient, AdmissionEvent, AdmissionState, CannotAsk};
pub use binding::{Binding, BindingEvent, BindingFull, BindingTiming};
pub use configuration::Configuration;
pub use report::{ConfigurationEvent, ConfigurationTiming, OnDuplicate};
