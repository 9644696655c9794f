//! The services behind the channels: clock synchronisation, configuration, binding, membership.
//!
//! A node takes part in as many of them as it needs. A cluster whose ids and etags are all fixed needs
//! the clock only, or not even that. What a node has chosen implements [`Services`]; the
//! [`EventHalf`](crate::EventHalf) owns it, hands it the control frames, and carries out its
//! [`Request`]s.

mod clock;
mod config;
mod hosted;
mod naming;
mod node;
mod timekeeper;

pub use clock::ClockService;
pub use config::{News, NodeConfig};
pub use hosted::{AdmittingBroker, Hosted};
pub use naming::NamingService;
pub use node::{FollowingServices, NodeServices, PlannedServices};
pub use timekeeper::Timekeeper;

use crate::admission::Offer;
use crate::can::{ErrorCounters, Etag, Frame, Id, TxNode, TxNodes};
use crate::event_layer::{AnnounceError, ExceptionKind, Gate};
use crate::protocol::{Class, LayoutHash};
use crate::time::{GlobalClock, Instant};
use crate::uid::Subject;

/// What a service wants its node to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Request {
    /// Send the frame at the most urgent soft real-time priority, but not later than at this instant.
    SendUrgent(Frame, Instant),
    /// Send the frame, which is non real-time.
    Send(Frame),
    /// Withdraw the frame, if it has not been sent.
    Withdraw(Frame),
    /// Copy the clock, which has changed, to the time-triggered half.
    Clock,
    /// Keep silent in hard real-time slots, or speak again: the calendar is not that of the segment.
    Inhibit(bool),
    /// This is the node's TxNode from now on.
    TxNode(Option<TxNode>),
    /// This is the etag of the subject.
    Bound(Subject, Etag),
    /// The subject has no etag any more.
    Unbound(Subject),
    /// The node may publish on the channel of this subject, or not any more.
    Gate(Subject, Gate),
    /// Tell the application.
    Exception(Option<Subject>, ExceptionKind),
}

/// What a node does on a channel from now on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Declaration {
    /// The channel.
    pub subject: Subject,
    /// Its etag, if that is fixed.
    pub etag: Option<Etag>,
    /// Its class.
    pub class: Class,
    /// How its content is laid out.
    pub layout: LayoutHash,
    /// What a soft real-time channel is to be; `None` for the other classes.
    pub offer: Option<Offer>,
    /// The node has announced it.
    pub publishes: bool,
    /// The node subscribes to it.
    pub subscribes: bool,
}

/// There is no room for another channel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooMany;

/// What the services are told of their node.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NodeView {
    /// Exceptions so far; wraps.
    pub exceptions: u32,
    /// The controller's error counters.
    pub errors: ErrorCounters,
}

/// The services that a node takes part in.
///
/// [`on_frame`](Self::on_frame) gets every received control frame, and every frame that carries this
/// node's own TxNode; [`on_sent`](Self::on_sent) every frame that was sent for a service;
/// [`declare`](Self::declare) what the node does on a channel, each time that it changes. After any of
/// them, and at [`next_wakeup`](Self::next_wakeup), [`poll`](Self::poll) is called until it returns `None`.
pub trait Services {
    /// Whether [`on_event`](Self::on_event) does anything. A constant, so that a node whose services do not
    /// watch events pays nothing for it.
    const WATCHES_EVENTS: bool = false;
    /// Whether these services say when the node has its TxNode, by [`Request::TxNode`]. Until then the node sends
    /// nothing but what they ask for, even if its TxNode is fixed: another node may have it.
    const GIVES_TX_NODE: bool = false;
    /// Whether they ask for [`Request::SendUrgent`], so that the node needs places for soft real-time.
    const SENDS_URGENT: bool = true;
    /// Whether the frames of the clock are for them, so that the node needs places for these.
    const HEARS_CLOCK: bool = true;
    /// An event of another node has arrived, on a soft or non real-time channel, whether this node takes part
    /// in it or not.
    fn on_event(&mut self, id: Id, received_at: Instant) {
        let _ = (id, received_at);
    }
    /// A control frame has arrived.
    fn on_frame(&mut self, frame: &Frame, received_at: Instant);
    /// A frame of a service has been sent.
    fn on_sent(&mut self, frame: &Frame, sent_at: Instant);
    /// Whether the node may do that, and whether it may publish at once if it announces the channel. In a sealed cluster it
    /// may only do what its plan says; soft real-time channels beside the plan may have to be admitted before.
    ///
    /// # Errors
    /// It may not.
    fn permits(&self, declaration: &Declaration) -> Result<Gate, AnnounceError> {
        let _ = declaration;
        Ok(Gate::Open)
    }
    /// Who may publish on a channel, if that is fixed.
    fn publishers(&self, subject: Subject) -> Option<&'static TxNodes> {
        let _ = subject;
        None
    }
    /// An event that this node published on a soft or non real-time channel was late, or came to nothing.
    fn on_late(&mut self, subject: Subject, now: Instant) {
        let _ = (subject, now);
    }
    /// The node has begun or ended to publish or subscribe.
    ///
    /// # Errors
    /// [`TooMany`]: the service has no room for the channel.
    fn declare(&mut self, declaration: &Declaration) -> Result<(), TooMany>;
    /// What is to be done now.
    fn poll(&mut self, now: Instant, view: &NodeView) -> Option<Request>;
    /// When something is to be done, if no frame comes before.
    fn next_wakeup(&self) -> Instant;
    /// The clock of the cluster as of the last call.
    fn global_clock(&self) -> GlobalClock;
    /// As [`poll`](Self::poll), but without any [`Request::Send`]: there is no room for it.
    fn poll_urgent(&mut self, now: Instant, view: &NodeView) -> Option<Request> {
        let _ = (now, view);
        None
    }
    /// As [`next_wakeup`](Self::next_wakeup), for [`poll_urgent`](Self::poll_urgent).
    fn next_urgent_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }
}

/// No services: a node with fixed ids whose local time is global time.
impl Services for () {
    const SENDS_URGENT: bool = false;
    const HEARS_CLOCK: bool = false;

    fn on_frame(&mut self, _: &Frame, _: Instant) {}

    fn on_sent(&mut self, _: &Frame, _: Instant) {}

    fn declare(&mut self, _: &Declaration) -> Result<(), TooMany> {
        Ok(())
    }

    fn poll(&mut self, _: Instant, _: &NodeView) -> Option<Request> {
        None
    }

    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }

    fn global_clock(&self) -> GlobalClock {
        GlobalClock::free_running()
    }
}
