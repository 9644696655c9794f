//! The part of the Python package `cosmic_can` that is in Rust. `python/cosmic_can` is what its users see; the types of
//! all that is here stand in `_native.pyi`.

mod errors;
mod event;
mod log;
mod node;
mod segment;
mod subscription;
mod values;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::errors::{
        ClosedError, CosmicError, LinkError, NotBoundError, NotPublishedError, RefusedError,
    };
    #[pymodule_export]
    use crate::event::Event;
    #[pymodule_export]
    use crate::log::read_log;
    #[pymodule_export]
    use crate::node::Node;
    #[pymodule_export]
    use crate::segment::Segment;
    #[pymodule_export]
    use crate::subscription::Subscription;
}
