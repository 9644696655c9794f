//! Configuration and binding: the clients that every node runs, and the event channel broker (ECB) that
//! some node hosts.
//!
//! * [`Configuration`] turns the node's long UID into a TxNode that no other node has, and keeps watch
//!   that it stays so.
//! * [`Binding`] turns subjects into etags.
//! * [`Broker`] serves both. Any node whose TxNode is known can host one; several may, of which one is
//!   active and the others stand by. A cluster in which all ids and etags are fixed needs none.
//!
//! # Contract
//! Each is a state machine that owns no clock and no mailbox; `now` is local time and never goes back.
//!
//! 1. Feed every received frame to `on_frame`, and only received ones: a node does not hear itself. The
//!    exception is a node that hosts a broker: what its broker sends must also be fed to its own
//!    `Binding`, and what its `Binding` sends to its own broker.
//! 2. After that and after any other call that changes something, and when `next_wakeup` is due, call
//!    `poll` until it returns `None`, or stop while the node's transmit queue is full, and go on when it
//!    has room. When `poll` has returned `None`, the next wake-up lies ahead; before that it may not.
//! 3. Carry out each [`Output`] in its order.
//!
//! A `poll` that comes late delays the protocol, and one that comes early does nothing. Lost, repeated
//! and delayed frames cost time, never a wrong id: each step is repeated until it is answered.

use crate::can::Frame;

mod binding;
mod configuration;
mod ecb;
mod halves;
mod jitter;
mod session;
mod tables;

pub use binding::{Binding, BindingEvent, BindingFull, BindingTiming};
pub use configuration::{Configuration, ConfigurationEvent, ConfigurationTiming, OnDuplicate};
pub use ecb::{Broker, BrokerCounters, BrokerEvent, BrokerTiming, Role};
pub use tables::{Conflict, Nodes, Subjects};

/// What the owner of a state machine is to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Output<Event> {
    /// Queue the frame for transmission; it is non real-time.
    Send(Frame),
    /// Withdraw this frame from the queue or the mailbox, if it is still there. If it is on the wire or
    /// was sent, nothing is to be done.
    Withdraw(Frame),
    /// Something that the node wants to know.
    Event(Event),
}
