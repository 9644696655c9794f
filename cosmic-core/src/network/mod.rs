//! The abstract network layer: the hard real-time path, and the soft and non real-time path.
//!
//! The two never wait for each other. [`hard`] runs in the task of the highest priority and shares only
//! the HRT message buffers with the rest; [`soft`] runs below it.

pub mod fragments;
pub mod hard;
pub mod id_map;
pub mod soft;
