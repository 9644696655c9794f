//! Throughput: so many events a second from four wires to four others, through two gateways on one core each. What was
//! sent is what was delivered and what was counted as lost; the memory of the gateways stays what it is.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration as Span, Instant};

use serde::Serialize;

use crate::child::Child;
use crate::config::{Channel, Setup, etag_of, free_port, number_of};
use crate::failed::Failed;
use crate::gateways::{self, PERHAPS_LOST, State};
use crate::latency::PATIENCE;
use crate::wire::Wire;

/// A gateway under load.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Loaded {
    /// Which one.
    pub what: &'static str,
    /// The part of one core that it took.
    pub share: f64,
    /// Processor time for each event, in microseconds.
    pub of_event: f64,
    /// Resident megabytes: after a tenth of the run, and at its end.
    pub resident: (f64, f64),
    /// Megabytes that it had taken from its allocator, at the same instants.
    pub live: (f64, f64),
}

/// What was found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Throughput {
    /// Events a second that were asked for, and for how many seconds.
    pub asked: (u32, u64),
    /// Events a second that were sent.
    pub rate: f64,
    /// Events that were sent.
    pub sent: u64,
    /// Of these, events that came out of the far wires.
    pub delivered: u64,
    /// Of these, events that were lost, by what the gateways counted.
    pub lost: BTreeMap<String, u64>,
    /// The gateway out of whose segments the events come, and the one into whose segments they go.
    pub gateways: [Loaded; 2],
}

impl Throughput {
    /// Sent, and neither delivered nor counted as lost; below zero: counted twice.
    pub fn unsaid(&self) -> i64 {
        self.sent as i64 - self.delivered as i64 - self.lost.values().sum::<u64>() as i64
    }
}

impl fmt::Display for Throughput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (asked, seconds) = self.asked;
        writeln!(
            f,
            "throughput: {asked} events a second asked for, for {seconds} s; each gateway on one core"
        )?;
        writeln!(
            f,
            "  sent {} ({:.0} a second), delivered {}, lost {}, unsaid {}",
            self.sent,
            self.rate,
            self.delivered,
            self.lost.values().sum::<u64>(),
            self.unsaid()
        )?;
        for (what, count) in &self.lost {
            writeln!(f, "    {count:>9}  {what}")?;
        }
        for Loaded { what, share, of_event, resident, live } in &self.gateways {
            writeln!(f, "  {what}: {:.1} % of one core, {of_event:.1} µs an event", share * 100.0)?;
            writeln!(
                f,
                "    resident {:.1} MB after a tenth of the run, {:.1} MB at its end; in use {:.2} MB, {:.2} MB",
                resident.0, resident.1, live.0, live.1
            )?;
        }
        Ok(())
    }
}

/// Wires and gateways.
struct Bed {
    near: Vec<Wire>,
    _far: Vec<Wire>,
    delivered: Arc<[AtomicU64]>,
    processes: [Child; 2],
}

/// Sends so many events a second for so long.
///
/// # Errors
/// Something does not start or goes on, or nothing crosses.
pub fn measure(folder: &Path, rate: u32, seconds: u64) -> Result<Throughput, Failed> {
    let mut bed = Bed::start(folder)?;
    bed.open()?;
    let before = bed.states()?;
    let delivered_before = bed.delivered();
    let begun = Instant::now();
    let mut warm = None;
    let under_load = load(&bed.near, rate, begun, Span::from_secs(seconds), |passed| {
        if warm.is_none() && passed * 10 >= Span::from_secs(seconds) {
            warm = gateways_of(&mut bed.processes).ok();
        }
    });
    let took = begun.elapsed();
    let loaded = bed.states()?;
    bed.flush()?;
    let after = bed.states()?;
    let warm = warm.ok_or_else(|| Failed("the run was too short".to_owned()))?;
    let sent = under_load + bed.flushed();
    let of = |at: usize, what| {
        let cpu = loaded[at].cost.cpu_since(&before[at].cost) as f64;
        let megabytes = |bytes: u64| bytes as f64 / 1e6;
        let (early, late) = (warm[at].cost, loaded[at].cost);
        Loaded {
            what,
            share: cpu / took.as_nanos() as f64,
            of_event: cpu / 1e3 / under_load as f64,
            resident: (megabytes(early.resident), megabytes(late.resident)),
            live: (megabytes(early.live), megabytes(late.live)),
        }
    };
    Ok(Throughput {
        asked: (rate, seconds),
        rate: under_load as f64 / took.as_secs_f64(),
        sent,
        delivered: bed.delivered() - delivered_before,
        lost: losses(&before, &after),
        gateways: [of(0, "out of segments"), of(1, "into segments")],
    })
}

/// What was counted between two looks at the gateways, but for what was forwarded. What was perhaps lost at a take-over
/// was counted as left to another gateway already.
fn losses(before: &[State; 2], after: &[State; 2]) -> BTreeMap<String, u64> {
    let mut lost = BTreeMap::new();
    for ((before, after), place) in before.iter().zip(after).zip(["first gateway", "second gateway"]) {
        let counted = after.lost_since(before).filter(|(what, _)| !what.contains(PERHAPS_LOST));
        lost.extend(counted.map(|(what, count)| (format!("{place}, {what}"), count)));
    }
    lost
}

fn gateways_of(processes: &mut [Child; 2]) -> Result<[State; 2], Failed> {
    let [west, east] = processes;
    Ok([gateways::state(west)?, gateways::state(east)?])
}

