//! Why something cannot be measured.

use std::fmt;

/// Something cannot be measured. One line.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Failed(pub String);

impl Failed {
    /// For `map_err`: puts what was tried before the error.
    pub fn at<E: fmt::Display>(what: impl fmt::Display) -> impl FnOnce(E) -> Self {
        move |error| Self(format!("{what}: {error}"))
    }
}

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Failed {}
