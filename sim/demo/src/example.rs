//! The cluster of the example firmware, for tests.

use std::path::Path;
use std::sync::LazyLock;

pub use crate::cluster::{Channel, Cluster, Node, Promise};

/// The cluster of the example firmware.
///
/// # Panics
/// If its description is not where it was when this program was built.
pub static EXAMPLE: LazyLock<Cluster> = LazyLock::new(|| {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../cosmic-plan/examples/vehicle.toml");
    Cluster::read(&file).unwrap_or_else(|error| panic!("the example: {error}"))
});
