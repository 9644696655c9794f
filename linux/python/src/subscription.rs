//! A subscription: what blocks, for any thread. Waiting in an event loop is done in Python, by the descriptor.

use std::os::fd::AsRawFd as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

use cosmic_core::Subject;
use cosmic_session::{Failure, Session};
use pyo3::prelude::*;

use crate::errors::raised;
use crate::event::Event;
use crate::values;

/// Events of a channel.
#[pyclass(frozen, module = "cosmic_can._native")]
pub(crate) struct Subscription {
    /// Keeps the node running.
    pub(crate) session: Arc<Session>,
    pub(crate) subscription: Arc<cosmic_session::Subscription>,
    pub(crate) subject: Subject,
}

#[pymethods]
impl Subscription {
    #[pyo3(signature = (timeout=None))]
    fn get(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<Event>> {
        let patience = timeout.map(|seconds| values::span(seconds, "timeout")).transpose()?;
        let until = patience.and_then(|patience| Instant::now().checked_add(patience));
        loop {
            let left = until.map_or(TURN, |until| until.saturating_duration_since(Instant::now()));
            let event = py.detach(|| self.subscription.next(Some(left.min(TURN))));
            if let Some(event) = event.map_err(|closed| raised(&Failure::from(closed)))? {
                return Event::new(py, &self.session, &self.subscription, self.subject, &event).map(Some);
            }
            // So that Ctrl-C works.
            py.check_signals()?;
            if left <= TURN && until.is_some() {
                return Ok(None);
            }
        }
    }

    fn fileno(&self) -> i32 {
        self.subscription.descriptor().as_raw_fd()
    }

    fn close(&self) {
        self.subscription.close();
    }
}

/// How often a call that waits looks whether Python has a signal.
const TURN: Duration = Duration::from_millis(100);
