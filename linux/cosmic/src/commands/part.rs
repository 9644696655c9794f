//! Commands that take part as a node: `sub`, `pub`.

use std::process::ExitCode;
use std::time::Duration;

use cosmic_core::Subject;
use cosmic_core::can::{Etag, Payload};
use cosmic_core::event_layer::{
    Bytes, Channel, Delivered, Depth, Importance, NonRealTimeAttributes, Policy, SoftAttributes,
};
use cosmic_core::time;
use cosmic_linux::{BrokerTables, Node, drawn_uid};
use cosmic_monitor::{ByteMessages, DecodedField, SegmentPlan, hex_text};
use cosmic_session::{Declared, Events, LONGEST_MESSAGE, node_config};
use serde::Serialize;

use crate::arguments::{Class, Identity, Publish, Subscribe, subject};
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
    given: impl FnOnce(Subject) -> Declared,
) -> Result<(Declared, Option<usize>), Failure> {
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
        return Declared::by_plan(plan, at).map(|channel| (channel, Some(at))).ok_or_else(wrong);
    }
    let remedy = if plan.is_some() { "a name of the cluster file" } else { "a cluster file by --cluster" };
    let subject = subject(name);
    let subject = subject.ok_or_else(|| {
        Failure::input(format!("there is no channel {name:?}: give {remedy}, or the 16 digits of a subject"))
    })?;
    let channel = given(subject);
    Ok((etag.map_or(channel, |etag| channel.with_etag(etag)), None))
}

/// The channel of events of this name; a soft real-time one if no plan says what it is.
pub(super) fn soft_channel(
    plan: Option<&SegmentPlan>,
    name: &str,
) -> Result<(Channel<Payload>, Option<usize>), Failure> {
    match channel(plan, name, None, |subject| soft(subject, DEADLINE, 4 * DEADLINE))? {
        (Declared::Events(channel), at) => Ok((channel, at)),
        (Declared::Messages(_), _) => Err(Failure::input(format!(
            "{name} carries messages of several frames, which `cosmic pub` publishes, and this does not"
        ))),
    }
}

/// The channel that is to be subscribed to.
pub(crate) fn subscribed(
    plan: Option<&SegmentPlan>,
    options: &Subscribe,
) -> Result<(Declared, Option<usize>), Failure> {
    let given = |subject| {
        if options.messages { messages(subject, None) } else { soft(subject, DEADLINE, DEADLINE) }
    };
    channel(plan, &options.channel, options.etag, given)
}

/// The channel that is to be published on.
pub(crate) fn published(
    plan: Option<&SegmentPlan>,
    options: &Publish,
) -> Result<(Declared, Option<usize>), Failure> {
    channel(plan, &options.channel, options.etag, |subject| match options.class {
        _ if options.messages => messages(subject, options.validity),
        Class::Srt => {
            let deadline = options.deadline.unwrap_or(DEADLINE);
            soft(subject, deadline, options.validity.unwrap_or(4 * deadline))
        }
        Class::Nrt => Declared::Events(Channel::non_real_time(subject, least(options.validity))),
    })
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
    let (channel, at) = subscribed(context.plan.as_ref(), options)?;
    let node = start(context, &options.identity, None).await?;
    let policy = Depth::new(QUEUE).map_or(Policy::Latest, Policy::Fifo);
    let events = Events::of(&node, &channel, policy).map_err(|error| Failure::input(error.to_string()))?;
    named(&options.identity, node.configured()).await?;
    let until = end_of(options.span);
    let (mut printed, began) = (0, node.now());
    while options.count.is_none_or(|count| printed < count) {
        let event = tokio::select! {
            biased;
            _ = tokio::signal::ctrl_c() => break,
            () = sleep_until(until) => break,
            event = events.next() => event,
        };
        print(context, &options.channel, at, &event, began)?;
        printed += 1;
    }
    Ok(context.ended(printed > 0, "no event has come; `cosmic channels` shows who publishes"))
}

