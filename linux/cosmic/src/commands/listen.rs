//! Commands that listen for a while and then say what is there: `nodes`, `channels`, `doctor`.

use std::process::ExitCode;

use cosmic_monitor::{ChannelView, Finding, NodeView, Severity, Snapshot};

use super::listen;
use crate::arguments::Listen;
use crate::context::Context;
use crate::failure::{FOUND, Failure};
use crate::output::{Cell, Style, short};
use crate::words::{last, role};

async fn heard(context: &Context, options: &Listen) -> Result<(Snapshot, Vec<Finding>), Failure> {
    let mut source = context.source(Some(options.span)).await?;
    let mut monitor = context.monitor(source.now());
    listen(&mut source, &mut monitor).await?;
    let now = source.now();
    let findings = monitor.doctor(now);
    Ok((monitor.snapshot(now), findings))
}

/// `cosmic nodes`
pub(super) async fn nodes(context: &mut Context, options: &Listen) -> Result<ExitCode, Failure> {
    let (snapshot, _) = heard(context, options).await?;
    if context.output.json() {
        context.output.whole(&snapshot.nodes)?;
    } else if !snapshot.nodes.is_empty() {
        let heads =
            ["NODE", "NAME", "UID", "STATE", "ROLE", "UP", "TEC", "REC", "EXCEPTIONS", "FRAMES/S", "HEARD"];
        let rows: Vec<_> = snapshot.nodes.iter().map(node_row).collect();
        context.output.table(&heads, &rows)?;
    }
    Ok(context
        .ended(snapshot.nodes.iter().any(|node| node.alive), "no node was heard; `cosmic doctor` says why"))
}

fn node_row(node: &NodeView) -> Vec<Cell> {
    let state = match (node.alive, node.state) {
        (false, _) => Cell::new("silent").styled(Style::Bad),
        (true, Some("operational")) => Cell::new("operational").styled(Style::Good),
        (true, Some(state)) => Cell::new(state).styled(Style::Warning),
        (true, None) => Cell::new("alive"),
    };
    let exceptions = Cell::number(node.exceptions);
    let exceptions = if node.exceptions > 0 { exceptions.styled(Style::Warning) } else { exceptions };
    vec![
        Cell::new(format!("{:02X}", node.tx_node)),
        Cell::or_dash(node.name.clone()),
        Cell::or_dash(node.uid.clone()),
        state,
        Cell::or_dash(role(node)),
        Cell::or_dash(node.uptime_s.map(|uptime| format!("{uptime} s"))),
        Cell::or_dash(node.transmit_errors.map(|errors| errors.to_string())),
        Cell::or_dash(node.receive_errors.map(|errors| errors.to_string())),
        exceptions,
        Cell::number(format!("{:.0}", node.frames_per_second)),
        Cell::or_dash(node.silent_ns.map(|silent| format!("{} ago", short(silent)))),
    ]
}

/// `cosmic channels`
pub(super) async fn channels(context: &mut Context, options: &Listen) -> Result<ExitCode, Failure> {
    let (snapshot, _) = heard(context, options).await?;
    if context.output.json() {
        context.output.whole(&snapshot.channels)?;
    } else if !snapshot.channels.is_empty() {
        let heads = ["ETAG", "CHANNEL", "CLASS", "EVENTS/S", "PUBLISHERS", "SUBSCRIBERS", "LAST"];
        let rows: Vec<_> = snapshot.channels.iter().map(channel_row).collect();
        context.output.table(&heads, &rows)?;
    }
    let any = snapshot.channels.iter().any(is_heard_of);
    Ok(context.ended(any, "nothing was heard of any channel; `cosmic doctor` says why"))
}

fn is_heard_of(channel: &ChannelView) -> bool {
    let announced = channel.publishers.iter().any(|publisher| publisher.lease_ns.is_some());
    channel.frames > 0
        || announced
        || channel.subscribers.iter().any(|subscriber| subscriber.lease_ns.is_some())
}

fn channel_row(channel: &ChannelView) -> Vec<Cell> {
    let who = |tx_node: u8, name: &Option<String>, lease: Option<u64>| {
        let name = name.clone().unwrap_or_else(|| format!("{tx_node:02X}"));
        lease.map_or(name.clone(), |lease| format!("{name} ({:.0} s)", lease as f64 / 1e9))
    };
    let publishers = channel.publishers.iter().map(|publisher| {
        let seen = publisher.frames > 0 || publisher.lease_ns.is_some();
        let name = who(publisher.tx_node, &publisher.name, publisher.lease_ns);
        if seen { name } else { format!("{name}?") }
    });
    let subscribers = channel.subscribers.iter().map(|subscriber| {
        let name = who(subscriber.tx_node, &subscriber.name, subscriber.lease_ns);
        if subscriber.lease_ns.is_some() { name } else { format!("{name}?") }
    });
    let list = |names: Vec<String>| (!names.is_empty()).then(|| names.join(", "));
    vec![
        Cell::or_dash(channel.etag.map(|etag| etag.to_string())),
        Cell::new(channel.label()),
        Cell::or_dash(channel.class.map(|class| class.abbreviation())),
        Cell::number(format!("{:.1}", channel.rate)),
        Cell::or_dash(list(publishers.collect())),
        Cell::or_dash(list(subscribers.collect())),
        Cell::or_dash(last(channel)),
    ]
}

/// `cosmic doctor`
pub(super) async fn doctor(context: &mut Context, options: &Listen) -> Result<ExitCode, Failure> {
    let (snapshot, findings) = heard(context, options).await?;
    let failed = findings.iter().any(|finding| finding.severity == Severity::Error);
    if context.output.json() {
        context.output.whole(&findings)?;
    } else {
        for finding in &findings {
            print(context, finding)?;
        }
        let seen = format!(
            "{} frames of {} nodes on {} channels in {}",
            snapshot.link.received,
            snapshot.nodes.iter().filter(|node| node.alive).count(),
            snapshot.channels.iter().filter(|channel| channel.frames > 0).count(),
            short(snapshot.listening_ns)
        );
        let verdict = match findings.len() {
            0 => format!("nothing is wrong: {seen}"),
            1 => format!("1 finding: {seen}"),
            count => format!("{count} findings: {seen}"),
        };
        context.output.line(&verdict)?;
    }
    Ok(if failed { ExitCode::from(FOUND) } else { ExitCode::SUCCESS })
}

fn print(context: &mut Context, finding: &Finding) -> Result<(), Failure> {
    let (word, style) = match finding.severity {
        Severity::Error => ("error", Style::Bad),
        Severity::Warning => ("warning", Style::Warning),
    };
    let word = context.output.styled(word, style);
    context.output.line(&format!("{word}: {finding}"))?;
    let remedy = context.output.styled(&format!("  {}", finding.remedy), Style::Dim);
    context.output.line(&remedy)
}
