//! Hands the memory map and the linker scripts to the linker, and the plan of the cluster to the compiler.
//!
//! The plan is `plan/calendar.rs`, made by `cosmic-plan`; the environment variable `COSMIC_PLAN` names
//! another one.

use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    hand_over_plan()?;
    // On the host there is nothing to place in memory.
    if env::var("CARGO_CFG_TARGET_ARCH")? != "arm" {
        return Ok(());
    }
    println!("cargo::rerun-if-changed=memory.x");
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::copy("memory.x", out.join("memory.x")).map_err(|error| format!("firmware/memory.x: {error}"))?;
    println!("cargo::rustc-link-search={}", out.display());
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    Ok(())
}

fn hand_over_plan() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-env-changed=COSMIC_PLAN");
    let plan = env::var_os("COSMIC_PLAN").map_or_else(|| PathBuf::from("plan/calendar.rs"), PathBuf::from);
    let path = plan.canonicalize().map_err(|error| format!("COSMIC_PLAN {}: {error}", plan.display()))?;
    println!("cargo::rerun-if-changed={}", path.display());
    println!("cargo::rustc-env=COSMIC_PLAN_FILE={}", path.display());
    Ok(())
}
