//! Scale: what an event, a declaration and a gateway cost against the number of segments and of subjects.
//!
//! Every segment has a gateway of its own, a leaf of one router, and each subject may leave and enters all segments: so
//! there are as many declarations as segments times subjects, in each direction, and an event goes to all segments but
//! its own. The router, one gateway that sends, and the others that receive are three processes, so that what each costs
//! is known by the time of processors that the kernel counts for it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration as Span, Instant};

use serde::Serialize;

use crate::alone::ROUTER;
use crate::child::Child;
use crate::config::{Channel, Setup, etag_of, free_port, number_of};
use crate::cost::Cost;
use crate::failed::Failed;
use crate::gateways;
use crate::latency::PATIENCE;
use crate::wire::Wire;

/// What one size costs.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Point {
    /// Segments, each with a gateway.
    pub segments: usize,
    /// Subjects on each.
    pub subjects: usize,
    /// Seconds from the start of the first gateway until everything crossed everywhere.
    pub began: f64,
    /// Processor time until then for each declaration, in microseconds: of the gateways, and of the router.
    pub declaration: [f64; 2],
    /// Megabytes taken from the allocator for each gateway, and by the router.
    pub memory: [f64; 2],
    /// Processor time with nothing to forward, in milliseconds a second: of a gateway, and of the router.
    pub idle: [f64; 2],
    /// Processor time for an event, in microseconds: at the gateway that sends; at the router, for each segment it goes
    /// to; at a gateway that receives.
    pub event: [f64; 3],
    /// Events that were sent, and what of them arrived of what should have.
    pub arrived: (u64, f64),
}

impl Point {
    /// Subscribers and publishers that are declared in all.
    pub const fn declarations(&self) -> usize {
        2 * self.segments * self.subjects
    }
}

/// All sizes.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Scale {
    /// The sizes.
    pub points: Vec<Point>,
}

impl fmt::Display for Scale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "scale: a gateway for each segment, one router; processor time, by what the kernel counts"
        )?;
        writeln!(
            f,
            "  {:>8} {:>8} {:>7} {:>8}  {:>17}  {:>15}  {:>15}  {:>21}  {:>9}",
            "", "", "", "begins", "µs a declaration", "MB", "idle, ms/s", "µs an event", "",
        )?;
        writeln!(
            f,
            "  {:>8} {:>8} {:>7} {:>8}  {:>8} {:>8}  {:>7} {:>7}  {:>7} {:>7}  {:>6} {:>7} {:>6}  {:>9}",
            "segments",
            "subjects",
            "declar.",
            "s",
            "gateway",
            "router",
            "gateway",
            "router",
            "gateway",
            "router",
            "sends",
            "router",
            "gets",
            "arrived",
        )?;
        for it in &self.points {
            let Point { segments, subjects, began, declaration, memory, idle, event, arrived } = it;
            writeln!(
                f,
                "  {segments:>8} {subjects:>8} {:>7} {began:>8.1}  {:>8.1} {:>8.1}  {:>7.2} {:>7.2}  {:>7.2} {:>7.2}  \
                 {:>6.1} {:>7.1} {:>6.1}  {:>8.2}%",
                it.declarations(),
                declaration[0],
                declaration[1],
                memory[0],
                memory[1],
                idle[0],
                idle[1],
                event[0],
                event[1],
                event[2],
                arrived.1 * 100.0,
            )?;
        }
        Ok(())
    }
}

/// Measures one size.
///
/// # Errors
/// Something does not start, or does not cross.
pub fn measure(folder: &Path, segments: usize, subjects: usize, events: u64) -> Result<Point, Failed> {
    let mut bed = Bed::start(folder, segments, subjects)?;
    let empty = bed.costs_of_start;
    bed.open()?;
    let (began, open) = (bed.begun.elapsed().as_secs_f64(), bed.costs()?);
    bed.settle()?;
    let before = bed.costs()?;
    std::thread::sleep(IDLE);
    let after = bed.costs()?;
    let gateways = segments as f64;
    let idle = [0, 1, 2].map(|at| after[at].cpu_since(&before[at]) as f64);
    let declarations = (2 * segments * subjects) as f64;
    let of_gateways = |costs: &[Cost; 3]| (costs[1].cpu + costs[2].cpu) as f64;
    let live = |costs: &[Cost; 3]| (costs[1].live + costs[2].live) as f64 / 1e6;
    let sent = Instant::now();
    let (heard, counted) = (bed.heard(), gateways::state(&mut bed.receive)?);
    bed.send(events);
    // Whole periods of what goes on anyway, so that this can be taken off.
    std::thread::sleep(IDLE - Span::from_nanos((sent.elapsed().as_nanos() % IDLE.as_nanos()) as u64));
    let took = sent.elapsed().as_secs_f64() / IDLE.as_secs_f64();
    let loaded = bed.costs()?;
    let arrived = bed.heard() - heard;
    let others = (segments - 1) as f64;
    if arrived < events * (segments as u64 - 1) {
        let now = gateways::state(&mut bed.receive)?;
        let lost: Vec<_> = now.lost_since(&counted).map(|(what, count)| format!("{what} {count}")).collect();
        eprintln!("gateway-bench: not all arrived; those that get counted: {}", lost.join(", "));
    }
    let more = |at: usize| {
        (loaded[at].cpu_since(&after[at]) as f64 - idle[at] * took).max(0.0) / 1e3 / events as f64
    };
    Ok(Point {
        segments,
        subjects,
        began,
        declaration: [
            (of_gateways(&open) - of_gateways(&empty)) / 1e3 / declarations,
            (open[0].cpu - empty[0].cpu) as f64 / 1e3 / declarations,
        ],
        memory: [(live(&after) - live(&empty)) / gateways, after[0].live as f64 / 1e6],
        idle: [
            (idle[1] + idle[2]) / gateways / IDLE.as_nanos() as f64 * 1e3,
            idle[0] / IDLE.as_nanos() as f64 * 1e3,
        ],
        event: [more(1), more(0) / others, more(2) / others],
        arrived: (events, arrived as f64 / (events as f64 * others)),
    })
}

