//! What others read: the firmware, people, tools.

#[cfg(feature = "cli")]
pub mod dbc;
#[cfg(feature = "cli")]
pub mod explain;
#[cfg(feature = "cli")]
pub mod report;
pub mod rust;
#[cfg(feature = "cli")]
pub mod svg;
pub mod text;
