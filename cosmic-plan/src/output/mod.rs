//! What others read: the firmware, people, tools.

pub mod rust;
