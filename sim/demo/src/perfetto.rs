//! A trace for [ui.perfetto.dev](https://ui.perfetto.dev): what each node did, what was on the bus, what the calendar
//! had planned, and the way of each event from publication to delivery.
//!
//! The format is the Trace Event Format (JSON), which Perfetto's viewer and its trace processor read. Instants are
//! microseconds of true time.
//!
//! | process | tracks |
//! |---|---|
//! | bus | frames, destroyed ones too |
//! | calendar | a track for each slot: its window and the parts of it |
//! | each node | its tasks and interrupts; what was published and delivered, with arrows; exceptions |
//!
//! Tasks of RTIC run in handlers of interrupts, so a track is a handler. A task that is pre-empted still stands on its
//! track; who pre-empts it stands on another.

use std::collections::BTreeMap;
use std::io::{self, Write};

use cosmic_bus::VirtualInstant;
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::ExceptionKind;
use serde::Serialize;
use serde_json::{Value, json};

use crate::bus_log::Ending;
use crate::cluster::Channel;
use crate::hard::Fate;
use crate::journal::{HandlerRun, Journal};
use crate::ledger::Life;
use crate::verdict::Verdict;

/// Writes the trace of a run.
///
/// # Errors
/// Those of the writer.
pub fn write(journal: &Journal, verdict: &Verdict, out: impl Write) -> io::Result<()> {
    let mut trace = Trace { out, is_empty: true };
    trace.out.write_all(b"{\"displayTimeUnit\":\"ns\",\"traceEvents\":[\n")?;
    bus(journal, verdict, &mut trace)?;
    calendar(journal, verdict, &mut trace)?;
    for (index, node) in journal.cluster.nodes.iter().enumerate() {
        let process = FIRST_NODE + index as u32;
        trace.process(process, node.name)?;
        handlers(journal, node.tx_node, process, &mut trace)?;
        exceptions(journal, verdict, node.tx_node, process, &mut trace)?;
        trace.thread(process, PUBLISHED, "published")?;
        trace.thread(process, DELIVERED, "delivered")?;
    }
    events(journal, verdict, &mut trace)?;
    trace.out.write_all(b"\n]}\n")?;
    trace.out.flush()
}

/// An event of the format; what is absent is left out.
#[derive(Serialize, Default)]
struct TraceEvent<'t> {
    name: &'t str,
    cat: &'t str,
    ph: &'t str,
    ts: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    dur: Option<f64>,
    pid: u32,
    tid: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<u64>,
    /// An arrow ends at the slice around it.
    #[serde(skip_serializing_if = "Option::is_none")]
    bp: Option<&'t str>,
    /// How far an instant reaches.
    #[serde(skip_serializing_if = "Option::is_none")]
    s: Option<&'t str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    args: Option<Value>,
}

/// Where something stands.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Track {
    process: u32,
    thread: u32,
}

impl Track {
    /// No two tracks have the same, in whatever process: some readers think that the number of a thread is enough.
    const fn number(self) -> u32 {
        self.process * 1_000 + self.thread
    }
}

struct Trace<W> {
    out: W,
    is_empty: bool,
}

impl<W: Write> Trace<W> {
    fn put(&mut self, event: &TraceEvent<'_>) -> io::Result<()> {
        if !std::mem::take(&mut self.is_empty) {
            self.out.write_all(b",\n")?;
        }
        serde_json::to_writer(&mut self.out, event).map_err(io::Error::from)
    }

    fn process(&mut self, pid: u32, name: &str) -> io::Result<()> {
        let about = |name, args| TraceEvent { name, ph: "M", pid, args: Some(args), ..TraceEvent::default() };
        self.put(&about("process_name", json!({ "name": name })))?;
        self.put(&about("process_sort_index", json!({ "sort_index": pid })))
    }

    fn thread(&mut self, pid: u32, thread: u32, name: &str) -> io::Result<()> {
        let tid = Track { process: pid, thread }.number();
        let about =
            |name, args| TraceEvent { name, ph: "M", pid, tid, args: Some(args), ..TraceEvent::default() };
        self.put(&about("thread_name", json!({ "name": name })))?;
        self.put(&about("thread_sort_index", json!({ "sort_index": tid })))
    }

    fn slice(
        &mut self,
        track: Track,
        (cat, name): (&str, &str),
        (from, until): (VirtualInstant, VirtualInstant),
        args: Value,
    ) -> io::Result<()> {
        // Not the difference of two roundings: slices that touch must not overlap.
        let dur = until.as_ticks().saturating_sub(from.as_ticks()) as f64 / 1e3;
        let (ts, dur, args) = (micros(from), Some(dur), Some(args));
        let (pid, tid) = (track.process, track.number());
        self.put(&TraceEvent { name, cat, ph: "X", ts, dur, pid, tid, args, ..TraceEvent::default() })
    }

    /// A part of an arrow: `s` begins it, `t` leads it on, `f` ends it.
    fn arrow(&mut self, track: Track, ph: &str, id: u64, name: &str, at: VirtualInstant) -> io::Result<()> {
        let (pid, tid) = (track.process, track.number());
        let bp = (ph == "f").then_some("e");
        let (ts, id) = (micros(at), Some(id));
        self.put(&TraceEvent { name, cat: "event", ph, ts, pid, tid, id, bp, ..TraceEvent::default() })
    }
}

