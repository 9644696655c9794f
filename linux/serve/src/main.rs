//! The server of an emulated segment. See [`cosmic_serve`].

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::can::BitRate;
use cosmic_core::time::Duration;
use cosmic_emu::{ClockError, Cluster, NodeConfig};
use cosmic_linux::link::segment::{Options, serve};
use cosmic_serve::{EmulatedSegment, Pace};
use tokio::io::AsyncReadExt as _;

/// Run flashed images on an emulated CAN bus in real time, and serve that bus at a Unix socket
///
/// Programs on Linux reach it as `sim:SOCKET`. Each second a line tells for how many milliseconds the segment's time stood
/// still so far because this machine could not follow. It ends when its standard input does.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Where to serve it
    #[arg(long, value_name = "PATH")]
    socket: PathBuf,
    /// Where the images are, each with the name of its node
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// The bit rate of the bus, in bits a second
    #[arg(long, value_name = "N", default_value = "1000000", value_parser = bit_rate)]
    bit_rate: BitRate,
    /// The nodes
    #[arg(required = true)]
    nodes: Vec<String>,
}

fn bit_rate(text: &str) -> Result<BitRate, String> {
    text.parse().ok().and_then(BitRate::new).ok_or_else(|| "must be from 10000 to 1000000".to_owned())
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("serve-emulated: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let cluster = cluster(&arguments.images, &arguments.nodes, arguments.bit_rate)?;
    let (segment, pace) = EmulatedSegment::new(cluster);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        tokio::select! {
            served = serve(&arguments.socket, segment, Options::default()) => match served {
                Err(error) => Err(error.into()),
            },
            () = tell(pace) => Ok(()),
            () = end_of_input() => Ok(()),
        }
    })
}

fn cluster(
    images: &Path,
    nodes: &[String],
    bit_rate: BitRate,
) -> Result<Cluster, Box<dyn std::error::Error>> {
    let mut cluster = Cluster::new(Bus::new(bit_rate, FaultModel::seeded(1)));
    for (at, node) in (0_i32..).zip(nodes) {
        let mut config = NodeConfig::new(node, images.join(node));
        // They start one after the other, and their crystals differ.
        config.start_at =
            VirtualInstant::from_ticks(0) + Duration::from_micros(700 * u64::from(at.unsigned_abs()));
        config.clock_error = ClockError::parts_per_million(30 - at * 50 % 61).unwrap_or_default();
        cluster.add_node(config)?;
    }
    Ok(cluster)
}

async fn tell(pace: Pace) {
    loop {
        tokio::time::sleep(std::time::Duration::from_secs(1)).await;
        println!("stood {}", pace.stood().as_millis());
    }
}

/// Who has started it is gone, or wants it to end.
async fn end_of_input() {
    let mut input = tokio::io::stdin();
    let mut bytes = [0; 64];
    while let Ok(1..) = input.read(&mut bytes).await {}
}
