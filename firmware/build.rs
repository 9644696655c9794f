//! Plans the cluster, and hands the memory map and the linker scripts to the linker.
//!
//! The cluster is the planner's example; `cargo xtask build --cluster FILE` names another one by the environment
//! variable `COSMIC_CLUSTER`. `--board BOARD` builds for a board by `COSMIC_BOARD`.

use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=COSMIC_CLUSTER");
    println!("cargo::rerun-if-env-changed=COSMIC_BOARD");
    println!("cargo::rustc-check-cfg=cfg(board, values(none(), {BOARDS}))");
    if let Some(board) = env::var_os("COSMIC_BOARD") {
        let board = board.to_str().filter(|board| BOARDS.contains(&format!("{board:?}")));
        let board = board.ok_or_else(|| format!("COSMIC_BOARD names no board of {BOARDS}"))?;
        println!("cargo::rustc-cfg=board={board:?}");
        // By itself `board = "..."` leaves `not(board)` true.
        println!("cargo::rustc-cfg=board");
    }
    let cluster = env::var_os("COSMIC_CLUSTER").unwrap_or_else(|| EXAMPLE.into());
    // Applications log contents.
    cosmic_plan::Config::default().derive("defmt::Format").compile(cluster);
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

/// What is built without one is for boards with a crystal of 8 MHz: the types are in `src/vehicle.rs`.
const BOARDS: &str = r#""nucleo-f446re", "feather-f405""#;
const EXAMPLE: &str = "../cosmic-plan/examples/vehicle.toml";
