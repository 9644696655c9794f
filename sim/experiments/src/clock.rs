//! The precision of the clock synchronisation on the bus: the bound ε that each node states against its true
//! distance from the master.
//!
//! Every node runs the core's own synchronisation as a service of a whole node. Oscillators are off by up to
//! the drift, timers tick, time-stamps are late; the bus is loaded with soft real-time frames from all nodes.
//! The distance of a node from the master is the difference between their global time at the same instant,
//! which only a simulation can see. It is taken between the ticks of the timers: who reads a timer of 4 MHz
//! reads it up to 250 ns late, which is no error of the clock.

use crate::nodes::{EMPTY_CALENDAR, hardware_filters};
use crate::output::{self, Conclusion, Results};
use crate::random::Random;
use anyhow::{anyhow, ensure};
use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, FaultModel, StationId, VirtualInstant};
use cosmic_commands::experiment::Clock as Options;
use cosmic_core::Subject;
use cosmic_core::can::filter_banks::{Fifo, Wanted};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{Channel, Event, Publication, SoftAttributes};
use cosmic_core::protocol::Rank;
use cosmic_core::services::ClockService;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use serde::Serialize;
use std::fmt;

/// Smallest, mean and largest, in nanoseconds.
#[derive(Clone, Copy, Serialize)]
struct Spread {
    least: u64,
    mean: f64,
    greatest: u64,
    #[serde(skip)]
    sum: u64,
    #[serde(skip)]
    count: u64,
}

/// What was seen at one load.
#[derive(Serialize)]
struct Precision {
    /// The share of the bus that was busy, the frames of the synchronisation included.
    bus_load: f64,
    /// From the start until the last node was synchronised, in seconds.
    synchronised_after: f64,
    samples: u64,
    /// ε of the nodes that are not the master, from [`SETTLING`] on.
    #[serde(rename = "bound_nanoseconds")]
    bound: Spread,
    /// Their true distance from the master in the same samples.
    #[serde(rename = "distance_nanoseconds")]
    distance: Spread,
    /// Samples since the start in which a synchronised node was farther from the master than it stated.
    exceeded: u64,
}

#[derive(Serialize)]
struct Report<'o> {
    options: &'o Options,
    loads: Vec<Precision>,
}

/// Does what `experiment clock` is to do.
pub(crate) fn run(options: &Options) -> anyhow::Result<Conclusion> {
    let results = Results::open(options.json.as_deref())?;
    let progress = output::progress(options.seconds * options.load.len() as u64, "virtual seconds");
    let at_load = |load: &u8| Measurement::new(options, *load)?.run(options, &progress);
    let loads = options.load.iter().map(at_load).collect::<anyhow::Result<_>>()?;
    progress.finish_and_clear();
    let report = Report { options, loads };
    results.show(&report)?;
    let exceeded: u64 = report.loads.iter().map(|precision| precision.exceeded).sum();
    Ok(match exceeded {
        0 => Conclusion::Holds,
        exceeded => Conclusion::Fails(format!("the bound was exceeded in {exceeded} samples")),
    })
}

struct Measurement {
    cluster: Cluster<ClockService>,
    stations: Vec<StationId>,
    precision: Precision,
    settled_at: VirtualInstant,
}

