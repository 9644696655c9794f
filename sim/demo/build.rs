//! Plans the cluster as the build script of the firmware does, so that the judge knows what the images were built
//! for.

use std::env;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=COSMIC_CLUSTER");
    cosmic_plan::compile(env::var_os("COSMIC_CLUSTER").unwrap_or_else(|| EXAMPLE.into()));
}

const EXAMPLE: &str = "../../cosmic-plan/examples/vehicle.toml";
