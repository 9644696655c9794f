//! Runs the example firmware on the emulated cluster, judges what happened, and shows it.
//!
//! Exit code 0: all as promised. 1: not. 2: it could not be run.

use std::io::{self, IsTerminal as _, Write as _};
use std::process::ExitCode;

use clap::Parser;
use cosmic_bus::{Chance, VirtualInstant};
use cosmic_commands::demo::Options;
use cosmic_commands::output::{self, Pending};
use cosmic_core::time::Duration;
use cosmic_demo::cluster::Cluster;
use cosmic_demo::load::Share;
use cosmic_demo::perfetto;
use cosmic_demo::picture;
use cosmic_demo::progress::Progress;
use cosmic_demo::report::{Report, Settings};
use cosmic_demo::run::{self, Images, Plan};
use cosmic_demo::table::{Style, Tables};
use cosmic_demo::verdict::Verdict;

fn main() -> ExitCode {
    let options = Options::parse();
    match demonstrate(&options) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(NOT_AS_PROMISED),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(NOT_RUN)
        }
    }
}

/// Runs, prints, writes. Returns whether everything was as promised.
fn demonstrate(options: &Options) -> Result<bool, Box<dyn core::error::Error>> {
    // It lives as long as the program, which runs one cluster.
    let file = options.cluster.as_ref().ok_or("say which cluster runs: --cluster FILE")?;
    let images = match &options.images {
        Some(folder) => Images::Folder(folder.clone()),
        None if options.elf_files.is_empty() => return Err("say where the images are: --images DIR".into()),
        None => Images::Files(options.elf_files.clone()),
    };
    let cluster: &'static Cluster = Box::leak(Box::new(Cluster::read(file)?));
    output::directory(&options.out)?;
    let remedy = "name another directory with --out";
    let mut log = Pending::create(options.out.join("candump.log"), remedy)?;
    let mut image = Pending::create(options.out.join("bus.svg"), remedy)?;
    let remedy = "name another file with --json";
    let mut json = options.json.as_ref().map(|path| Pending::create(path, remedy)).transpose()?;

    let remedy = "name another file with --trace";
    let mut trace = options.trace.as_ref().map(|path| Pending::create(path, remedy)).transpose()?;

    let mut progress = Progress::new(VirtualInstant::from_ticks(0) + length(options));
    let journal = run::run(&plan(options, cluster, images.clone())?, &mut log, |now| progress.reached(now))?;
    eprintln!("demo: {}", progress.finish());
    let verdict = Verdict::of(&journal);
    let settings = settings(options);
    let report = Report::of(settings, &journal, &verdict);

    image.write_all(picture::draw(&settings, &journal, &verdict).as_bytes())?;
    if let Some(json) = &mut json {
        serde_json::to_writer_pretty(&mut *json, &report)?;
        writeln!(json)?;
    }
    if let Some(trace) = &mut trace {
        perfetto::write(&journal, &verdict, &mut *trace)?;
    }
    let mut places = vec![("picture", image.finish()?), ("log of the bus", log.finish()?)];
    if let Some(json) = json {
        places.push(("report", json.finish()?));
    }
    if let Some(trace) = trace {
        places.push(("trace for ui.perfetto.dev", trace.finish()?));
    }
    eprintln!(
        "demo: cluster {}, planned from {}, calendar {:08X}; {images}",
        cluster.name,
        cluster.file.display(),
        cluster.calendar.digest()
    );
    let style = if io::stdout().is_terminal() { Style::Colours } else { Style::Plain };
    let mut out = io::stdout().lock();
    write!(out, "{}", Tables { report: &report, style })?;
    for (what, place) in places {
        writeln!(out, "{what}: {}", place.display())?;
    }
    Ok(report.passed)
}

fn plan(
    options: &Options,
    cluster: &'static Cluster,
    images: Images,
) -> Result<Plan, Box<dyn core::error::Error>> {
    Ok(Plan {
        handlers: options.trace.is_some(),
        cluster,
        images,
        length: length(options),
        seed: options.seed,
        load: Share::percent(options.load).ok_or("--load must be from 0 to 100")?,
        errors: Chance::new(options.errors).ok_or("--errors must be from 0 to 1")?,
        burst: options.burst,
    })
}

fn settings(options: &Options) -> Settings {
    Settings {
        seconds: options.seconds.as_secs_f64(),
        seed: options.seed,
        load_percent: options.load,
        error_rate: options.errors,
        burst: options.burst,
    }
}

/// In virtual time; no run is longer than the command allows.
fn length(options: &Options) -> Duration {
    Duration::from_ticks(u64::try_from(options.seconds.as_nanos()).unwrap_or(u64::MAX))
}

const NOT_AS_PROMISED: u8 = 1;
const NOT_RUN: u8 = 2;