/// Router, gateway that sends, gateways that receive; their wires.
struct Bed {
    router: Child,
    sends: Child,
    receive: Child,
    from: Wire,
    _to: Vec<Wire>,
    /// By segment and channel.
    heard: Arc<[AtomicU64]>,
    subjects: usize,
    costs_of_start: [Cost; 3],
    /// When the first gateway was started.
    begun: Instant,
}

impl Bed {
    fn start(folder: &Path, segments: usize, subjects: usize) -> Result<Self, Failed> {
        let receivers = segments - 1;
        let heard: Arc<[AtomicU64]> = (0..receivers * subjects).map(|_| AtomicU64::new(0)).collect();
        let from = Wire::serve(&folder.join("wire-0"), |_, _| {})?;
        let mut to = Vec::new();
        for at in 0..receivers {
            let heard = Arc::clone(&heard);
            to.push(Wire::serve(&folder.join(format!("wire-{}", at + 1)), move |frame, _| {
                if let Some(number) = number_of(frame.id.etag(), subjects) {
                    heard[at * subjects + number].fetch_add(1, Ordering::Relaxed);
                }
            })?);
        }
        let port = free_port()?;
        let mut router = Child::start(ROUTER, &[port.to_string()])?;
        let paths = [from.path()].into_iter().chain(to.iter().map(Wire::path));
        let file = |(at, path): (usize, &Path)| config(folder, at, path, port, subjects);
        let files: Vec<_> = paths.enumerate().map(file).collect::<Result<_, _>>()?;
        let (first, others) = files.split_at(1);
        // What the processes cost without gateways.
        let mut empty = gateways::start(&[], None)?;
        let without = gateways::state(&mut empty)?.cost;
        let costs_of_start = [router.ask("cost")?, without, without];
        drop(empty);
        let begun = Instant::now();
        let sends = gateways::start(first, None)?;
        let receive = gateways::start(others, None)?;
        Ok(Self { router, sends, receive, from, _to: to, heard, subjects, costs_of_start, begun })
    }

    fn costs(&mut self) -> Result<[Cost; 3], Failed> {
        let [sends, receive] = [&mut self.sends, &mut self.receive].map(gateways::state);
        Ok([self.router.ask("cost")?, sends?.cost, receive?.cost])
    }

    /// Until each knows the clocks of all others, and what goes on behind has ended.
    fn settle(&mut self) -> Result<(), Failed> {
        let (begun, others) = (Instant::now(), self.heard.len() / self.subjects);
        loop {
            let known =
                gateways::state(&mut self.sends)?.known.min(gateways::state(&mut self.receive)?.known);
            if known >= others {
                break;
            }
            if begun.elapsed() > OPENS {
                return Err(Failed(format!("a gateway knows the clocks of {known} of {others} others only")));
            }
            std::thread::sleep(Span::from_millis(500));
        }
        std::thread::sleep(Span::from_secs(5));
        Ok(())
    }

    fn heard(&self) -> u64 {
        self.heard.iter().map(|count| count.load(Ordering::Relaxed)).sum()
    }

    /// Until something has crossed on every subject, into every segment.
    fn open(&mut self) -> Result<(), Failed> {
        self.from.connected(PATIENCE)?;
        let begun = Instant::now();
        while self.heard.iter().any(|count| count.load(Ordering::Relaxed) == 0) {
            if begun.elapsed() > OPENS {
                let missing = self.heard.iter().filter(|count| count.load(Ordering::Relaxed) == 0).count();
                return Err(Failed(format!("{missing} of {} ways do not open", self.heard.len())));
            }
            // Only what is missing, so that asking costs little.
            for number in 0..self.subjects {
                let is_missing = self.heard.iter().skip(number).step_by(self.subjects);
                if is_missing.into_iter().any(|count| count.load(Ordering::Relaxed) == 0) {
                    self.from.say(etag_of(number as u16), 0);
                }
            }
            std::thread::sleep(Span::from_millis(500));
        }
        Ok(())
    }

    /// So many events, over the subjects in turn, as fast as receivers take them.
    fn send(&self, events: u64) {
        let pause = Span::from_micros(250 * (self.heard.len() / self.subjects).max(10) as u64);
        for number in 0..events {
            self.from.say(etag_of((number % self.subjects as u64) as u16), number);
            std::thread::sleep(pause);
        }
        let mut before = self.heard();
        loop {
            std::thread::sleep(SILENCE);
            let now = self.heard();
            if now == before {
                return;
            }
            before = now;
        }
    }
}

fn config(folder: &Path, at: usize, wire: &Path, port: u16, subjects: usize) -> Result<PathBuf, Failed> {
    let name = format!("segment-{at}");
    let channel = |number: usize| Channel {
        number: number as u16,
        from: Vec::new(),
        to: Vec::new(),
        unasked: vec![name.clone()],
    };
    let channels: Vec<_> = (0..subjects).map(channel).collect();
    let segments = [(name.clone(), wire.to_owned())];
    let setup =
        Setup { mode: "client", listen: None, connect: Some(port), segments: &segments, channels: &channels };
    setup.write(folder, &name)
}

/// For so long nothing is sent: a period of the questions for clocks of those that are silent.
const IDLE: Span = Span::from_secs(10);
/// What is under way has arrived when nothing has come for so long.
const SILENCE: Span = Span::from_secs(2);
/// What does not open by then, does not.
const OPENS: Span = Span::from_secs(300);
