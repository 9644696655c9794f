//! Why a call did not do what it was asked for.

use std::fmt;
use std::time::Duration;

use cosmic_core::event_layer::PublishError;

/// Why a call did not do what it was asked for. The text says what to do.
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Failure {
    /// A value that was given is wrong.
    Input(String),
    /// The segment cannot be reached.
    Link(String),
    /// No broker has given the node its TxNode, or the channel its etag.
    NotBound(Duration),
    /// The node cannot announce or subscribe to the channel.
    Refused(String),
    /// The event is not sent.
    NotPublished(PublishError),
    /// The session or the subscription has been closed.
    Closed,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(why) | Self::Link(why) | Self::Refused(why) => f.write_str(why),
            Self::NotBound(patience) => write!(
                f,
                "no broker has answered within {patience:?}: start one (`cosmic broker`), or give a TxNode and a cluster \
                 file with fixed etags"
            ),
            Self::NotPublished(error) => write!(f, "the event is not sent: {error}"),
            Self::Closed => f.write_str("it has been closed"),
        }
    }
}

impl std::error::Error for Failure {}

impl From<PublishError> for Failure {
    fn from(error: PublishError) -> Self {
        Self::NotPublished(error)
    }
}

/// The subscription has been closed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Closed;

impl fmt::Display for Closed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the subscription has been closed")
    }
}

impl std::error::Error for Closed {}

impl From<Closed> for Failure {
    fn from(_: Closed) -> Self {
        Self::Closed
    }
}
