//! Who watches a node: records, logs, pins for an oscilloscope.
//!
//! All methods do nothing unless they are written, so that `()` is an observer who costs nothing. Those of an
//! [`Observer`] are called while the node is locked, so they should be short.

use cosmic_core::event_layer::{Channel, Delivered, Exception, PublishError};
use cosmic_core::time::Instant;

/// Is told what happens at a node. What happens to events it is told by [`Observes`].
pub trait Observer: 'static {
    /// Watches the calendar task.
    type Calendar: CalendarObserver;

    /// The application was told of an exception.
    fn exception(&mut self, exception: &Exception) {
        let _ = exception;
    }
}

/// Is told what happens to events with content `C`.
pub trait Observes<C>: Observer {
    /// The application has handed an event to the middleware, which took it or not.
    fn published(
        &mut self,
        channel: &Channel<C>,
        content: &C,
        at: Instant,
        result: Result<(), PublishError>,
    ) {
        let _ = (channel, content, at, result);
    }

    /// The application has taken an event.
    fn delivered(&mut self, channel: &Channel<C>, event: &Delivered<C>, at: Instant) {
        let _ = (channel, event, at);
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
