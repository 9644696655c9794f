//! The demo of the gateway.
//!
//! Exit code 0: all as promised. 1: not. 2: it could not be run.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration as Span;

use clap::Parser as _;
use cosmic_commands::wan::Options;
use cosmic_gateway::keys::Name;
use cosmic_wan_demo::bed::{Bed, Failed, Material, name};
use cosmic_wan_demo::report::{self, Report};
use cosmic_wan_demo::round_trips::{End, measure};
use cosmic_wan_demo::{commands, picture};

fn main() -> ExitCode {
    let options = Options::parse();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let ran = match runtime {
        Ok(runtime) => runtime.block_on(run(&options)),
        Err(error) => Err(Failed(format!("no threads: {error}"))),
    };
    match ran {
        Ok(report) if report.broken.is_empty() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

async fn run(options: &Options) -> Result<Report, Failed> {
    let written = |path: &Path, what: std::io::Result<()>| {
        what.map_err(|error| Failed(format!("{} cannot be written: {error}", path.display())))
    };
    written(&options.out, std::fs::create_dir_all(&options.out))?;
    let missing = |what: &str| Failed(format!("say which {what}; `cargo xtask demo --wan` does"));
    let cluster = options.cluster.as_ref().ok_or_else(|| missing("cluster: --cluster FILE"))?;
    let images = options.images.as_ref().ok_or_else(|| missing("images: --images DIR"))?;
    let server = options.server.as_ref().ok_or_else(|| missing("server: --server FILE"))?;
    let material = Material { server, images, cluster };
    eprintln!("wan-demo: starting two emulated segments, two gateways, and a way between them");
    let delay = Span::from_millis(options.delay);
    let bed = Bed::start(material, delay).await?;
    eprintln!("wan-demo: measuring round trips");
    let rounds = options.rounds;
    let paths = [
        ("CAN: node, bus, node", End::Segment(bed.west.node(61)?), End::Segment(bed.west.node(62)?)),
        ("CAN to IP: node, bus, gateway, desk", End::Segment(bed.west.node(63)?), End::Ip(bed.desk.clone())),
        (
            "CAN to CAN: node, bus, gateways, bus, node",
            End::Segment(bed.west.node(65)?),
            End::Segment(bed.east.node(66)?),
        ),
    ];
    let mut round_trips = Vec::new();
    for (path, near, far) in paths {
        round_trips.push(measure(path, near, far, rounds).await?);
    }
    eprintln!("wan-demo: commands, and a cut of {} s", options.cut);
    let story = commands::tell(&bed, AROUND, Span::from_secs(options.cut)).await?;
    let stood = [&bed.west, &bed.east];
    let stood = stood.map(|segment| (segment.name.to_owned(), segment.stood())).into();
    let mut outcomes = Vec::new();
    for (gateway, segment) in [(&bed.of_west, "west"), (&bed.of_east, "east")] {
        let segment: Name = name(segment)?;
        outcomes.extend(report::outcomes(gateway, &segment));
    }
    let report = Report::new(round_trips, outcomes, story, stood, delay.as_secs_f64() * 1e3);
    let image = options.out.join("cut.svg");
    written(&image, std::fs::write(&image, picture::draw(&report.story)))?;
    if let Some(json) = &options.json {
        let text = serde_json::to_string_pretty(&report).map_err(|error| Failed(error.to_string()))?;
        written(json, std::fs::write(json, text + "\n"))?;
    }
    print!("{report}");
    println!("picture: {}", image.display());
    Ok(report)
}

/// Before and after the cut.
const AROUND: Span = Span::from_secs(4);
