//! The services behind the channels: clock synchronisation, configuration, binding, membership.
//!
//! A node takes part in as many of them as it needs. A cluster whose ids and etags are all fixed needs
//! the clock only, or not even that. What a node has chosen implements [`Services`]; the
//! [`EventHalf`](crate::EventHalf) owns it, hands it the control frames, and carries out its
//! [`Request`]s.

mod clock;

pub use clock::ClockService;

use crate::can::{Etag, Frame, TxNode};
use crate::event_layer::ExceptionKind;
use crate::time::{GlobalClock, Instant};
use crate::uid::Subject;

/// What a service wants its node to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Request {
    /// Send the frame at the most urgent soft real-time priority.
    SendUrgent(Frame),
    /// Send the frame, which is non real-time.
    Send(Frame),
    /// Withdraw the frame, if it has not been sent.
    Withdraw(Frame),
    /// Copy these parameters of the clock to the time-triggered half.
    Clock(GlobalClock),
    /// Keep silent in hard real-time slots, or speak again: the calendar is not that of the segment.
    Inhibit(bool),
    /// This is the node's TxNode from now on.
    TxNode(Option<TxNode>),
    /// This is the etag of the subject.
    Bound(Subject, Etag),
    /// Tell the application.
    Exception(Option<Subject>, ExceptionKind),
}

/// The services that a node takes part in.
///
/// [`on_frame`](Self::on_frame) gets every received control frame, [`on_sent`](Self::on_sent) every frame
/// that was sent for a service. After either, and at [`next_wakeup`](Self::next_wakeup),
/// [`poll`](Self::poll) is called until it returns `None`.
pub trait Services {
    /// A control frame has arrived.
    fn on_frame(&mut self, frame: &Frame, received_at: Instant);
    /// A frame of a service has been sent.
    fn on_sent(&mut self, frame: &Frame, sent_at: Instant);
    /// What is to be done now.
    fn poll(&mut self, now: Instant) -> Option<Request>;
    /// When something is to be done, if no frame comes before.
    fn next_wakeup(&self) -> Instant;
}

/// No services: a node with fixed ids whose local time is global time.
impl Services for () {
    fn on_frame(&mut self, _: &Frame, _: Instant) {}

    fn on_sent(&mut self, _: &Frame, _: Instant) {}

    fn poll(&mut self, _: Instant) -> Option<Request> {
        None
    }

    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }
}
