//! `cosmic hz` and `cosmic latency`: how often events come, and how near to their deadlines.

use std::collections::BTreeMap;
use std::process::ExitCode;

use cosmic_core::can::{Etag, TxNode};
use cosmic_linux::What;
use cosmic_log::feed;
use cosmic_monitor::{ChannelView, Monitor, SlotView};
use serde::Serialize;

use super::{listen, warn};
use crate::arguments::Measure;
use crate::context::{Chosen, Context};
use crate::distances::Distances;
use crate::failure::Failure;
use crate::output::{Cell, Style, short, signed};

#[derive(Serialize, Debug)]
struct Rhythm {
    channel: String,
    etag: u16,
    tx_node: u8,
    node: Option<String>,
    events: u64,
    hz: Option<f64>,
    mean_ns: Option<f64>,
    shortest_ns: Option<u64>,
    longest_ns: Option<u64>,
    deviation_ns: Option<f64>,
    /// The period or least distance in the plan.
    period_ns: Option<u64>,
}

/// `cosmic hz`
pub(super) async fn hz(context: &mut Context, options: &Measure) -> Result<ExitCode, Failure> {
    let chosen = context.chosen(&options.channels)?;
    let mut source = context.source(Some(options.listen.span)).await?;
    let mut monitor = context.informed_monitor(source.now());
    let mut all: BTreeMap<(Etag, TxNode), Distances> = BTreeMap::new();
    while let Some(tapped) = source.next().await {
        let tapped = tapped?;
        warn(&tapped);
        feed(&mut monitor, &tapped);
        let What::Frame(frame) = tapped.what else { continue };
        let etag = frame.id.etag();
        if !etag.is_reserved() && chosen.has(&monitor, etag) && all.len() < MOST {
            all.entry((etag, frame.id.tx_node())).or_default().add(tapped.at);
        }
    }
    let views = monitor.snapshot(source.now()).channels;
    let rhythm = |(&(etag, tx_node), distances): (&(Etag, TxNode), &Distances)| {
        let view = views.iter().find(|view| view.etag == Some(etag.get()));
        let measured = distances.shortest.is_some() && distances.mean > 0.0;
        Rhythm {
            channel: view.map_or_else(|| format!("etag {}", etag.get()), ChannelView::label),
            etag: etag.get(),
            tx_node: tx_node.get(),
            node: monitor.name_of(tx_node),
            events: distances.events,
            hz: measured.then(|| 1e9 / distances.mean),
            mean_ns: measured.then_some(distances.mean),
            shortest_ns: distances.shortest,
            longest_ns: distances.shortest.map(|_| distances.longest),
            deviation_ns: measured.then(|| distances.deviation()),
            period_ns: view.and_then(|view| view.period_ns),
        }
    };
    let rhythms: Vec<Rhythm> = all.iter().map(rhythm).collect();
    if context.output.json() {
        context.output.whole(&rhythms)?;
    } else if !rhythms.is_empty() {
        let heads =
            ["CHANNEL", "NODE", "EVENTS", "HZ", "MEAN", "SHORTEST", "LONGEST", "DEVIATION", "PLANNED"];
        context.output.table(&heads, &rhythms.iter().map(rhythm_row).collect::<Vec<_>>())?;
    }
    Ok(context.ended(!rhythms.is_empty(), NOTHING))
}

fn rhythm_row(rhythm: &Rhythm) -> Vec<Cell> {
    let span = |ns: Option<f64>| Cell::or_dash(ns.map(|ns| short(ns.round() as u64)));
    vec![
        Cell::new(rhythm.channel.clone()),
        Cell::new(rhythm.node.clone().unwrap_or_else(|| format!("{:02X}", rhythm.tx_node))),
        Cell::number(rhythm.events),
        Cell::number(rhythm.hz.map_or_else(|| "-".to_owned(), |hz| format!("{hz:.1}"))),
        span(rhythm.mean_ns),
        span(rhythm.shortest_ns.map(|ns| ns as f64)),
        span(rhythm.longest_ns.map(|ns| ns as f64)),
        span(rhythm.deviation_ns),
        span(rhythm.period_ns.map(|ns| ns as f64)),
    ]
}

