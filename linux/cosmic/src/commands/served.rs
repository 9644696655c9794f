//! `cosmic segment`: a simulated segment at a socket.

use std::path::Path;
use std::process::ExitCode;

use cosmic_bus::{Bus, FaultModel};
use cosmic_linux::link::segment::{Options, SimulatedSegment, serve};

use crate::context::Context;
use crate::failure::Failure;

pub(super) async fn segment(context: &mut Context, path: &Path) -> Result<ExitCode, Failure> {
    let bus = Bus::new(context.bit_rate(), FaultModel::none());
    if !context.output.json() {
        let rate = context.bit_rate().bits_per_second() / 1_000;
        context
            .output
            .line(&format!("a simulated segment of {rate} kbit/s: --link sim:{}", path.display()))?;
        context.output.flush()?;
    }
    let served = tokio::select! {
        served = serve(path, SimulatedSegment::new(bus), Options::default()) => served,
        _ = tokio::signal::ctrl_c() => {
            // Whoever starts the next one need not wonder.
            let _ = std::fs::remove_file(path);
            return Ok(ExitCode::SUCCESS);
        }
    };
    match served {
        Ok(never) => match never {},
        Err(error) => Err(Failure::input(error.to_string())),
    }
}
