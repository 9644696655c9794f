//! Why the demo cannot be run, and how long it waits before it says so.

use std::fmt;
use std::time::Duration as Span;

use cosmic_gateway::keys::Name;

/// The demo cannot be run.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Failed(pub String);

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Failed {}

/// The name of a segment or of the network.
///
/// # Errors
/// The text is none.
pub fn name(text: &str) -> Result<Name, Failed> {
    Name::new(text).ok_or_else(|| Failed(format!("{text:?} is no name")))
}

/// What waits is given up then.
pub const PATIENCE: Span = Span::from_secs(60);