fn print(
    context: &mut Context,
    channel: &str,
    at: Option<usize>,
    event: &Delivered<Vec<u8>>,
    began: time::Instant,
) -> Result<(), Failure> {
    let at_ns = event.received_at.saturating_since(began).as_ticks();
    let plan = context.plan.as_ref();
    let decoded = plan.zip(at).map(|(plan, at)| plan.decode(at, &event.content));
    let node = plan.and_then(|plan| plan.node(event.publisher)).map(|node| node.name.clone());
    let data = hex_text(&event.content);
    if context.output.json() {
        let publisher = event.publisher.get();
        let fields = decoded.and_then(Result::ok).unwrap_or_default();
        return context.output.value(&Line { at_ns, channel, publisher, node, data, fields });
    }
    let content = match decoded {
        Some(Ok(fields)) if !fields.is_empty() => {
            fields.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
        }
        Some(Err(why)) => format!("{data} (malformed: {why})"),
        _ => data,
    };
    let node = node.unwrap_or_else(|| format!("node {}", event.publisher));
    let at = context.output.styled(&format!("{:12.6}", at_ns as f64 / 1e9), Style::Dim);
    context.output.line(&format!("{at}  {node:<12} {channel} {content}"))?;
    context.output.flush()
}

fn soft(subject: Subject, deadline: time::Duration, validity: time::Duration) -> Declared {
    let deadline = deadline.max(time::Duration::from_ticks(1));
    Declared::Events(Channel::soft(subject, SoftAttributes { deadline, validity: validity.max(deadline) }))
}

fn messages(subject: Subject, validity: Option<time::Duration>) -> Declared {
    Declared::Messages(ByteMessages::new(subject, least(validity)))
}

const fn least(validity: Option<time::Duration>) -> NonRealTimeAttributes {
    NonRealTimeAttributes { importance: Importance::LEAST, validity }
}

