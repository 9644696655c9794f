//! Schedulability analysis.

pub mod errors;
