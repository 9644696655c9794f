//! Who watches a node: records, logs, pins for an oscilloscope.
//!
//! All methods do nothing unless they are written, so that `()` is an observer who costs nothing. Those of an
//! [`Observer`] are called while the node is locked, so they should be short.

use cosmic_core::Subject;
use cosmic_core::event_layer::{Delivered, Exception, Filter, Policy, PublishError};
use cosmic_core::time::Instant;

/// Is told what happens at a node. What happens to events it is told by [`Observes`].
pub trait Observer: 'static {
    /// Watches the calendar task.
    type Calendar: CalendarObserver;

    /// The application was told of an exception.
    fn exception(&mut self, exception: &Exception) {
        let _ = exception;
    }

    /// The event task has taken a turn.
    fn attended(&mut self) {}

    /// The application has subscribed to a channel.
    fn subscribed(&mut self, subject: Subject, filter: Filter, policy: Policy, at: Instant) {
        let _ = (subject, filter, policy, at);
    }

    /// The application has given up a subscription to a channel.
    fn cancelled(&mut self, subject: Subject, at: Instant) {
        let _ = (subject, at);
    }
}

/// Is told what happens to events with content `C`.
pub trait Observes<C>: Observer {
    /// The application has handed an event to the middleware, which took it or not.
    fn published(&mut self, subject: Subject, content: &C, at: Instant, result: Result<(), PublishError>) {
        let _ = (subject, content, at, result);
    }

    /// The application has taken an event.
    fn delivered(&mut self, subject: Subject, event: &Delivered<C>, at: Instant) {
        let _ = (subject, event, at);
    }
}

/// Is told what the calendar task does. It runs at the highest priority: any work here is jitter.
pub trait CalendarObserver: 'static {
    /// The task has begun or ended to run.
    fn running(&mut self, runs: bool) {
        let _ = runs;
    }

    /// The event layer is told of an event that has become visible, or of an omission.
    fn notified(&mut self) {}
}

impl Observer for () {
    type Calendar = ();
}

impl<C> Observes<C> for () {}

impl CalendarObserver for () {}

/// Two observers, who are told everything one after the other.
impl<A: Observer, B: Observer> Observer for (A, B) {
    type Calendar = (A::Calendar, B::Calendar);

    fn exception(&mut self, exception: &Exception) {
        self.0.exception(exception);
        self.1.exception(exception);
    }

    #[inline]
    fn attended(&mut self) {
        self.0.attended();
        self.1.attended();
    }

    fn subscribed(&mut self, subject: Subject, filter: Filter, policy: Policy, at: Instant) {
        self.0.subscribed(subject, filter, policy, at);
        self.1.subscribed(subject, filter, policy, at);
    }

    fn cancelled(&mut self, subject: Subject, at: Instant) {
        self.0.cancelled(subject, at);
        self.1.cancelled(subject, at);
    }
}

impl<C, A: Observes<C>, B: Observes<C>> Observes<C> for (A, B) {
    fn published(&mut self, subject: Subject, content: &C, at: Instant, result: Result<(), PublishError>) {
        self.0.published(subject, content, at, result);
        self.1.published(subject, content, at, result);
    }

    fn delivered(&mut self, subject: Subject, event: &Delivered<C>, at: Instant) {
        self.0.delivered(subject, event, at);
        self.1.delivered(subject, event, at);
    }
}

impl<A: CalendarObserver, B: CalendarObserver> CalendarObserver for (A, B) {
    #[inline]
    fn running(&mut self, runs: bool) {
        self.0.running(runs);
        self.1.running(runs);
    }

    #[inline]
    fn notified(&mut self) {
        self.0.notified();
        self.1.notified();
    }
}
