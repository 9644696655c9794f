//! Failures as Python raises them.

use cosmic_session::Failure;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::{PyErr, create_exception};

create_exception!(cosmic_can, CosmicError, PyException, "Something did not work; its subclasses say what.");
create_exception!(cosmic_can, LinkError, CosmicError, "The segment cannot be reached.");
create_exception!(
    cosmic_can,
    NotBoundError,
    CosmicError,
    "No broker has given the node its TxNode, or the channel its etag."
);
create_exception!(
    cosmic_can,
    RefusedError,
    CosmicError,
    "The node cannot announce or subscribe to the channel."
);
create_exception!(cosmic_can, NotPublishedError, CosmicError, "The event is not sent.");
create_exception!(cosmic_can, ClosedError, CosmicError, "The node or the subscription has been closed.");

/// What Python raises for a failure of the session.
pub(crate) fn raised(failure: &Failure) -> PyErr {
    let text = failure.to_string();
    match failure {
        Failure::Input(_) => PyValueError::new_err(text),
        Failure::Link(_) => LinkError::new_err(text),
        Failure::NotBound(_) => NotBoundError::new_err(text),
        Failure::NotPublished(_) => NotPublishedError::new_err(text),
        Failure::Closed => ClosedError::new_err(text),
        _ => RefusedError::new_err(text),
    }
}
