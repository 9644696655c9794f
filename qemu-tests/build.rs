//! Hands the linker scripts over, for the Arm target only, so that tools which look at the crate on the
//! host (an editor, `cargo metadata`) are not disturbed.

use std::path::PathBuf;
use std::{env, error, fs};

fn main() -> Result<(), Box<dyn error::Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS")? != "none" {
        return Ok(());
    }
    let out = PathBuf::from(env::var("OUT_DIR")?);
    for script in ["memory.x", "device.x"] {
        fs::copy(script, out.join(script)).map_err(|error| format!("qemu-tests/{script}: {error}"))?;
        println!("cargo::rerun-if-changed={script}");
    }
    println!("cargo::rustc-link-search={}", out.display());
    // `link.x` is cortex-m-rt's; it includes the two above.
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    Ok(())
}
