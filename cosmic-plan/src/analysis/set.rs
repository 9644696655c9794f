//! Plain sets of messages, as the literature has them, and their response times.
//!
//! The input is TOML or JSON:
//!
//! ```toml
//! bit_rate = 125_000          # bits per second, or "125 kbit/s"
//! time_unit = "ms"            # optional: then spans may be bare numbers
//!
//! [errors]                    # optional; either of
//! burst = 2                   #   so many faults at once, then one every interval
//! interval = 10
//! # count = 3                 #   at most so many faults in any window
//! # window = 10
//!
//! [[message]]
//! name = "A"                  # optional
//! id = 0x10                   # without ids, the order of the file is that of priority
//! extended = false            # optional; ids above 0x7FF are extended anyway
//! length = 8                  # bytes of data; or:
//! transmission_time = 1       # C itself, instead of length
//! period = 2.5                # or least distance
//! deadline = 2.5              # optional: the period
//! jitter = 0                  # optional: 0
//! ```

use super::bus::{Bus, Stream};
use super::calendar_load::CalendarLoad;
use super::errors::ErrorModel;
use super::fixed::Level;
use super::frame::{arbitration_key, bit_times, longest_frame_bits};
use crate::document::{At, FromNode, Kind, Log, Mismatch, Node, Problems, Source, Table};
use crate::units;
use serde::Serialize;
use std::collections::HashMap;

/// A CAN message in the sense of response-time analysis: frames with one identifier that come again and again.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CanMessage {
    /// Its name.
    pub name: String,
    /// Where it stands in arbitration: the smaller wins.
    pub key: u64,
    /// C, T, J.
    pub stream: Stream,
    /// D, in nanoseconds.
    pub deadline: u64,
}

/// A set of messages on a bus.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct MessageSet {
    /// Bits per second.
    pub bit_rate: u32,
    /// The faults.
    pub errors: ErrorModel,
    /// The messages, in the order of the file.
    pub messages: Vec<CanMessage>,
}

/// What the analysis says of a message. Spans are in microseconds.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct Finding {
    /// Its name.
    pub name: String,
    /// C.
    pub transmission_us: f64,
    /// T.
    pub period_us: f64,
    /// D.
    pub deadline_us: f64,
    /// J.
    pub jitter_us: f64,
    /// B: the longest message of lower priority.
    pub blocking_us: f64,
    /// R by the exact test; `null` if there is no bound.
    pub exact_us: Option<f64>,
    /// R by the sufficient test; `null` if it has no solution, or does not apply because the deadline is
    /// beyond the period. A value above the deadline says nothing.
    pub sufficient_us: Option<f64>,
    /// Instances in the busy period, all of which the exact test looks at.
    pub instances: u64,
    /// The instance, from 0, whose response is the longest.
    pub worst_instance: u64,
    /// "meets" or "misses": does every instance meet its deadline (exact test)?
    pub verdict: &'static str,
    /// As `verdict`, by the sufficient test: "meets", or "unknown".
    pub sufficient_verdict: &'static str,
}

/// The analysis of a set.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct Findings {
    /// "holds" if every message meets its deadline, else "fails".
    pub verdict: &'static str,
    /// The share of time that the messages take, without faults.
    pub utilisation: f64,
    /// One for each message, in the order of the file.
    pub messages: Vec<Finding>,
}

impl MessageSet {
    /// Reads a set.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn read(source: &Source) -> Result<Self, Problems> {
        let log = Log::default();
        let root = Node::parse(source, &log);
        let table = Table::new(&root, "", &log);
        let set = read(&table, &log);
        match log.into_problems(source) {
            Some(problems) => Err(problems),
            None => Ok(set),
        }
    }

    /// Response times of all messages. `watch` is called after each.
    pub fn analyse(&self, watch: &dyn Fn(&str)) -> Findings {
        let bus = Bus {
            bit: bit_times(1, self.bit_rate),
            recovery: bit_times(u64::from(cosmic_core::can::ERROR_RECOVERY_BITS), self.bit_rate),
            errors: self.errors,
            calendar: CalendarLoad::default(),
        };
        let mut order: Vec<usize> = (0..self.messages.len()).collect();
        order.sort_by_key(|at| self.messages[*at].key);
        let streams: Vec<Stream> = order.iter().map(|at| self.messages[*at].stream).collect();
        let mut findings: Vec<Option<Finding>> = vec![None; order.len()];
        for (rank, &at) in order.iter().enumerate() {
            let longest = |streams: &[Stream]| streams.iter().map(|s| s.transmission).max().unwrap_or(0);
            let level = Level {
                higher: &streams[..rank],
                blocking: longest(&streams[rank + 1..]),
                longest: longest(&streams[..=rank]),
            };
            findings[at] = Some(finding(&self.messages[at], &level, &bus));
            watch("analysing messages");
        }
        let messages: Vec<Finding> = findings.into_iter().flatten().collect();
        let holds = messages.iter().all(|finding| finding.verdict == "meets");
        let utilisation = streams.iter().map(Stream::utilisation).sum();
        Findings { verdict: if holds { "holds" } else { "fails" }, utilisation, messages }
    }
}

