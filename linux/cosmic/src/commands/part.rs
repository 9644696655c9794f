//! Commands that take part as a node: `sub`, `pub`, `broker`.

use std::process::ExitCode;
use std::time::Duration;

use cosmic_core::can::{Etag, Payload, TxNode};
use cosmic_core::event_layer::{
    Attributes, Channel, Content, Delivered, Depth, Importance, NonRealTimeAttributes, Policy, SoftAttributes,
};
use cosmic_core::time;
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::{BrokerTables, Node, drawn_uid};
use cosmic_monitor::{DecodedField, SegmentPlan};
use cosmic_plan::cluster;
use cosmic_session::node_config;
use serde::Serialize;
use tokio::sync::mpsc;

use crate::arguments::{Class, Host, Identity, Publish, Subscribe, subject};
use crate::context::Context;
use crate::failure::{FOUND, Failure};
use crate::output::Style;
use crate::source::{end_of, link, sleep_until, std_span};

/// Starts a node, when the link is there.
pub(super) async fn start(
    context: &Context,
    identity: &Identity,
    broker: Option<BrokerTables>,
) -> Result<Node, Failure> {
    let (choice, bit_rate) = (context.link()?.clone(), context.bit_rate());
    // A node goes on trying and does not say why; so the link is tried first.
    let mut trial = crate::source::Source::open(&choice, bit_rate)?;
    trial.connected(std_span(identity.patience)).await?;
    drop(trial);
    let uid = identity.uid.unwrap_or_else(drawn_uid);
    let mut config = node_config(uid, context.plan.as_ref(), bit_rate);
    config.node.tx_node = identity.tx_node.or(config.node.tx_node);
    config.broker = broker;
    let node = Node::start(config, link(&choice, bit_rate)?);
    let node = node.map_err(|error| Failure::input(error.to_string()))?;
    let connected = tokio::time::timeout(std_span(identity.patience), node.connected()).await;
    connected.map_err(|_| Failure::link("the link does not answer; look at the option --link"))?;
    Ok(node)
}

/// The channel of this name, with the quality that the plan or else `given` and `etag` say.
fn channel(
    plan: Option<&SegmentPlan>,
    name: &str,
    etag: Option<Etag>,
    given: impl FnOnce(Subject) -> Channel<Payload>,
) -> Result<(Channel<Payload>, Option<usize>), Failure> {
    let named = plan.and_then(|plan| plan.channel_named(name));
    let by_subject = || plan?.channel_of_subject(subject(name)?);
    if let Some((plan, at)) = plan.zip(named.or_else(by_subject)) {
        if etag.is_some() {
            return Err(Failure::input(format!("the cluster file describes {name}: leave out --etag")));
        }
        let wrong = || {
            Failure::input(format!(
                "the cluster file contradicts itself about {name}: check it by cosmic-plan"
            ))
        };
        return plan.declare(at).map(|channel| (channel, Some(at))).ok_or_else(wrong);
    }
    let remedy = if plan.is_some() { "a name of the cluster file" } else { "a cluster file by --cluster" };
    let subject = subject(name);
    let subject = subject.ok_or_else(|| {
        Failure::input(format!("there is no channel {name:?}: give {remedy}, or the 16 digits of a subject"))
    })?;
    let channel = given(subject);
    Ok((etag.map_or(channel, |etag| channel.with_etag(etag)), None))
}

/// The channel of this name; a soft real-time one if no plan says what it is.
pub(super) fn soft_channel(
    plan: Option<&SegmentPlan>,
    name: &str,
) -> Result<(Channel<Payload>, Option<usize>), Failure> {
    channel(plan, name, None, |subject| soft(subject, DEADLINE, 4 * DEADLINE))
}

/// Waits until a node has its names, or says who did not give them.
pub(super) async fn named<F: Future>(identity: &Identity, names: F) -> Result<F::Output, Failure> {
    tokio::time::timeout(std_span(identity.patience), names).await.map_err(|_| {
        let patience = cosmic_plan::units::show(identity.patience);
        Failure::link(format!(
            "no broker has answered within {patience}: start one (`cosmic broker`), or give --tx-node and a cluster file \
             with fixed etags"
        ))
    })
}

/// An event for machines.
#[derive(Serialize)]
struct Line<'a> {
    at_ns: u64,
    channel: &'a str,
    publisher: u8,
    node: Option<String>,
    data: String,
    fields: Vec<DecodedField>,
}

