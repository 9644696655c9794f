//! `cosmic segment`: a simulated segment at a socket.

use std::path::Path;
use std::process::ExitCode;

use cosmic_bus::{Bus, FaultModel};
use cosmic_linux::link::segment::{Options, ServeError, SimulatedSegment, Socket};

use crate::context::Context;
use crate::failure::Failure;

pub(super) async fn segment(context: &mut Context, path: &Path) -> Result<ExitCode, Failure> {
    let refused = |error: ServeError| Failure::input(error.to_string());
    let socket = Socket::bind(path).await.map_err(refused)?;
    if !context.output.json() {
        let rate = context.bit_rate().bits_per_second() / 1_000;
        context
            .output
            .line(&format!("a simulated segment of {rate} kbit/s: --link sim:{}", path.display()))?;
        context.output.flush()?;
    }
    let bus = Bus::new(context.bit_rate(), FaultModel::none());
    tokio::select! {
        served = socket.serve(SimulatedSegment::new(bus), Options::default()) => match served {
            Ok(never) => match never {},
            Err(error) => Err(refused(error)),
        },
        // Its file goes, too: whoever starts the next one need not wonder.
        _ = tokio::signal::ctrl_c() => Ok(ExitCode::SUCCESS),
    }
}