fn finding(message: &CanMessage, level: &Level<'_>, bus: &Bus) -> Finding {
    let us = |ticks: u64| ticks as f64 / 1000.0;
    let exact = level.exact(&message.stream, bus);
    let applies = message.deadline <= message.stream.period;
    let sufficient = level.sufficient(&message.stream, bus, 0).filter(|_| applies);
    let meets = |response: Option<u64>| response.is_some_and(|response| response <= message.deadline);
    Finding {
        name: message.name.clone(),
        transmission_us: us(message.stream.transmission),
        period_us: us(message.stream.period),
        deadline_us: us(message.deadline),
        jitter_us: us(message.stream.jitter),
        blocking_us: us(level.blocking),
        exact_us: exact.response.map(us),
        sufficient_us: sufficient.map(us),
        instances: exact.instances,
        worst_instance: exact.worst_instance,
        verdict: if meets(exact.response) { "meets" } else { "misses" },
        sufficient_verdict: if meets(sufficient) { "meets" } else { "unknown" },
    }
}

/// A span, which may be a bare number if the file gives a unit of time.
struct Time<'a> {
    unit: Option<&'a str>,
}

impl Time<'_> {
    fn read(&self, table: &Table<'_>, field: &'static str) -> Option<At<u64>> {
        let node = table.node(field)?;
        let span = match (&node.kind, self.unit.and_then(units::unit_exponent)) {
            // Numbers that programs compute have digits beyond any meaning.
            (Kind::Number(text, 10), Some(exponent)) => units::parse_rounded_ticks(text, exponent),
            (Kind::Text(text), _) => units::parse_span(text).map(|span| span.as_ticks()),
            _ => None,
        };
        if span.is_none() {
            let what = format!("{} is not a span of time", node.describe());
            let help = match (&node.kind, self.unit) {
                (Kind::Text(text), _) if units::is_too_fine(text) => "round it to whole nanoseconds",
                (Kind::Number(..), Some(_)) => {
                    "write a number from 0, such as 10 or 2.5e-3, below eleven days"
                }
                _ => "write a number with its unit, such as \"10 ms\", or give time_unit = \"ms\" for all",
            };
            table.is_malformed(field);
            table.problem(field, node.place.clone(), what, help);
        }
        span.map(|value| At { value, place: node.place.clone() })
    }
}

struct AnyRate(u32);

impl FromNode for AnyRate {
    fn from_node(node: &Node) -> Result<Self, Mismatch> {
        let bits = match &node.kind {
            Kind::Text(text) | Kind::Number(text, 10) => units::parse_bits_per_second(text),
            _ => None,
        };
        bits.filter(|bits| (1..=1_000_000).contains(bits)).map(Self).ok_or_else(|| {
            let what = format!("{} is not a bit rate up to 1 Mbit/s", node.describe());
            Mismatch::new(what, "write bits per second, or \"125 kbit/s\"")
        })
    }
}

fn read(table: &Table<'_>, log: &Log) -> MessageSet {
    let bit_rate: Option<At<AnyRate>> =
        table.required("bit_rate", "write bit_rate = 125000 (bits per second)");
    let bit_rate = bit_rate.map_or(1_000_000, |at| at.value.0);
    let unit: Option<At<String>> = table.optional("time_unit");
    if let Some(at) = unit.as_ref().filter(|at| units::unit_exponent(&at.value).is_none()) {
        table.problem("time_unit", at.place.clone(), "is not a unit of time", "write ns, us, ms or s");
    }
    let time = Time { unit: unit.as_ref().map(|at| at.value.as_str()) };
    let errors = match table.node("errors") {
        Some(node) => read_errors(&Table::new(node, "errors", log), &time),
        None => ErrorModel::None,
    };
    let nodes = table.nodes("message").or_else(|| table.nodes("messages"));
    if nodes.is_none_or(<[Node]>::is_empty) && table.malformed().is_empty() {
        table.problem("message", table.place(), "is missing", "write at least one [[message]]");
    }
    let nodes = nodes.unwrap_or_default();
    let mut seen = HashMap::new();
    let mut with_id = 0;
    let mut messages = Vec::new();
    for (at, node) in nodes.iter().enumerate() {
        let mut table = Table::new(node, format!("message[{at}]"), log);
        let read = read_message(&mut table, at, bit_rate, &time);
        with_id += usize::from(read.1);
        if read.1 && seen.insert(read.0.key, at).is_some() {
            table.problem(
                "id",
                node.place.clone(),
                "stands here a second time",
                "give every message its own",
            );
        }
        messages.push(read.0);
    }
    if with_id != 0 && with_id != nodes.len() {
        let help = "give every message an id, or none (then the order of the file is that of priority)";
        table.problem("message", table.place(), "only some messages have an id", help);
    }
    table.finish();
    MessageSet { bit_rate, errors, messages }
}

