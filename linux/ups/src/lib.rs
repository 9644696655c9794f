//! COSMIC in C: the shared library behind `include/ups.h`, which is its documentation.
//!
//! The header is written by hand, for people to read; a test compares its types and constants with those of
//! [`layout`], and a program in C calls all of it. Nothing here unwinds into C: a panic becomes
//! [`layout::ERR_INTERNAL`].

mod arguments;
pub mod calls;
mod error;
mod handles;
pub mod layout;
