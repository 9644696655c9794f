//! What others read: the firmware, people, tools.

#[cfg(feature = "cli")]
pub mod c;
#[cfg(feature = "cli")]
pub mod control;
#[cfg(feature = "cli")]
pub mod dbc;
#[cfg(feature = "cli")]
pub mod explain;
#[cfg(feature = "cli")]
pub mod html;
#[cfg(feature = "cli")]
pub mod lua;
#[cfg(feature = "cli")]
pub mod python;
#[cfg(feature = "cli")]
pub mod report;
pub mod rust;
#[cfg(feature = "cli")]
pub mod svg;
pub mod text;