impl Measurement {
    /// A cluster whose nodes have just been switched on.
    fn new(options: &Options, load: u8) -> anyhow::Result<Self> {
        let mut random = Random::new(options.seed);
        let sync = sync_config(options)?;
        let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()), random.bits());
        let filters = hardware_filters(&[
            Wanted::etag(Fifo::Urgent, Etag::SYNC),
            Wanted::etag(Fifo::Urgent, Etag::FOLLOW_UP),
        ])?;
        let mut stations = Vec::new();
        for number in 0..options.nodes {
            let limit = i32::from(options.drift) * 1_000;
            let drift = match number {
                0 => limit,
                1 => -limit,
                _ => random.below(2 * limit as u64 + 1) as i32 - limit,
            };
            // All nodes together make the load; mean frames are a little longer than the drawn interval.
            let pause = 100.0 * MEAN_FRAME * f64::from(options.nodes) / f64::from(load);
            let pause = (load > 0).then_some(Duration::from_ticks(pause as u64));
            let traffic = Traffic { pause, seed: random.bits() };
            let station = cluster.add(node(number, drift, sync, traffic));
            cluster.set_filters(station, filters.clone());
            stations.push(station);
        }
        for station in &stations {
            cluster.power_on(*station);
            cluster.run_until(cluster.now() + Duration::from_ticks(random.below(10_000_000)));
        }
        let precision = Precision {
            bus_load: 0.0,
            synchronised_after: 0.0,
            samples: 0,
            bound: Spread::NONE,
            distance: Spread::NONE,
            exceeded: 0,
        };
        let settled_at = VirtualInstant::from_ticks(0) + sync.period * SETTLING;
        Ok(Self { cluster, stations, precision, settled_at })
    }

    fn run(mut self, options: &Options, progress: &indicatif::ProgressBar) -> anyhow::Result<Precision> {
        let end = VirtualInstant::from_ticks(options.seconds * 1_000_000_000);
        ensure!(
            self.settled_at < end,
            "--seconds {} is not enough for {SETTLING} periods of {} ms; choose more",
            options.seconds,
            options.period
        );
        let mut second = 0;
        while self.cluster.now() < end {
            self.cluster.run_until(self.cluster.now() + BETWEEN_SAMPLES);
            self.sample();
            let now = self.cluster.now().as_ticks() / 1_000_000_000;
            progress.inc(now - core::mem::replace(&mut second, now));
        }
        let busy = BitRate::MAX.bits(1).as_ticks() * self.cluster.bus().accounting().busy_bits();
        self.precision.bus_load = busy as f64 / end.as_ticks() as f64;
        self.precision.bound.close();
        self.precision.distance.close();
        ensure!(self.precision.samples > 0, "no node was synchronised; --seconds must be more");
        Ok(self.precision)
    }

    /// Asks every node for global time at the same instant.
    fn sample(&mut self) {
        let mut master = None;
        let mut others = Vec::new();
        let mut all_synchronised = true;
        for station in &self.stations {
            self.cluster.visit(*station, |node| {
                let now = node.exact_now;
                let is_master = node.half().services().is_master();
                let clock = *node.hard().clock();
                let global = clock.to_global(now);
                all_synchronised &= clock.is_synchronised(now);
                if is_master {
                    master = clock.is_synchronised(now).then_some(global);
                } else if clock.is_synchronised(now) {
                    others.push((global, clock.accuracy(now)));
                }
            });
        }
        let now = self.cluster.now();
        if !all_synchronised {
            self.precision.synchronised_after = now.duration_since_epoch().as_ticks() as f64 / 1e9;
        }
        let Some(master) = master else { return };
        for (global, bound) in others {
            let distance = global.signed_since(master).unsigned_abs();
            self.precision.exceeded += u64::from(distance > bound.as_ticks());
            if now >= self.settled_at {
                self.precision.samples += 1;
                self.precision.bound.add(bound.as_ticks());
                self.precision.distance.add(distance);
            }
        }
    }
}

fn sync_config(options: &Options) -> anyhow::Result<SyncConfig> {
    let config = SyncConfig { period: Duration::from_millis(options.period), ..SyncConfig::DEFAULT };
    // A bound that does not hold for the oscillators would promise too much.
    let drift = Rate::from_parts_per_billion(i32::from(options.drift) * 1_000);
    let config = SyncConfig { max_drift: drift.max(config.max_drift), ..config };
    let refused = |error| anyhow!("the synchronisation cannot do --period and --drift together: {error:?}");
    config.check().map_err(refused)?;
    Ok(config)
}

