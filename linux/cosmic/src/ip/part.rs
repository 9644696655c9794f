//! `cosmic sub` and `cosmic pub` across IP: as a node on IP alone, which is a segment of one node.

use std::process::ExitCode;

use cosmic_core::Subject;
use cosmic_core::can::Payload;
use cosmic_core::event_layer::{Bytes, Channel, Depth, Event, Policy, PublishError};
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::ip::{
    IpError, MessagePublisher, MessageSubscriber, Node, Publisher, Received, Subscriber,
};
use cosmic_linux::{AnnounceError, drawn_uid};
use cosmic_monitor::{ByteMessages, class_name, hex_text};
use cosmic_session::{Declared, LONGEST_MESSAGE};

use super::words::{self, Line};
use super::{CLOCKS, PATIENCE, name, network, unreachable_at};
use crate::arguments::{Identity, Publish, Subscribe};
use crate::choice::Endpoint;
use crate::commands::part;
use crate::context::Context;
use crate::failure::{FOUND, Failure};
use crate::source::{end_of, sleep_until, std_span};

/// A node on IP, when it is connected.
async fn start(context: &Context, at: &Endpoint, identity: &Identity) -> Result<Node, Failure> {
    if identity.uid.is_some() || identity.tx_node.is_some() {
        return Err(Failure::input(
            "a node on IP has neither UID nor TxNode: leave out --uid and --tx-node; --name says who it is",
        ));
    }
    let (ip, network) = network(context, at)?;
    let drawn = || format!("cosmic-{}", drawn_uid()).to_lowercase();
    let name = name(&context.common.ip.name.clone().unwrap_or_else(drawn), "--name")?;
    let node = Node::start(&ip, &network, &name).await;
    let node = node.map_err(|error| Failure::link(error.to_string()))?;
    let connected = tokio::time::timeout(PATIENCE, node.connected()).await;
    connected.map_err(|_| unreachable_at(at))?;
    Ok(node)
}

/// What comes on a channel.
enum Incoming {
    Events(Subscriber<Payload>),
    Messages(MessageSubscriber<Bytes<LONGEST_MESSAGE>>),
}

impl Incoming {
    async fn of(node: &Node, declared: &Declared) -> Result<Self, Failure> {
        let policy = Depth::new(QUEUE).map_or(Policy::Latest, Policy::Fifo);
        let incoming = match declared {
            Declared::Events(channel) => node.subscribe(channel, policy).await.map(Self::Events),
            Declared::Messages(channel) => node.subscribe_messages(channel, policy).await.map(Self::Messages),
        };
        incoming.map_err(refused)
    }

    async fn next(&self) -> Received<Vec<u8>> {
        match self {
            Self::Events(events) => events.next().await.map(|content| content.as_slice().to_vec()),
            Self::Messages(messages) => messages.next().await.map(|content| content.as_slice().to_vec()),
        }
    }
}

/// What is to be published, and on which channel.
enum Said {
    Event(Channel<Payload>, Payload),
    Message(ByteMessages, Box<Bytes<LONGEST_MESSAGE>>),
}

impl Said {
    fn new(declared: Declared, content: &[u8], options: &Publish) -> Result<Self, Failure> {
        Ok(match declared {
            Declared::Events(channel) => Self::Event(channel, part::event_of(content)?),
            Declared::Messages(channel) => {
                Self::Message(channel, Box::new(part::message_of(content, options)?))
            }
        })
    }
}

/// What goes out on a channel.
enum Outgoing {
    Event(Publisher<Payload>, Payload),
    Message(MessagePublisher<Bytes<LONGEST_MESSAGE>>, Box<Bytes<LONGEST_MESSAGE>>),
}

impl Outgoing {
    async fn of(node: &Node, said: Said) -> Result<Self, Failure> {
        let outgoing = match said {
            Said::Event(channel, content) => {
                node.announce(&channel).await.map(|publisher| Self::Event(publisher, content))
            }
            Said::Message(channel, content) => {
                let publisher = node.announce_messages(&channel).await;
                publisher.map(|publisher| Self::Message(publisher, content))
            }
        };
        outgoing.map_err(refused)
    }

    async fn wanted(&self) {
        match self {
            Self::Event(publisher, _) => publisher.wanted().await,
            Self::Message(publisher, _) => publisher.wanted().await,
        }
    }