fn bus<W: Write>(journal: &Journal, verdict: &Verdict, trace: &mut Trace<W>) -> io::Result<()> {
    trace.process(BUS.process, "bus")?;
    trace.thread(BUS.process, BUS.thread, "frames")?;
    for attempt in journal.bus.attempts() {
        let (name, priority) = match attempt.frame() {
            Some(frame) => {
                let (etag, sender) = (frame.id.etag(), frame.id.tx_node());
                let event = attempt.load.and_then(|load| verdict.ledger.event_of(load));
                let name = match (journal.cluster.channel_of(etag, sender), event) {
                    (Some(channel), Some(event)) => format!("{} {event}", channel.name),
                    (Some(channel), None) => channel.name.to_owned(),
                    (None, _) if etag.is_reserved() => "clock and control".to_owned(),
                    (None, _) => "background load".to_owned(),
                };
                (name, Some(frame.id.priority().get()))
            }
            None => ("foreign".to_owned(), None),
        };
        let (cat, outcome) = match attempt.ending {
            Ending::Sent => ("frame", "sent".to_owned()),
            Ending::Open => ("frame", "on the wire at the end".to_owned()),
            Ending::Failed(error) => {
                ("destroyed", format!("destroyed in bit {} ({:?})", error.bit, error.field))
            }
        };
        let name = if attempt.has_failed() { format!("destroyed: {name}") } else { name };
        let args = json!({
            "priority": priority,
            "attempt": attempt.attempt,
            "outcome": outcome,
            "frame": format!("{:?}", attempt.wire_frame),
        });
        trace.slice(BUS, (cat, &name), (attempt.start, attempt.end), args)?;
    }
    Ok(())
}

fn calendar<W: Write>(journal: &Journal, verdict: &Verdict, trace: &mut Trace<W>) -> io::Result<()> {
    trace.process(CALENDAR, "calendar")?;
    for (index, slot) in journal.cluster.calendar.slots().iter().enumerate() {
        let track = Track { process: CALENDAR, thread: 1 + index as u32 };
        let channel = journal.cluster.channel_of(slot.etag, slot.publisher);
        let name = channel.map_or("a slot", |channel| channel.name);
        trace.thread(track.process, track.thread, &format!("slot of {name}"))?;
        let longest = journal.bit_rate.longest_frame(usize::from(slot.len));
        for occurrence in verdict.slots.occurrences.iter().filter(|it| it.slot == slot) {
            let window = &occurrence.window;
            let args = json!({
                "fate": fate(occurrence.fate),
                "destroyed attempts": occurrence.faulted,
                "omission degree": slot.omission_degree,
            });
            trace.slice(track, ("slot", name), (window.ready, window.delivery), args)?;
            let first_end = (window.latest_start + longest).min(window.deadline);
            for (part, from, until) in [
                ("waits for the bus", window.ready, window.latest_start),
                ("longest frame", window.latest_start, first_end),
                ("retransmissions", first_end, window.deadline),
                ("clock gap", window.deadline, window.delivery),
            ] {
                if from < until {
                    trace.slice(track, ("slot", part), (from, until), json!({}))?;
                }
            }
        }
    }
    Ok(())
}

const fn fate(fate: Fate) -> &'static str {
    match fate {
        Fate::Settling => "not judged: clocks not synchronised yet, or nothing published",
        Fate::NoCommonTime => "not judged: no common time",
        Fate::Delivered => "delivered to all subscribers",
        Fate::Unused => "unused",
        Fate::Lost => "lost, and told",
        Fate::Violated => "not as promised",
    }
}

/// The tracks of tasks and interrupts, the most urgent first.
fn handlers<W: Write>(journal: &Journal, node: TxNode, process: u32, trace: &mut Trace<W>) -> io::Result<()> {
    let runs = || journal.handlers.iter().filter(|run| run.node == node);
    let mut tracks: BTreeMap<(u8, u16), &HandlerRun> = BTreeMap::new();
    for run in runs() {
        tracks.entry((run.priority, run.exception)).or_insert(run);
    }
    let tasks: Vec<u8> =
        tracks.values().filter(|run| interrupt(&run.name).is_none()).map(|run| run.priority).collect();
    for (order, run) in tracks.values().enumerate() {
        let what = interrupt(&run.name).unwrap_or_else(|| task(&tasks, run.priority));
        let thread = HANDLERS + order as u32;
        trace.thread(process, thread, &format!("{what} ({})", run.name))?;
        for run in runs().filter(|other| (other.priority, other.exception) == (run.priority, run.exception)) {
            trace.slice(Track { process, thread }, ("task", what), (run.from, run.until), json!({}))?;
        }
    }
    Ok(())
}

/// What an interrupt of the boards' peripherals is for; the others are tasks.
fn interrupt(name: &str) -> Option<&'static str> {
    Some(match name {
        "TIM2" => "timer",
        "CAN1_TX" => "sent frames",
        "CAN1_RX0" => "urgent frames",
        "CAN1_RX1" => "other frames",
        "CAN1_SCE" => "bus status",
        _ => return None,
    })
}

