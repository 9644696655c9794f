//! The experiments with the gateway.
//!
//! Exit code 0: what is promised holds. 1: not, or it could not be measured.

use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser as _;
use cosmic_commands::gateway::{Options, Part};
use cosmic_commands::output::{OutputError, Pending};
use cosmic_gateway_bench::churn::{self, Churn, Who};
use cosmic_gateway_bench::failed::Failed;
use cosmic_gateway_bench::latency::{self, Latency};
use cosmic_gateway_bench::scale::{self, Scale};
use cosmic_gateway_bench::throughput::{self, Throughput};
use cosmic_gateway_bench::{alone, child, cost, gateways, picture};
use serde::Serialize;
use stats_alloc::StatsAlloc;

#[global_allocator]
static COUNTING: &StatsAlloc<std::alloc::System> = cost::COUNTING;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let done = match words.split_first() {
        Some((first, rest)) if first == child::ROLE => role(rest).map(|()| Vec::new()),
        _ => experiment(&Options::parse()),
    };
    match done {
        Ok(broken) if broken.is_empty() => ExitCode::SUCCESS,
        Ok(broken) => {
            broken.iter().for_each(|what| eprintln!("failed: {what}"));
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn role(words: &[String]) -> Result<(), Failed> {
    let (role, arguments) = words.split_first().ok_or_else(|| Failed("no role is named".to_owned()))?;
    match role.as_str() {
        gateways::ROLE => gateways::be(arguments),
        alone::HEARS => alone::hear(arguments),
        alone::PUTS => alone::put(arguments),
        alone::ROUTER => alone::route(arguments),
        alone::ECHO => alone::echo(arguments),
        other => Err(Failed(format!("there is no role {other:?}"))),
    }
}

/// What was measured; what was not is left out.
#[derive(Default, Serialize)]
struct Report {
    latency: Option<Latency>,
    throughput: Option<Throughput>,
    memory: Option<Churn>,
    scale: Option<Scale>,
}

/// Returns what is not as promised.
fn experiment(options: &Options) -> Result<Vec<String>, Failed> {
    let (json, image) = files(options).map_err(|error| Failed(error.to_string()))?;
    let folder = tempfile::tempdir().map_err(Failed::at("no folder"))?;
    let (mut report, mut broken) = (Report::default(), Vec::new());
    for part in options.parts() {
        match part {
            Part::Latency => {
                let found = latency::measure(folder.path(), options.batches, options.events)?;
                print!("{found}");
                let (_, added) = found.added();
                if added > ADDS {
                    broken
                        .push(format!("two gateways add {added:.1} µs at the median of the quietest batch, not less than {ADDS}"));
                }
                report.latency = Some(found);
            }
            Part::Throughput => {
                let found = throughput::measure(folder.path(), options.rate, options.seconds)?;
                print!("{found}");
                if found.unsaid() != 0 {
                    broken.push(format!("{} events were lost unsaid", found.unsaid()));
                }
                report.throughput = Some(found);
            }
            Part::Memory => {
                let found = churn::measure(options.subjects_that_go, &Who::ALL, churn::FORGOTTEN)?;
                print!("{found}");
                broken.extend(found.broken());
                report.memory = Some(found);
            }
            Part::Scale => {
                let found = grow(options)?;
                if found.points.len() < options.segments.len() * options.subjects.len() {
                    broken.push("not every size could be measured".to_owned());
                }
                report.scale = Some(found);
            }
        }
    }
    if let (Some(mut image), Some(scale)) = (image, &report.scale) {
        write!(image, "{}", picture::draw(scale)).map_err(Failed::at("the picture"))?;
        image.finish().map_err(Failed::at("the picture"))?;
    }
    if let Some(mut json) = json {
        let text = serde_json::to_string_pretty(&report).map_err(Failed::at("the results"))?;
        writeln!(json, "{text}").map_err(Failed::at("the results"))?;
        json.finish().map_err(Failed::at("the results"))?;
    }
    Ok(broken)
}

/// A size that cannot be measured on this machine is left out, and told.
fn grow(options: &Options) -> Result<Scale, Failed> {
    let mut points = Vec::new();
    for &subjects in &options.subjects {
        for &segments in &options.segments {
            let folder = tempfile::tempdir().map_err(Failed::at("no folder"))?;
            eprintln!("gateway-bench: {segments} segments of {subjects} subjects");
            match scale::measure(folder.path(), segments, subjects, options.events as u64) {
                Ok(point) => points.push(point),
                Err(error) => eprintln!("gateway-bench: {segments} segments of {subjects} subjects: {error}"),
            }
        }
    }
    let scale = Scale { points };
    print!("{scale}");
    Ok(scale)
}

/// Opened before the work, so that they fail then.
fn files(options: &Options) -> Result<(Option<Pending>, Option<Pending>), OutputError> {
    let open = |path: &std::path::PathBuf| Pending::create(path, "name another file");
    Ok((options.json.as_ref().map(open).transpose()?, options.svg.as_ref().map(open).transpose()?))
}

/// What the gateways may add at the median of the quietest batch, in microseconds.
const ADDS: f64 = 100.0;