/// `cosmic sub`
pub(super) async fn subscribe(context: &mut Context, options: &Subscribe) -> Result<ExitCode, Failure> {
    let given = |subject| soft(subject, DEADLINE, DEADLINE);
    let (channel, at) = channel(context.plan.as_ref(), &options.channel, options.etag, given)?;
    let node = start(context, &options.identity, None).await?;
    let mut events = events_of(&node, &channel, context.plan.as_ref().zip(at))?;
    named(&options.identity, node.configured()).await?;
    let until = end_of(options.span);
    let (mut printed, began) = (0, node.now());
    while options.count.is_none_or(|count| printed < count) {
        let event = tokio::select! {
            biased;
            _ = tokio::signal::ctrl_c() => break,
            () = sleep_until(until) => break,
            event = events.recv() => match event {
                Some(event) => event,
                None => break,
            },
        };
        print(context, &options.channel, at, &event, began)?;
        printed += 1;
    }
    if printed == 0 && !context.output.json() {
        eprintln!("cosmic: no event has come; `cosmic channels` shows who publishes");
    }
    Ok(if printed > 0 { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}

/// The events of a channel, as they come. One of hard real-time has a slot for so many bytes as its content has, so the
/// type of its content is as long.
fn events_of(
    node: &Node,
    channel: &Channel<Payload>,
    planned: Option<(&SegmentPlan, usize)>,
) -> Result<mpsc::Receiver<Delivered<Payload>>, Failure> {
    let Attributes::Hard(attributes) = channel.attributes() else { return forward(node, channel) };
    let planned = planned.map(|(plan, at)| plan.channel(at));
    let etag = planned.and_then(|planned| planned.etag);
    let etag = etag.ok_or_else(|| {
        Failure::input("a hard real-time channel needs a cluster file: give it by --cluster")
    })?;
    macro_rules! of_length {
        ($($len:literal)*) => {
            match planned.map_or(8, |planned| planned.length) {
                $($len => forward(node, &Channel::<[u8; $len]>::hard(channel.subject(), etag, attributes)),)*
                _ => forward(node, channel),
            }
        };
    }
    of_length!(0 1 2 3 4 5 6 7 8)
}

fn forward<C: Content + Send + 'static>(
    node: &Node,
    channel: &Channel<C>,
) -> Result<mpsc::Receiver<Delivered<Payload>>, Failure> {
    let policy = Depth::new(QUEUE).map_or(Policy::Latest, Policy::Fifo);
    let subscriber = node.subscribe(channel, policy).map_err(|error| Failure::input(error.to_string()))?;
    let (sender, receiver) = mpsc::channel(usize::from(QUEUE));
    tokio::spawn(async move {
        loop {
            let event = subscriber.next().await;
            let mut bytes = [0; Payload::MAX_LEN];
            event.content.encode(bytes.get_mut(..C::LEN).unwrap_or_default());
            let content = Payload::truncated(bytes, event.content.encoded_len());
            let Delivered { context, publisher, id, received_at, .. } = event;
            if sender.send(Delivered { content, context, publisher, id, received_at }).await.is_err() {
                return;
            }
        }
    });
    Ok(receiver)
}

fn print(
    context: &mut Context,
    channel: &str,
    at: Option<usize>,
    event: &Delivered<Payload>,
    began: time::Instant,
) -> Result<(), Failure> {
    let at_ns = event.received_at.saturating_since(began).as_ticks();
    let plan = context.plan.as_ref();
    let decoded = plan.zip(at).map(|(plan, at)| plan.decode(at, event.content.as_slice()));
    let node = plan.and_then(|plan| plan.node(event.publisher)).map(|node| node.name.clone());
    if context.output.json() {
        let (publisher, data) = (event.publisher.get(), event.content.to_string());
        let fields = decoded.and_then(Result::ok).unwrap_or_default();
        return context.output.value(&Line { at_ns, channel, publisher, node, data, fields });
    }
    let content = match decoded {
        Some(Ok(fields)) if !fields.is_empty() => {
            fields.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
        }
        Some(Err(why)) => format!("{} (malformed: {why})", event.content),
        _ => event.content.to_string(),
    };
    let node = node.unwrap_or_else(|| format!("node {}", event.publisher));
    let at = context.output.styled(&format!("{:12.6}", at_ns as f64 / 1e9), Style::Dim);
    context.output.line(&format!("{at}  {node:<12} {channel} {content}"))?;
    context.output.flush()
}

fn soft(subject: Subject, deadline: time::Duration, validity: time::Duration) -> Channel<Payload> {
    let deadline = deadline.max(time::Duration::from_ticks(1));
    Channel::soft(subject, SoftAttributes { deadline, validity: validity.max(deadline) })
}

/// `cosmic pub`
pub(super) async fn publish(context: &mut Context, options: &Publish) -> Result<ExitCode, Failure> {
    let given = |subject| match options.class {
        Class::Srt => {
            let deadline = options.deadline.unwrap_or(DEADLINE);
            soft(subject, deadline, options.validity.unwrap_or(4 * deadline))
        }
        Class::Nrt => {
            let attributes =
                NonRealTimeAttributes { importance: Importance::LEAST, validity: options.validity };
            Channel::non_real_time(subject, attributes)
        }
    };
    let (channel, at) = channel(context.plan.as_ref(), &options.channel, options.etag, given)?;
    let content = content(context.plan.as_ref().zip(at), &options.content)?;
    let node = start(context, &options.identity, None).await?;
    let publisher = node.announce(&channel).map_err(|error| Failure::input(error.to_string()))?;
    named(&options.identity, publisher.bound()).await?;
    let mut published = 0;
    while published < options.count {
        if published > 0 {
            tokio::select! {
                () = tokio::time::sleep(std_span(options.every)) => {}
                _ = tokio::signal::ctrl_c() => break,
            }
        }
        let mut event = cosmic_core::event_layer::Event::new(content);
        event.deadline = options.deadline.map(|deadline| node.now() + deadline);
        event.expires_at = options.validity.map(|validity| node.now() + validity);
        publisher.publish_event(&event).map_err(|error| Failure::input(error.to_string()))?;
        published += 1;
    }
    concluded(&node, channel.subject()).await;
    let counters = node.channel_counters(channel.subject()).unwrap_or_default();
    if context.output.json() {
        let told = serde_json::json!({ "published": counters.published, "sent": counters.sent,
            "expired": counters.discarded });
        context.output.value(&told)?;
    } else {
        eprintln!(
            "cosmic: {} published, {} sent, {} expired",
            counters.published, counters.sent, counters.discarded
        );
    }
    Ok(if u64::from(counters.sent) == options.count { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}

/// Waits until all that was published was sent or has expired.
pub(super) async fn concluded(node: &Node, subject: Subject) {
    let until = tokio::time::Instant::now() + LONGEST_WAIT;
    loop {
        let counters = node.channel_counters(subject).unwrap_or_default();
        if counters.published == counters.sent + counters.discarded || tokio::time::Instant::now() >= until {
            return;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// The bytes of `field=value` for each field, or of hexadecimal digits.
pub(super) fn content(planned: Option<(&SegmentPlan, usize)>, words: &[String]) -> Result<Payload, Failure> {
    let pairs: Option<Vec<(&str, &str)>> = words.iter().map(|word| word.split_once('=')).collect();
    let bytes = match pairs.filter(|pairs| !pairs.is_empty()) {
        Some(pairs) => {
            let layout = planned.and_then(|(plan, at)| plan.cluster().layout_of(plan.channel(at)));
            let layout = layout.ok_or_else(|| {
                Failure::input(
                    "no cluster file describes the fields of this channel: give one by --cluster, or the bytes in \
                     hexadecimal digits",
                )
            })?;
            layout
                .encode_text(&pairs)
                .map_err(|why| Failure::input(format!("this is no {}: {why}", layout.name)))?
        }
        None => cosmic_log::bytes_of(&words.concat()).ok_or_else(|| {
            Failure::input(
                "the content is no bytes: write field=value for each field, or up to 16 hexadecimal digits",
            )
        })?,
    };
    Payload::new(&bytes).ok_or_else(|| {
        Failure::input(format!(
            "the content has {} bytes; this command publishes events of up to eight",
            bytes.len()
        ))
    })
}

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

/// Events that wait to be printed.
const QUEUE: u8 = 254;
/// Of a soft real-time channel that no file describes.
const DEADLINE: time::Duration = time::Duration::from_millis(20);
/// Until what was published last must have been sent.
const LONGEST_WAIT: Duration = Duration::from_secs(2);
/// How often the role of the broker is looked at.
const ROLE: Duration = Duration::from_millis(50);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contents_are_bytes_or_fields() {
        let words = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        assert_eq!(content(None, &words(&["0A0B", "ff"])).ok(), Payload::new(&[0x0A, 0x0B, 0xFF]));
        assert_eq!(content(None, &[]).ok(), Some(Payload::EMPTY));
        for wrong in [&["1"][..], &["zz"], &["001122334455667788"], &["speed=1"]] {
            assert!(content(None, &words(wrong)).is_err(), "{wrong:?}");
        }
    }
}
