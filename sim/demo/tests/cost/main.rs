//! What the images that are flashed cost their core, as they are: for how much of the time it is awake on a full bus, and
//! how many cycles the paths take that a node's load is made of.
//!
//! `cargo xtask bench --cycles` runs this alone, `cargo xtask test emulated` among others: they build the images and name
//! their directories in `COSMIC_IMAGES` and `COSMIC_SMALL_IMAGES`. The figures of `docs/measurements.md` are what it prints.

mod bed;
mod cycles;
mod load;
mod profile;