/// `cosmic pub`
pub(super) async fn publish(context: &mut Context, options: &Publish) -> Result<ExitCode, Failure> {
    let (channel, at) = published(context.plan.as_ref(), options)?;
    let content = content(context.plan.as_ref().zip(at), &options.content)?;
    let [published, sent, expired] = match channel {
        Declared::Events(channel) => publish_events(context, options, &channel, event_of(&content)?).await?,
        Declared::Messages(channel) => publish_messages(context, options, &channel, &content).await?,
    };
    if context.output.json() {
        let told = serde_json::json!({ "published": published, "sent": sent, "expired": expired });
        context.output.value(&told)?;
    } else {
        eprintln!("cosmic: {published} published, {sent} sent, {expired} expired");
    }
    Ok(if sent == options.count { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}

/// How many were published, sent, and expired.
async fn publish_events(
    context: &Context,
    options: &Publish,
    channel: &Channel<Payload>,
    content: Payload,
) -> Result<[u64; 3], Failure> {
    let node = start(context, &options.identity, None).await?;
    let publisher = node.announce(channel).map_err(|error| Failure::input(error.to_string()))?;
    named(&options.identity, publisher.bound()).await?;
    let mut published = 0;
    while published < options.count && goes_on(published, options).await {
        let mut event = cosmic_core::event_layer::Event::new(content);
        event.deadline = options.deadline.map(|deadline| node.now() + deadline);
        event.expires_at = options.validity.map(|validity| node.now() + validity);
        publisher.publish_event(&event).map_err(|error| Failure::input(error.to_string()))?;
        published += 1;
    }
    concluded(&node, channel.subject()).await;
    let counters = node.channel_counters(channel.subject()).unwrap_or_default();
    Ok([counters.published, counters.sent, counters.discarded].map(u64::from))
}

async fn publish_messages(
    context: &Context,
    options: &Publish,
    channel: &ByteMessages,
    content: &[u8],
) -> Result<[u64; 3], Failure> {
    let content = message_of(content, options)?;
    let node = start(context, &options.identity, None).await?;
    let publisher = node.announce_messages(channel).map_err(|error| Failure::input(error.to_string()))?;
    named(&options.identity, publisher.bound()).await?;
    let mut published = 0;
    while published < options.count && goes_on(published, options).await {
        let taken = publisher.publish_within(&content, options.validity);
        taken.map_err(|error| Failure::input(error.to_string()))?;
        published += 1;
        if !within_longest_wait(|| publisher.is_idle()).await {
            break;
        }
    }
    let expired = u64::from(publisher.discarded());
    let unsent = expired + u64::from(!publisher.is_idle());
    Ok([published, published - unsent, expired])
}

/// Waits for the time of the next event, if there was one before. `false`: the user has had enough.
pub(crate) async fn goes_on(published: u64, options: &Publish) -> bool {
    if published == 0 {
        return true;
    }
    tokio::select! {
        () = tokio::time::sleep(std_span(options.every)) => true,
        _ = tokio::signal::ctrl_c() => false,
    }
}

/// Waits until all that was published was sent or has expired.
pub(super) async fn concluded(node: &Node, subject: Subject) {
    within_longest_wait(|| {
        let counters = node.channel_counters(subject).unwrap_or_default();
        counters.published == counters.sent + counters.discarded
    })
    .await;
}

/// Waits until it holds, but not for ever. Returns whether it does.
async fn within_longest_wait(holds: impl Fn() -> bool) -> bool {
    let until = tokio::time::Instant::now() + LONGEST_WAIT;
    loop {
        if holds() {
            return true;
        }
        if tokio::time::Instant::now() >= until {
            return false;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// The bytes of `field=value` for each field, or of hexadecimal digits.
pub(crate) fn content(planned: Option<(&SegmentPlan, usize)>, words: &[String]) -> Result<Vec<u8>, Failure> {
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
        None => bytes_of(&words.concat()).ok_or_else(|| {
            Failure::input(
                "the content is no bytes: write field=value for each field, or pairs of hexadecimal digits",
            )
        })?,
    };
    Ok(bytes)
}

/// The content of an event of one frame.
pub(crate) fn event_of(bytes: &[u8]) -> Result<Payload, Failure> {
    Payload::new(bytes).ok_or_else(|| {
        Failure::input(format!(
            "the content has {} bytes; an event has up to eight, a message more: on a channel of messages (--messages)",
            bytes.len()
        ))
    })
}

/// The content of a message.
pub(crate) fn message_of(bytes: &[u8], options: &Publish) -> Result<Bytes<LONGEST_MESSAGE>, Failure> {
    if options.deadline.is_some() {
        return Err(Failure::input("a message is non real-time: leave out --deadline"));
    }
    Bytes::new(bytes).ok_or_else(|| {
        let len = bytes.len();
        Failure::input(format!("the content has {len} bytes; a message has up to {LONGEST_MESSAGE}"))
    })
}

/// Bytes in pairs of hexadecimal digits.
fn bytes_of(text: &str) -> Option<Vec<u8>> {
    let is_hexadecimal = text.len().is_multiple_of(2) && text.bytes().all(|digit| digit.is_ascii_hexdigit());
    let pairs = || (0..text.len()).step_by(2).map(|at| u8::from_str_radix(&text[at..at + 2], 16).ok());
    is_hexadecimal.then(pairs)?.collect()
}

/// Events that wait to be printed.
const QUEUE: u8 = 254;
/// Of a soft real-time channel that no file describes.
const DEADLINE: time::Duration = time::Duration::from_millis(20);
/// Until what was published last must have been sent.
const LONGEST_WAIT: Duration = Duration::from_secs(2);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contents_are_bytes_or_fields() {
        let words = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        assert_eq!(content(None, &words(&["0A0B", "ff"])).ok(), Some(vec![0x0A, 0x0B, 0xFF]));
        assert_eq!(content(None, &[]).ok(), Some(Vec::new()));
        assert!(event_of(&[0; 8]).is_ok() && event_of(&[0; 9]).is_err());
        for wrong in [&["1"][..], &["zz"], &["+1"], &["é"], &["speed=1"]] {
            assert!(content(None, &words(wrong)).is_err(), "{wrong:?}");
        }
    }
}