/// The other frames of a node.
#[derive(Clone, Copy)]
struct Traffic {
    /// The mean span between two of them.
    pause: Option<Duration>,
    seed: u64,
}

fn node(number: u8, drift: i32, sync: SyncConfig, traffic: Traffic) -> NodeConfig<ClockService> {
    let tx_node = TxNode::new(number);
    NodeConfig {
        name: format!("node {number}"),
        tx_node,
        calendar: &EMPTY_CALENDAR,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(drift)),
        services: Box::new(move |now| {
            let config = SyncConfig { rank: Rank::new(number), ..sync };
            ClockService::new(config, &EMPTY_CALENDAR, tx_node, now).expect("the settings were checked")
        }),
        global_clock: GlobalClock::unsynchronised(),
        application: Box::new(move || {
            Box::new(Talker { traffic, random: Random::new(traffic.seed), publication: None })
        }),
    }
}

/// Publishes at random instants and fetches nothing.
struct Talker {
    traffic: Traffic,
    random: Random,
    publication: Option<Publication<u64>>,
}

impl Talker {
    fn next(&mut self, now: Instant) -> Instant {
        self.traffic.pause.map_or(Instant::FAR_FUTURE, |pause| {
            now + Duration::from_ticks(pause.as_ticks() / 2 + self.random.below(pause.as_ticks()))
        })
    }
}

impl Application<ClockService> for Talker {
    fn start(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        self.publication = node.announce(&BABBLE).ok();
        self.next(node.now)
    }

    fn wake(&mut self, node: &mut Access<'_, ClockService>) -> Instant {
        if let Some(publication) = &self.publication {
            // If there is no room, there is load enough.
            let _ = node.publish(publication, &Event::new(self.random.bits()));
        }
        self.next(node.now)
    }

    fn notified(&mut self, _: &mut Access<'_, ClockService>) {}
}

impl Spread {
    const NONE: Self = Self { least: u64::MAX, mean: 0.0, greatest: 0, sum: 0, count: 0 };

    fn add(&mut self, value: u64) {
        self.least = self.least.min(value);
        self.greatest = self.greatest.max(value);
        self.sum += value;
        self.count += 1;
    }

    fn close(&mut self) {
        self.mean = self.sum as f64 / self.count.max(1) as f64;
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let least = self.least as f64 / 1e3;
        let greatest = self.greatest as f64 / 1e3;
        write!(f, "{least:6.2} {:6.2} {greatest:8.2}", self.mean / 1e3)
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Options { nodes, drift, period, seconds, .. } = self.options;
        writeln!(
            f,
            "{nodes} nodes at 1 Mbit/s, oscillators within \u{b1}{drift} ppm, sync every {period} ms, \
             {seconds} s at each load"
        )?;
        writeln!(f, "bus load  synchronised  bound \u{3b5} in \u{b5}s            distance in \u{b5}s")?;
        writeln!(f, "             after       least   mean greatest   least   mean greatest  exceeded")?;
        for precision in &self.loads {
            writeln!(
                f,
                "{:6.1} %  {:9.2} s   {}  {}  {:8}",
                precision.bus_load * 100.0,
                precision.synchronised_after,
                precision.bound,
                precision.distance,
                precision.exceeded
            )?;
        }
        Ok(())
    }
}

const BABBLE: Channel<u64> = Channel::soft(
    Subject::new(0xBABB1E).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(50) },
)
.with_etag(Etag::BOUND_LAST);

/// Of eight random bytes, at 1 Mbit/s, in nanoseconds.
const MEAN_FRAME: f64 = 135_000.0;
/// Not a divisor of any period, so that samples fall anywhere in it.
const BETWEEN_SAMPLES: Duration = Duration::from_micros(997);
/// Periods from the start until ε counts: eight of silence, six until the nodes are synchronised, eight until
/// the rate is known from a full window.
const SETTLING: u32 = 30;
