//! Why a gateway does not run.

use std::fmt;

use crate::keys::Name;
use crate::network::NetworkError;

/// Why a gateway does not run.
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum StartError {
    /// The network on IP.
    Network(NetworkError),
    /// One of the segments; the text says what, and what to do.
    Segment(Name, String),
}

impl StartError {
    pub(crate) fn segment(name: &Name, what: String) -> Self {
        Self::Segment(name.clone(), what)
    }
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Network(error) => error.fmt(f),
            Self::Segment(name, what) => write!(f, "segment {name}: {what}"),
        }
    }
}

impl std::error::Error for StartError {}