fn read_errors(table: &Table<'_>, time: &Time<'_>) -> ErrorModel {
    let burst: Option<At<u32>> = table.optional("burst");
    let interval = time.read(table, "interval").filter(|at| at.value > 0);
    let count: Option<At<u32>> = table.optional("count");
    let window = time.read(table, "window").filter(|at| at.value > 0);
    table.finish();
    let span = |at: At<u64>| cosmic_core::time::Duration::from_ticks(at.value);
    match (burst, interval, count, window) {
        (Some(burst), Some(interval), None, None) => {
            ErrorModel::Burst { burst: burst.value, interval: span(interval) }
        }
        (None, None, Some(count), Some(window)) => {
            ErrorModel::Window { count: count.value, window: span(window) }
        }
        _ if !table.malformed().is_empty() => ErrorModel::None,
        _ => {
            let help = "write burst and interval, or count and window, with spans above zero";
            table.problem("burst", table.place(), "is neither of the two models", help);
            ErrorModel::None
        }
    }
}

/// The message, and whether it has an id.
fn read_message(table: &mut Table<'_>, at: usize, bit_rate: u32, time: &Time<'_>) -> (CanMessage, bool) {
    let name: Option<At<String>> = table.optional("name");
    let name = name.map_or_else(|| format!("message {at}"), |at| at.value);
    table.rename(format!("message.{name}"));
    let id: Option<At<u32>> = table.optional("id");
    let extended: Option<At<bool>> = table.optional("extended");
    let extended = extended.map_or(id.as_ref().is_some_and(|id| id.value > 0x7FF), |extended| extended.value);
    let limit = if extended { 0x1FFF_FFFF } else { 0x7FF };
    if let Some(id) = id.as_ref().filter(|id| id.value > limit) {
        let what = format!("{:#x} is too large", id.value);
        table.problem("id", id.place.clone(), what, format!("write at most {limit:#x}"));
    }
    let stream = read_stream(table, extended, bit_rate, time);
    let deadline = time.read(table, "deadline").map_or(stream.period, |at| at.value);
    table.finish();
    let key = id.as_ref().map_or(at as u64, |id| u64::from(arbitration_key(id.value, extended)));
    (CanMessage { name, key, stream, deadline }, id.is_some())
}

fn read_stream(table: &Table<'_>, extended: bool, bit_rate: u32, time: &Time<'_>) -> Stream {
    let length: Option<At<u8>> = table.optional("length");
    let transmission_time = time.read(table, "transmission_time");
    let transmission = match (length, transmission_time) {
        (Some(length), None) if length.value <= 8 => {
            bit_times(longest_frame_bits(extended, length.value), bit_rate)
        }
        (None, Some(time)) => time.value,
        (Some(length), None) => {
            table.problem("length", length.place, "is above 8", "write 0 to 8 bytes");
            1
        }
        (None, None)
            if ["length", "transmission_time"].iter().any(|field| table.malformed().contains(field)) =>
        {
            1
        }
        _ => {
            let help = "write length in bytes, or transmission_time; not both";
            table.problem("length", table.place(), "is missing or stands beside transmission_time", help);
            1
        }
    };
    let period = time.read(table, "period");
    if period.as_ref().is_none_or(|at| at.value == 0) && !table.malformed().contains(&"period") {
        table.problem("period", table.place(), "is missing or zero", "write period = \"10 ms\"");
    }
    Stream {
        transmission,
        period: period.map_or(1, |at| at.value.max(1)),
        jitter: time.read(table, "jitter").map_or(0, |at| at.value),
    }
}
