//! Hands the plan of the cluster to the compiler: the one that the images are built from, or the one that the
//! environment variable `COSMIC_PLAN` names.

use std::env;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=COSMIC_PLAN");
    let kept = || PathBuf::from("../../firmware/plan/calendar.rs");
    let plan = env::var_os("COSMIC_PLAN").map_or_else(kept, PathBuf::from);
    let path = plan.canonicalize().map_err(|error| format!("COSMIC_PLAN {}: {error}", plan.display()))?;
    println!("cargo::rerun-if-changed={}", path.display());
    println!("cargo::rustc-env=COSMIC_PLAN_FILE={}", path.display());
    Ok(())
}