    fn publish(&self, node: &Node, options: &Publish) -> Result<(), PublishError> {
        match self {
            Self::Event(publisher, content) => publisher.publish_event(&Event {
                deadline: options.deadline.map(|deadline| node.now() + deadline),
                expires_at: options.validity.map(|validity| node.now() + validity),
                ..Event::new(*content)
            }),
            Self::Message(publisher, content) => publisher.publish_within(content, options.validity),
        }
    }
}

/// `cosmic sub`
pub(super) async fn subscribe(
    context: &mut Context,
    at: &Endpoint,
    options: &Subscribe,
) -> Result<ExitCode, Failure> {
    let (channel, _) = part::subscribed(context.plan.as_ref(), options)?;
    let node = start(context, at, &options.identity).await?;
    let incoming = Incoming::of(&node, &channel).await?;
    let until = end_of(options.span);
    let (mut printed, began) = (0, node.now());
    while options.count.is_none_or(|count| printed < count) {
        let event = tokio::select! {
            biased;
            _ = tokio::signal::ctrl_c() => break,
            () = sleep_until(until) => break,
            event = incoming.next() => event,
        };
        let at_ns = event.received_at.saturating_since(began).as_ticks();
        line(context, channel.subject(), &event, at_ns).print(context)?;
        printed += 1;
    }
    let dropped = node.count(Direction::In, Outcome::QueueFull);
    if dropped > 0 {
        eprintln!("cosmic: {dropped} events came too fast, and are not shown");
    }
    end(node).await;
    Ok(context.ended(printed > 0, "no event has come; `cosmic channels` across IP shows who publishes"))
}

fn line(context: &Context, subject: Subject, event: &Received<Vec<u8>>, at_ns: u64) -> Line {
    let plan = context.plan.as_ref();
    let (fields, malformed) = words::content(plan, subject, &event.content);
    Line {
        at_ns,
        class: class_name(event.class),
        segment: event.origin.segment.to_string(),
        tx_node: event.origin.node.map(|node| node.get()),
        subject: subject.to_string(),
        channel: words::channel(plan, subject),
        number: None,
        missing: 0,
        left_ns: words::left(event.deadline, event.received_at),
        data: hex_text(&event.content),
        fields,
        malformed,
    }
}

/// `cosmic pub`
pub(super) async fn publish(
    context: &mut Context,
    at: &Endpoint,
    options: &Publish,
) -> Result<ExitCode, Failure> {
    let (channel, planned) = part::published(context.plan.as_ref(), options)?;
    let content = part::content(context.plan.as_ref().zip(planned), &options.content)?;
    // Before anybody is asked for.
    let said = Said::new(channel, &content, options)?;
    let node = start(context, at, &options.identity).await?;
    let outgoing = Outgoing::of(&node, said).await?;
    let patience = std_span(options.identity.patience);
    let wanted = tokio::time::timeout(patience, outgoing.wanted()).await;
    wanted.map_err(|_| {
        let patience = cosmic_plan::units::show(options.identity.patience);
        Failure::link(format!(
            "nobody on this network has subscribed to {} within {patience}: no node, and no gateway on behalf of its segments",
            options.channel
        ))
    })?;
    // Before others know this node's clock, they discard what it sends.
    let _ = tokio::time::timeout(CLOCKS, node.known()).await;
    let mut published = 0_u64;
    while published < options.count && part::goes_on(published, options).await {
        outgoing.publish(&node, options).map_err(|error| Failure::input(error.to_string()))?;
        published += 1;
    }
    let sent = node.count(Direction::Out, Outcome::Forwarded);
    drop(outgoing);
    end(node).await;
    if context.output.json() {
        context.output.value(&serde_json::json!({ "published": published, "sent": sent }))?;
    } else {
        eprintln!("cosmic: {published} published, {sent} sent");
    }
    Ok(if sent == options.count { ExitCode::SUCCESS } else { ExitCode::from(FOUND) })
}

fn refused(error: IpError) -> Failure {
    match error {
        IpError::Announce(AnnounceError::HardRealTime) => Failure::input(
            "a hard real-time channel is published in its slot on a bus, and IP has none: publish it on its segment",
        ),
        other => Failure::link(other.to_string()),
    }
}

async fn end(node: Node) {
    let _ = tokio::time::timeout(PATIENCE, node.stop()).await;
}

/// Events that wait to be printed.
const QUEUE: u8 = 254;
