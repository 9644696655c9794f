//! `cosmic hz` and `cosmic latency` across IP.

use std::process::ExitCode;

use serde::Serialize;

use super::flows::Flow;
use super::lists::heard;
use super::subjects;
use crate::arguments::Measure;
use crate::choice::Endpoint;
use crate::context::Context;
use crate::failure::Failure;
use crate::output::{Cell, Style, short, signed};

#[derive(Serialize, Debug)]
struct Rhythm<'a> {
    channel: &'a str,
    subject: &'a str,
    publisher: String,
    events: u64,
    missing: u64,
    hz: Option<f64>,
    mean_ns: Option<f64>,
    shortest_ns: Option<u64>,
    longest_ns: Option<u64>,
    deviation_ns: Option<f64>,
}

impl<'a> From<&'a Flow> for Rhythm<'a> {
    fn from(flow: &'a Flow) -> Self {
        let distances = &flow.distances;
        let measured = distances.shortest.is_some() && distances.mean > 0.0;
        Self {
            channel: flow.last.label(),
            subject: &flow.last.subject,
            publisher: flow.last.place(),
            events: distances.events,
            missing: flow.missing,
            hz: measured.then(|| 1e9 / distances.mean),
            mean_ns: measured.then_some(distances.mean),
            shortest_ns: distances.shortest,
            longest_ns: distances.shortest.map(|_| distances.longest),
            deviation_ns: measured.then(|| distances.deviation()),
        }
    }
}

/// `cosmic hz`
pub(super) async fn hz(context: &mut Context, at: &Endpoint, options: &Measure) -> Result<ExitCode, Failure> {
    let subjects = subjects(context, &options.channels)?;
    let (flows, ..) = heard(context, at, subjects.as_deref(), &options.listen).await?;
    let rhythms: Vec<Rhythm<'_>> = flows.iter().map(Rhythm::from).collect();
    if context.output.json() {
        context.output.whole(&rhythms)?;
    } else if !rhythms.is_empty() {
        let heads =
            ["CHANNEL", "PUBLISHER", "EVENTS", "MISSING", "HZ", "MEAN", "SHORTEST", "LONGEST", "DEVIATION"];
        context.output.table(&heads, &rhythms.iter().map(rhythm_row).collect::<Vec<_>>())?;
    }
    Ok(context.ended(!rhythms.is_empty(), NOTHING))
}

fn rhythm_row(rhythm: &Rhythm<'_>) -> Vec<Cell> {
    let span = |ns: Option<f64>| Cell::or_dash(ns.map(|ns| short(ns.round() as u64)));
    vec![
        Cell::new(rhythm.channel),
        Cell::new(rhythm.publisher.clone()),
        Cell::number(rhythm.events),
        alarming(rhythm.missing),
        Cell::number(rhythm.hz.map_or_else(|| "-".to_owned(), |hz| format!("{hz:.1}"))),
        span(rhythm.mean_ns),
        span(rhythm.shortest_ns.map(|ns| ns as f64)),
        span(rhythm.longest_ns.map(|ns| ns as f64)),
        span(rhythm.deviation_ns),
    ]
}

#[derive(Serialize, Debug)]
struct Latency<'a> {
    channel: &'a str,
    subject: &'a str,
    class: &'a str,
    publisher: String,
    events: u64,
    /// The longest time that one may have taken from its sender to here.
    oldest_ns: Option<u64>,
    /// Negative: it was late.
    least_left_ns: Option<i64>,
    late: u64,
    /// Events of whose time nothing is known: without a deadline, or before their sender's clock was known.
    unknown: u64,
}

impl<'a> From<&'a Flow> for Latency<'a> {
    fn from(flow: &'a Flow) -> Self {
        Self {
            channel: flow.last.label(),
            subject: &flow.last.subject,
            class: flow.last.class,
            publisher: flow.last.place(),
            events: flow.distances.events,
            oldest_ns: flow.oldest_ns,
            least_left_ns: flow.least_left_ns,
            late: flow.late,
            unknown: flow.distances.events - flow.judged,
        }
    }
}

/// `cosmic latency`
pub(super) async fn latency(
    context: &mut Context,
    at: &Endpoint,
    options: &Measure,
) -> Result<ExitCode, Failure> {
    let subjects = subjects(context, &options.channels)?;
    let (flows, ..) = heard(context, at, subjects.as_deref(), &options.listen).await?;
    let latencies: Vec<Latency<'_>> = flows.iter().map(Latency::from).collect();
    if context.output.json() {
        context.output.whole(&latencies)?;
    } else if !latencies.is_empty() {
        let heads =
            ["CHANNEL", "CLASS", "PUBLISHER", "EVENTS", "ON IP AT MOST", "LEFT AT LEAST", "LATE", "UNKNOWN"];
        context.output.table(&heads, &latencies.iter().map(latency_row).collect::<Vec<_>>())?;
    }
    Ok(context.ended(!latencies.is_empty(), NOTHING))
}

fn latency_row(latency: &Latency<'_>) -> Vec<Cell> {
    vec![
        Cell::new(latency.channel),
        Cell::new(latency.class),
        Cell::new(latency.publisher.clone()),
        Cell::number(latency.events),
        Cell::or_dash(latency.oldest_ns.map(short)),
        Cell::or_dash(latency.least_left_ns.map(signed)),
        alarming(latency.late),
        Cell::number(latency.unknown),
    ]
}

fn alarming(count: u64) -> Cell {
    let cell = Cell::number(count);
    if count > 0 { cell.styled(Style::Bad) } else { cell }
}

const NOTHING: &str = "no such event has crossed; `cosmic channels` across IP shows what there is";
