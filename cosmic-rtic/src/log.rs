//! An observer that logs.

use cosmic_core::Subject;
use cosmic_core::event_layer::{Content, Exception, PublishError};
use cosmic_core::time::Instant;

use crate::observer::{Observer, Observes};

/// Logs with defmt what goes wrong: exceptions, as they are [taken](crate::report_exceptions), and events that are not
/// published.
#[derive(Clone, Copy, Debug)]
pub struct Log;

impl Observer for Log {
    type Calendar = ();

    fn exception(&mut self, exception: &Exception) {
        defmt::warn!("{}", exception);
    }
}

impl<C: Content> Observes<C> for Log {
    fn published(&mut self, subject: Subject, _: &C, _: Instant, result: Result<(), PublishError>) {
        if let Err(error) = result {
            defmt::warn!("an event of {} was not published: {}", subject, error);
        }
    }
}
