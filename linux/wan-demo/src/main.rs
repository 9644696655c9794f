//! The demo of the gateway.
//!
//! Exit code 0: all as promised. 1: not. 2: it could not be run.

use std::future::Future;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration as Span;

use clap::Parser as _;
use cosmic_commands::output::{self, OutputError, Pending};
use cosmic_commands::wan::Options;
use cosmic_wan_demo::bed::Bed;
use cosmic_wan_demo::failed::Failed;
use cosmic_wan_demo::gateway;
use cosmic_wan_demo::ground::Ground;
use cosmic_wan_demo::report::Report;
use cosmic_wan_demo::round_trips::{End, RoundTrips, measure};
use cosmic_wan_demo::served::Material;
use cosmic_wan_demo::{commands, page, picture};
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::JoinSet;

fn main() -> ExitCode {
    let options = Options::parse();
    let ran = match (&options.gateway, &options.segment) {
        (Some(config), Some(segment)) => {
            in_threads(gateway::be(config, segment, options.watched)).map(|()| true)
        }
        _ => ground(&options).and_then(|ground| in_threads(until_told_to_end(&options, &ground))),
    };
    match ran {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Before there are threads: a namespace is that of one of them.
fn ground(options: &Options) -> Result<Ground, Failed> {
    if options.entered {
        Ground::entered()
    } else if options.page.is_some() {
        Ok(Ground::Loopback("--page: browsers and tools are to reach them".to_owned()))
    } else if options.loopback {
        Ok(Ground::Loopback("--loopback".to_owned()))
    } else {
        Ground::enter()
    }
}

fn in_threads<T>(work: impl Future<Output = Result<T, Failed>>) -> Result<T, Failed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|error| Failed(format!("no threads: {error}")))?;
    let done = runtime.block_on(work);
    // Somebody may wait for standard input.
    runtime.shutdown_background();
    done
}

/// Ends in order when it is told to: then nothing is left of it. Returns whether all was as promised.
async fn until_told_to_end(options: &Options, ground: &Ground) -> Result<bool, Failed> {
    let heard = |kind| signal(kind).map_err(|error| Failed(format!("no signals: {error}")));
    let (mut interrupt, mut terminate) = (heard(SignalKind::interrupt())?, heard(SignalKind::terminate())?);
    let (report, running) = tokio::select! {
        ran = run(options, ground) => ran?,
        _ = interrupt.recv() => return Err(Failed("interrupted".to_owned())),
        _ = terminate.recv() => return Err(Failed("told to end".to_owned())),
    };
    if options.page.is_some() {
        eprintln!("wan-demo: segments, gateways and the page stay until Ctrl-C");
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    }
    drop(running);
    Ok(report.broken.is_empty())
}

/// What runs on as long as this lives.
struct Running {
    _bed: Bed,
    _page: JoinSet<()>,
}

async fn run(options: &Options, ground: &Ground) -> Result<(Report, Running), Failed> {
    let files = Files::open(options).map_err(|error| Failed(error.to_string()))?;
    let missing = |what: &str| Failed(format!("say which {what}; `cargo xtask demo --wan` does"));
    let cluster = options.cluster.as_ref().ok_or_else(|| missing("cluster: --cluster FILE"))?;
    let images = options.images.as_ref().ok_or_else(|| missing("images: --images DIR"))?;
    let server = options.server.as_ref().ok_or_else(|| missing("server: --server FILE"))?;
    // The gateways take a relative one from where their configurations are.
    let absolute = std::path::absolute(cluster);
    let cluster = &absolute.map_err(|error| Failed(format!("{}: {error}", cluster.display())))?;
    let material = Material { server, images, cluster };
    let listener = match options.page {
        Some(address) => Some(page::listen(address).await?),
        None => None,
    };
    eprintln!("wan-demo: starting two emulated segments, two gateways, and a way between them");
    let delay = Span::from_millis(options.delay);
    let mut bed = Bed::start(ground, material, delay, options.page.is_some()).await?;
    eprintln!("wan-demo: between the gateways: {}", bed.between.words());
    let page = match listener {
        Some(listener) => open(&bed, cluster, listener)?,
        None => JoinSet::new(),
    };
    eprintln!("wan-demo: measuring round trips");
    let round_trips = round_trips(&bed, options.rounds).await?;
    eprintln!("wan-demo: commands, and a cut of {} s", options.cut);
    let (around, cut) = (Span::from_secs(options.around), Span::from_secs(options.cut));
    let story = commands::tell(&mut bed, around, cut).await?;
    let stood = [&bed.west, &bed.east].map(|segment| (segment.name.to_owned(), segment.stood())).into();
    let (outcomes, delay) = (bed.outcomes().await?, delay.as_secs_f64() * 1e3);
    let report = Report::new(bed.between.words(), round_trips, outcomes, story, stood, delay);
    print!("{report}");
    let image = files.fill(&report).map_err(|error| Failed(error.to_string()))?;
    println!("picture: {image}");
    Ok((report, Running { _bed: bed, _page: page }))
}

/// Serves the page, and says where it is and how other tools reach what runs.
fn open(bed: &Bed, cluster: &Path, listener: TcpListener) -> Result<JoinSet<()>, Failed> {
    let address = listener.local_addr().map_err(|error| Failed(error.to_string()))?;
    let page = page::serve(bed, cluster, listener)?;
    eprintln!("wan-demo: the page: http://{address}/");
    for link in [bed.west.link(), bed.east.link(), bed.link_on_ip()] {
        eprintln!("wan-demo: for other tools: cosmic -c {} -l {link}", cluster.display());
    }
    Ok(page)
}

async fn round_trips(bed: &Bed, rounds: u32) -> Result<Vec<RoundTrips>, Failed> {
    let paths = [
        ("CAN: node, bus, node", End::Segment(bed.west.node(61)?), End::Segment(bed.west.node(62)?)),
        ("CAN to IP: node, bus, gateway, desk", End::Segment(bed.west.node(63)?), End::Ip(bed.desk.clone())),
        (
            "CAN to CAN: node, bus, gateways, bus, node",
            End::Segment(bed.west.node(65)?),
            End::Segment(bed.east.node(66)?),
        ),
    ];
    let mut all = Vec::new();
    for (path, near, far) in paths {
        all.push(measure(path, near, far, rounds).await?);
    }
    Ok(all)
}

/// What the demo writes: opened before the work, so that it fails then.
struct Files {
    image: Pending,
    json: Option<Pending>,
}

impl Files {
    fn open(options: &Options) -> Result<Self, OutputError> {
        output::directory(&options.out)?;
        let image = Pending::create(options.out.join("cut.svg"), "name another directory with --out")?;
        let open = |path| Pending::create(path, "name another file with --json");
        Ok(Self { image, json: options.json.as_ref().map(open).transpose()? })
    }

    /// Returns where the picture is.
    fn fill(mut self, report: &Report) -> Result<String, Box<dyn std::error::Error>> {
        if let Some(mut json) = self.json {
            writeln!(json, "{}", serde_json::to_string_pretty(report)?)?;
            json.finish()?;
        }
        write!(self.image, "{}", picture::draw(&report.story))?;
        Ok(self.image.finish()?.display().to_string())
    }
}