#[derive(Serialize, Debug)]
struct Latencies<'a> {
    soft: Vec<&'a ChannelView>,
    hard: Vec<&'a SlotView>,
}

/// `cosmic latency`
pub(super) async fn latency(context: &mut Context, options: &Measure) -> Result<ExitCode, Failure> {
    let chosen = context.chosen(&options.channels)?;
    let mut source = context.source(Some(options.listen.span)).await?;
    let mut monitor = context.informed_monitor(source.now());
    listen(&mut source, &mut monitor).await?;
    let snapshot = monitor.snapshot(source.now());
    let is_chosen = |etag: Option<u16>| is_one(&chosen, &monitor, etag);
    let soft =
        snapshot.channels.iter().filter(|channel| channel.latency.is_some() && is_chosen(channel.etag));
    let hard = snapshot.slots.iter().filter(|slot| is_chosen(Some(slot.etag)));
    let latencies = Latencies { soft: soft.collect(), hard: hard.collect() };
    let nothing = latencies.soft.is_empty() && latencies.hard.iter().all(|slot| slot.frames == 0);
    if context.output.json() {
        context.output.whole(&latencies)?;
        return Ok(context.ended(!nothing, NOTHING));
    }
    if !latencies.soft.is_empty() {
        let heads = ["SOFT CHANNEL", "EVENTS", "DEADLINE", "OLDEST", "LEAST LEFT", "AT THE LIMIT"];
        context.output.table(
            &heads,
            &latencies.soft.iter().filter_map(|channel| soft_row(channel)).collect::<Vec<_>>(),
        )?;
    }
    if !latencies.hard.is_empty() {
        if !latencies.soft.is_empty() {
            context.output.line("")?;
        }
        let heads = ["HARD CHANNEL", "NODE", "FRAMES", "DEADLINE", "EARLIEST", "LATEST", "MISSED", "OUTSIDE"];
        let rows: Vec<_> = latencies.hard.iter().map(|slot| slot_row(slot, &monitor)).collect();
        context.output.table(&heads, &rows)?;
    }
    Ok(context.ended(!nothing, NOTHING))
}

fn is_one(chosen: &Chosen, monitor: &Monitor, etag: Option<u16>) -> bool {
    etag.and_then(Etag::new).is_some_and(|etag| chosen.has(monitor, etag))
}

fn soft_row(channel: &ChannelView) -> Option<Vec<Cell>> {
    let latency = channel.latency?;
    let limit = Cell::number(latency.at_the_limit);
    let limit = if latency.at_the_limit > 0 { limit.styled(Style::Warning) } else { limit };
    Some(vec![
        Cell::new(channel.label()),
        Cell::number(latency.frames),
        Cell::or_dash(channel.deadline_ns.map(short)),
        Cell::or_dash(latency.oldest_ns.map(short)),
        Cell::new(signed(latency.least_left_ns)),
        limit,
    ])
}

fn slot_row(slot: &SlotView, monitor: &Monitor) -> Vec<Cell> {
    let alarming = |count: u64| {
        let cell = Cell::number(count);
        if count > 0 { cell.styled(Style::Bad) } else { cell }
    };
    let node = TxNode::new(slot.publisher).and_then(|node| monitor.name_of(node));
    vec![
        Cell::new(slot.name.clone()),
        Cell::new(node.unwrap_or_else(|| format!("{:02X}", slot.publisher))),
        Cell::number(slot.frames),
        Cell::new(short(slot.deadline_ns)),
        Cell::or_dash(slot.earliest_ns.map(signed)),
        Cell::or_dash(slot.latest_ns.map(signed)),
        alarming(slot.missed),
        alarming(slot.outside),
    ]
}

/// Pairs of channel and publisher that are measured.
const MOST: usize = 4096;

const NOTHING: &str = "no such event was heard; `cosmic channels` shows what there is";
