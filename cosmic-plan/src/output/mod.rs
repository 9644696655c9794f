//! What others read: the firmware, people, tools.

pub mod dbc;
pub mod explain;
pub mod report;
pub mod rust;
pub mod svg;
pub mod text;