/// Of the tasks of a node the most urgent is that of the calendar, and the least urgent ones are the application;
/// between them is the event half (the crate documentation of `cosmic-rtic`).
fn task(priorities: &[u8], priority: u8) -> &'static str {
    let most = priorities.iter().min() == Some(&priority);
    let least = priorities.iter().max() == Some(&priority);
    match (most, least) {
        (true, false) => "calendar task",
        (_, true) => "application",
        (false, false) => "event half",
    }
}

fn exceptions<W: Write>(
    journal: &Journal,
    verdict: &Verdict,
    node: TxNode,
    process: u32,
    trace: &mut Trace<W>,
) -> io::Result<()> {
    trace.thread(process, EXCEPTIONS, "exceptions")?;
    for told in verdict.ledger.told.iter().filter(|told| told.node == node) {
        let kind: ExceptionKind = told.kind;
        let channel = told.etag.and_then(|etag| journal.cluster.channel(etag)).map(|channel| channel.name);
        trace.put(&TraceEvent {
            name: kind.name(),
            cat: "exception",
            ph: "i",
            ts: micros(told.at),
            pid: process,
            tid: Track { process, thread: EXCEPTIONS }.number(),
            s: Some("t"),
            args: Some(json!({ "channel": channel })),
            ..TraceEvent::default()
        })?;
    }
    Ok(())
}

/// Publications and deliveries as short slices, and an arrow from each publication over the bus to each delivery.
fn events<W: Write>(journal: &Journal, verdict: &Verdict, trace: &mut Trace<W>) -> io::Result<()> {
    let process = |node: TxNode| {
        let index = journal.cluster.nodes.iter().position(|it| it.tx_node == node).unwrap_or(0);
        FIRST_NODE + index as u32
    };
    let mut marks: BTreeMap<Track, Vec<(VirtualInstant, String, Value)>> = BTreeMap::new();
    // An arrow touches slices, so that these come first.
    let mut arrows = Vec::new();
    for account in &verdict.ledger.channels {
        let channel = account.channel;
        let published = Track { process: process(channel.publisher), thread: PUBLISHED };
        for (number, life) in account.events.iter().enumerate() {
            let name = format!("{} {number}", channel.name);
            let mark = (life.published_at, name.clone(), about(channel, life));
            marks.entry(published).or_default().push(mark);
            for delivery in &life.deliveries {
                let delivered = Track { process: process(delivery.subscriber), thread: DELIVERED };
                let latency = micros(delivery.visible_at) - micros(life.published_at);
                let args = json!({ "latency in µs": latency, "fetched at": micros(delivery.taken_at) });
                marks.entry(delivered).or_default().push((delivery.visible_at, name.clone(), args));
                let over = start_of(journal, life).map(|start| (BUS, "t", start));
                let ends = [(published, "s", life.published_at), (delivered, "f", delivery.visible_at)];
                arrows.push((name.clone(), [Some(ends[0]), over, Some(ends[1])]));
            }
        }
    }
    for (track, mut marks) in marks {
        marks.sort_by_key(|(at, ..)| *at);
        // No longer than until the next one: slices of one track do not overlap.
        let ends = marks.iter().skip(1).map(|(at, ..)| *at).chain([journal.end]).collect::<Vec<_>>();
        for ((at, name, args), next) in marks.into_iter().zip(ends) {
            let until = VirtualInstant::from_ticks(at.as_ticks() + MARK).min(next).max(at);
            trace.slice(track, ("event", &name), (at, until), args)?;
        }
    }
    for (id, (name, parts)) in (1..).zip(arrows) {
        for (track, ph, at) in parts.into_iter().flatten() {
            trace.arrow(track, ph, id, &name, at)?;
        }
    }
    Ok(())
}

fn about(channel: &Channel, life: &Life) -> Value {
    json!({
        "class": channel.class.name(),
        "taken": life.taken,
        "sent at": life.sent_at.map(micros),
        "deadline": life.deadline.map(micros),
    })
}

/// The start of the frame that carried an event, or rather of its last attempt.
fn start_of(journal: &Journal, life: &Life) -> Option<VirtualInstant> {
    let heard = life.heard_at?;
    let attempts = journal.bus.attempts();
    let place = attempts.partition_point(|attempt| attempt.end < heard);
    attempts.get(place).filter(|attempt| attempt.end == heard).map(|attempt| attempt.start)
}

fn micros(at: VirtualInstant) -> f64 {
    at.as_ticks() as f64 / 1e3
}

const BUS: Track = Track { process: 1, thread: 1 };
const CALENDAR: u32 = 2;
const FIRST_NODE: u32 = 10;
const PUBLISHED: u32 = 1;
const DELIVERED: u32 = 2;
const EXCEPTIONS: u32 = 3;
/// The first track of tasks and interrupts.
const HANDLERS: u32 = 10;
/// How long a mark is, in nanoseconds.
const MARK: u64 = 2_000;
