//! `cosmic broker`: a node that hosts the broker of its segment.

use std::process::ExitCode;
use std::time::Duration;

use cosmic_core::can::TxNode;
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::BrokerTables;
use cosmic_plan::cluster;

use super::part::start;
use crate::arguments::{Host, Identity};
use crate::context::Context;
use crate::failure::Failure;
use crate::source::{end_of, sleep_until};

/// `cosmic broker`
pub(super) async fn broker(context: &mut Context, options: &Host) -> Result<ExitCode, Failure> {
    let mut tables = BrokerTables::default();
    if let Some(plan) = &context.plan {
        let cluster = plan.cluster();
        let node = |node: &cluster::Node| Some((NodeUid::new(node.uid)?, node.tx_node));
        tables.nodes = cluster.nodes.iter().filter_map(node).collect();
        let bound = |channel: &cluster::Channel| {
            let etag = channel.etag.filter(|etag| !etag.is_hard())?;
            Some((Subject::new(channel.subject)?, etag))
        };
        tables.subjects = cluster.channels.iter().filter_map(bound).collect();
    }
    let tx_node = options.identity.tx_node.unwrap_or(TxNode::MAX);
    let identity = Identity { tx_node: Some(tx_node), ..options.identity.clone() };
    let node = start(context, &identity, Some(tables)).await?;
    let mut news = node.news();
    let until = end_of(options.span);
    let mut role = None;
    loop {
        let present = node.broker_role();
        if role != present {
            role = present;
            let text = present.map_or("none".to_owned(), |role| format!("{role:?}").to_lowercase());
            say(context, "role", &format!("the broker at TxNode {tx_node} is {text}"))?;
        }
        tokio::select! {
            biased;
            _ = tokio::signal::ctrl_c() => break,
            () = sleep_until(until) => break,
            told = news.recv() => if let Ok(told) = told { tell(context, told)? },
            () = tokio::time::sleep(ROLE) => {}
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn tell(context: &mut Context, news: cosmic_core::services::News) -> Result<(), Failure> {
    use cosmic_core::broker::BrokerEvent;
    use cosmic_core::services::News;
    let News::Broker(event) = news else { return Ok(()) };
    let (kind, text) = match event {
        BrokerEvent::Assigned { uid, tx_node } => ("assigned", format!("node {uid} has TxNode {tx_node}")),
        BrokerEvent::Bound { subject, etag } => {
            ("bound", format!("subject {subject} has etag {}", etag.get()))
        }
        BrokerEvent::NoIdLeft(uid) => ("refused", format!("no TxNode is left for node {uid}")),
        BrokerEvent::NoEtagLeft(subject) => ("refused", format!("no etag is left for subject {subject}")),
        BrokerEvent::Admitted { tx_node, etag } => {
            ("admitted", format!("node {tx_node} publishes etag {}, which is not in the plan", etag.get()))
        }
        BrokerEvent::NotAdmitted { tx_node, etag, why } => {
            ("not-admitted", format!("node {tx_node} may not publish etag {}: {why}", etag.get()))
        }
        BrokerEvent::ForeignBroker => (
            "foreign-broker",
            "another broker answers that does not say who it is: switch one of them off".to_owned(),
        ),
        _ => return Ok(()),
    };
    say(context, kind, &text)
}

fn say(context: &mut Context, kind: &str, text: &str) -> Result<(), Failure> {
    if context.output.json() {
        context.output.value(&serde_json::json!({ "event": kind, "text": text }))?;
    } else {
        context.output.line(text)?;
    }
    context.output.flush()
}

/// How often the role of the broker is looked at.
const ROLE: Duration = Duration::from_millis(50);
