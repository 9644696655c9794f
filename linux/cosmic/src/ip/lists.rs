//! `cosmic nodes` and `cosmic channels` across IP.

use std::collections::BTreeMap;
use std::process::ExitCode;

use cosmic_gateway::ip::Participant;
use serde::Serialize;

use super::Crossing;
use super::flows::{Flow, Flows};
use crate::arguments::Listen;
use crate::choice::Endpoint;
use crate::context::Context;
use crate::failure::Failure;
use crate::output::{Cell, short};

/// All that crosses within a span, and who speaks.
pub(super) async fn heard(
    context: &Context,
    at: &Endpoint,
    subjects: Option<&[cosmic_core::Subject]>,
    options: &Listen,
) -> Result<(Flows, Vec<Participant>, u64), Failure> {
    let mut crossing = Crossing::listen(context, at, subjects, Some(options.span)).await?;
    let mut flows = Flows::default();
    while let Some(heard) = crossing.next().await {
        let at_ns = crossing.since_start(heard.received_at);
        flows.add(context.plan.as_ref(), &heard, at_ns);
    }
    if flows.overlooked > 0 {
        eprintln!("cosmic: {} events of further publishers are not shown", flows.overlooked);
    }
    let (participants, now) =
        (crossing.listener.participants(), crossing.since_start(crossing.listener.now()));
    crossing.end().await;
    Ok((flows, participants, now))
}

#[derive(Serialize, Debug)]
struct NodeSeen {
    segment: String,
    tx_node: Option<u8>,
    channels: usize,
    events: u64,
    missing: u64,
    /// Nanoseconds since the last event.
    silent_ns: Option<u64>,
    /// Somebody speaks for the segment now.
    spoken_for: bool,
    /// How much more than the age of its events may be told.
    uncertainty_ns: Option<u64>,
}

/// `cosmic nodes`
pub(super) async fn nodes(
    context: &mut Context,
    at: &Endpoint,
    options: &Listen,
) -> Result<ExitCode, Failure> {
    let (flows, participants, now_ns) = heard(context, at, None, options).await?;
    let nodes = nodes_of(&flows, &participants, now_ns);
    if context.output.json() {
        context.output.whole(&nodes)?;
    } else if !nodes.is_empty() {
        let heads = ["SEGMENT", "NODE", "CHANNELS", "EVENTS", "MISSING", "HEARD", "SPEAKS", "CLOCK TO"];
        context.output.table(&heads, &nodes.iter().map(node_row).collect::<Vec<_>>())?;
    }
    Ok(context.ended(!nodes.is_empty(), "nobody speaks for any segment on this network; look at --network"))
}

fn nodes_of(flows: &Flows, participants: &[Participant], now_ns: u64) -> Vec<NodeSeen> {
    let mut nodes: BTreeMap<(String, Option<u8>), NodeSeen> = BTreeMap::new();
    let of = |segment: &str| participants.iter().find(|it| it.segment.as_str() == segment);
    let nothing = |segment: String, tx_node| NodeSeen {
        spoken_for: of(&segment).is_some(),
        uncertainty_ns: of(&segment).and_then(|it| it.uncertainty).map(|span| span.as_ticks()),
        segment,
        tx_node,
        channels: 0,
        events: 0,
        missing: 0,
        silent_ns: None,
    };
    for flow in flows.iter() {
        let (segment, tx_node) = (flow.last.segment.clone(), flow.last.tx_node);
        let node = nodes.entry((segment.clone(), tx_node)).or_insert_with(|| nothing(segment, tx_node));
        node.channels += 1;
        node.events += flow.distances.events;
        node.missing += flow.missing;
        let silent = now_ns.saturating_sub(flow.last.at_ns);
        node.silent_ns = Some(node.silent_ns.map_or(silent, |before| before.min(silent)));
    }
    for participant in participants {
        let segment = participant.segment.to_string();
        if !nodes.keys().any(|(known, _)| *known == segment) {
            nodes.insert((segment.clone(), None), nothing(segment, None));
        }
    }
    nodes.into_values().collect()
}

fn node_row(node: &NodeSeen) -> Vec<Cell> {
    vec![
        Cell::new(node.segment.clone()),
        Cell::or_dash(node.tx_node.map(|node| format!("{node:02X}"))),
        Cell::number(node.channels),
        Cell::number(node.events),
        Cell::number(node.missing),
        Cell::or_dash(node.silent_ns.map(|silent| format!("{} ago", short(silent)))),
        Cell::new(if node.spoken_for { "yes" } else { "no" }),
        Cell::or_dash(node.uncertainty_ns.map(short)),
    ]
}

#[derive(Serialize, Debug)]
struct ChannelSeen<'a> {
    channel: &'a str,
    subject: &'a str,
    class: &'a str,
    rate: f64,
    publishers: Vec<String>,
    least_left_ns: Option<i64>,
    last: String,
}

/// `cosmic channels`
pub(super) async fn channels(
    context: &mut Context,
    at: &Endpoint,
    options: &Listen,
) -> Result<ExitCode, Failure> {
    let (flows, _, now_ns) = heard(context, at, None, options).await?;
    let by_channel = flows.by_channel();
    let channels: Vec<_> = by_channel.iter().filter_map(|flows| channel(flows, now_ns)).collect();
    if context.output.json() {
        context.output.whole(&channels)?;
    } else if !channels.is_empty() {
        let heads = ["SUBJECT", "CHANNEL", "CLASS", "EVENTS/S", "PUBLISHERS", "LEFT AT LEAST", "LAST"];
        context.output.table(&heads, &channels.iter().map(channel_row).collect::<Vec<_>>())?;
    }
    Ok(context
        .ended(!channels.is_empty(), "no event has crossed; `cosmic nodes` across IP shows who is there"))
}

fn channel<'a>(flows: &[&'a Flow], now_ns: u64) -> Option<ChannelSeen<'a>> {
    let newest = flows.iter().max_by_key(|flow| flow.last.at_ns)?;
    let events: u64 = flows.iter().map(|flow| flow.distances.events).sum();
    Some(ChannelSeen {
        channel: newest.last.label(),
        subject: &newest.last.subject,
        class: newest.last.class,
        rate: events as f64 * 1e9 / now_ns.max(1) as f64,
        publishers: flows.iter().map(|flow| flow.last.place()).collect(),
        least_left_ns: flows.iter().filter_map(|flow| flow.least_left_ns).min(),
        last: newest.last.said(),
    })
}

fn channel_row(channel: &ChannelSeen<'_>) -> Vec<Cell> {
    vec![
        Cell::new(channel.subject),
        Cell::new(channel.channel),
        Cell::new(channel.class),
        Cell::number(format!("{:.1}", channel.rate)),
        Cell::new(channel.publishers.join(", ")),
        Cell::or_dash(channel.least_left_ns.map(crate::output::signed)),
        Cell::new(channel.last.clone()),
    ]
}