/// Events on all channels in turn, as the rate says, until the time is over: how many. Each wire has a thread.
fn load(wires: &[Wire], rate: u32, begun: Instant, span: Span, mut meanwhile: impl FnMut(Span)) -> u64 {
    let of_each = f64::from(rate) / wires.len() as f64;
    std::thread::scope(|scope| {
        let send = |(at, wire)| scope.spawn(move || send(wire, at, of_each, begun, span));
        let threads: Vec<_> = wires.iter().enumerate().map(send).collect();
        while begun.elapsed() < span {
            std::thread::sleep(Span::from_millis(100).min(span / 20));
            meanwhile(begun.elapsed());
        }
        threads.into_iter().map(|thread| thread.join().unwrap_or(0)).sum()
    })
}

fn send(wire: &Wire, at: usize, rate: f64, begun: Instant, span: Span) -> u64 {
    let mut sent = 0_u64;
    loop {
        let passed = begun.elapsed();
        if passed >= span {
            return sent;
        }
        // What this thread slept through is made up for, but not at once: no bus could.
        let due = (passed.as_secs_f64() * rate) as u64;
        for _ in 0..due.saturating_sub(sent).min(BURST) {
            let channel = (sent % CHANNELS as u64) as u16;
            if !wire.say(etag_of(at as u16 * CHANNELS + channel), sent) {
                return sent;
            }
            sent += 1;
        }
        std::thread::sleep(Span::from_millis(1));
    }
}

impl Bed {
    fn start(folder: &Path) -> Result<Self, Failed> {
        let channels = usize::from(WIRES * CHANNELS);
        let delivered: Arc<[AtomicU64]> = (0..channels).map(|_| AtomicU64::new(0)).collect();
        let (mut near, mut far) = (Vec::new(), Vec::new());
        for at in 0..WIRES {
            near.push(Wire::serve(&folder.join(format!("near-{at}")), |_, _| {})?);
            let count = Arc::clone(&delivered);
            far.push(Wire::serve(&folder.join(format!("far-{at}")), move |frame, _| {
                if let Some(number) = number_of(frame.id.etag(), count.len()) {
                    count[number].fetch_add(1, Ordering::Relaxed);
                }
            })?);
        }
        let named = |name: &str, wires: &[Wire]| -> Vec<_> {
            let named = |(at, wire): (usize, &Wire)| (format!("{name}-{at}"), wire.path().to_owned());
            wires.iter().enumerate().map(named).collect()
        };
        let channel = |number: u16| {
            let at = number / CHANNELS;
            Channel::between(number, &format!("near-{at}"), &format!("far-{at}"))
        };
        let channels: Vec<_> = (0..WIRES * CHANNELS).map(channel).collect();
        let (port, other, mode) = (free_port()?, free_port()?, "router");
        let of = |name: &str, listen, connect, segments: &[_]| {
            let setup = Setup { mode, listen: Some(listen), connect, segments, channels: &channels };
            setup.write(folder, name)
        };
        let files = [
            of("throughput-near", port, None, &named("near", &near))?,
            of("throughput-far", other, Some(port), &named("far", &far))?,
        ];
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let [first, second] = files;
        let processes = [gateways::start(&[first], Some(0))?, gateways::start(&[second], Some(1 % cores))?];
        Ok(Self { near, _far: far, delivered, processes })
    }

    fn states(&mut self) -> Result<[State; 2], Failed> {
        gateways_of(&mut self.processes)
    }

    fn delivered(&self) -> u64 {
        self.delivered.iter().map(|count| count.load(Ordering::Relaxed)).sum()
    }

    fn say_on_all(&self) {
        for (at, wire) in (0..).zip(&self.near) {
            for channel in 0..CHANNELS {
                wire.say(etag_of(at * CHANNELS + channel), 0);
                // As a bus would.
                std::thread::sleep(Span::from_micros(200));
            }
        }
    }

    /// Until something has come on every channel.
    fn open(&mut self) -> Result<(), Failed> {
        for wire in &self.near {
            wire.connected(PATIENCE)?;
        }
        let begun = Instant::now();
        while self.delivered.iter().any(|count| count.load(Ordering::Relaxed) == 0) {
            if begun.elapsed() > PATIENCE {
                return Err(Failed("not every channel crosses".to_owned()));
            }
            self.say_on_all();
            std::thread::sleep(Span::from_millis(200));
        }
        self.settle()
    }

    /// A last event on every channel, so that what is missing before it shows; and until nothing comes any more.
    fn flush(&mut self) -> Result<(), Failed> {
        self.settle()?;
        self.say_on_all();
        self.settle()
    }

    /// Events that [`flush`](Self::flush) sends.
    fn flushed(&self) -> u64 {
        u64::from(WIRES * CHANNELS)
    }

    /// Until the gateways count nothing any more: what was behind has been delivered, or discarded.
    fn settle(&mut self) -> Result<(), Failed> {
        loop {
            let before = self.states()?.map(|state| state.outcomes);
            std::thread::sleep(Span::from_secs(2));
            if self.states()?.map(|state| state.outcomes) == before {
                return Ok(());
            }
        }
    }
}

/// Each as long as a bus of 1 Mbit/s carries its part.
const WIRES: u16 = 4;
/// On each wire.
const CHANNELS: u16 = 50;
/// Frames of a wire in a millisecond, at most: a bus carries no more.
const BURST: u64 = 7;
