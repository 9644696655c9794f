//! `cosmic serve`: the live page, for a browser.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::process::ExitCode;
use std::time::Duration;

use cosmic_core::Subject;
use cosmic_core::can::Payload;
use cosmic_core::event_layer::Event;
use cosmic_linux::link::LinkAddress;
use cosmic_linux::{Node, Publisher};
use cosmic_monitor::{Monitor, SegmentPlan};
use cosmic_page::{Config, Hub, PublishRequest, Publishing, Segment, Token};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};
use tokio::time::MissedTickBehavior;

use super::{part, warn};
use crate::arguments::{Also, Identity, Serve};
use crate::context::Context;
use crate::failure::Failure;
use crate::source::{Source, end_of, sleep_until};

/// An event to be published, and where the answer goes.
type Order = (PublishRequest, oneshot::Sender<Result<(), String>>);

pub(super) async fn serve(context: &mut Context, options: &Serve) -> Result<ExitCode, Failure> {
    let (orders, ordered) = mpsc::channel(MOST_ORDERS);
    let token = options.allow_publish.then(Token::draw);
    if options.allow_publish {
        publishable(context.link()?)?;
    }
    let publishing = token.clone().map(|token| {
        Publishing::new(token, move |request| {
            let orders = orders.clone();
            async move {
                let (answer, answered) = oneshot::channel();
                let busy = || "too much is being published: try again".to_owned();
                orders.try_send((request, answer)).map_err(|_| busy())?;
                answered.await.unwrap_or_else(|_| Err("this program is ending".to_owned()))
            }
        })
    });
    let hub = Hub::new(Config { title: String::new(), hosts: options.hosts.clone(), publishing });
    let followed = followed(context, &hub, &options.also)?;
    let listener = TcpListener::bind(options.listen).await.map_err(|error| {
        Failure::input(format!(
            "the page cannot be served at {}: {error}; choose another --listen",
            options.listen
        ))
    })?;
    say_where(context, &listener, token.as_ref())?;
    let mut followers = tokio::task::JoinSet::new();
    for (source, segment) in followed {
        followers.spawn(follow(source, segment));
    }
    let until = end_of(options.span);
    tokio::select! {
        served = cosmic_page::serve(hub, listener) => {
            let why = |error| Failure::input(format!("the page is served no more: {error}"));
            served.map_err(why)?;
        }
        () = publish_all(context, &options.identity, ordered) => {}
        () = sleep_until(until) => {}
        _ = tokio::signal::ctrl_c() => {}
    }
    Ok(ExitCode::SUCCESS)
}

/// A link that another program of ours may use at the same time.
fn publishable(link: &LinkAddress) -> Result<(), Failure> {
    match link {
        LinkAddress::Log(_) => Err(Failure::input("a log cannot be published on: leave out --allow-publish")),
        LinkAddress::Slcan(_) => Err(Failure::input(
            "a serial line serves one program at a time, so the page cannot watch and publish by it: \
             leave out --allow-publish, or use a link by socketcand or SocketCAN",
        )),
        _ => Ok(()),
    }
}

/// The segments that were asked for, each with where its frames come from.
fn followed(context: &Context, hub: &Hub, others: &[Also]) -> Result<Vec<(Source, Segment)>, Failure> {
    let mut followed = Vec::new();
    let mut add = |link: &LinkAddress, plan: Option<SegmentPlan>| {
        let bit_rate = plan.as_ref().map_or(context.common.bit_rate, SegmentPlan::bit_rate);
        let source = Source::open(link, bit_rate)?.in_its_time();
        let name = plan.as_ref().map_or_else(|| link.to_string(), |plan| plan.cluster().name.clone());
        let monitor = match plan {
            Some(plan) => Monitor::with_plan(plan, source.now()),
            None => Monitor::new(bit_rate, source.now()),
        };
        followed.push((source, hub.segment(name, link.to_string(), monitor)));
        Ok::<_, Failure>(())
    };
    add(context.link()?, context.plan.clone())?;
    for Also { link, cluster } in others {
        let plan = cluster.as_ref().map(SegmentPlan::read).transpose();
        add(link, plan.map_err(|refused| Failure::input(refused.to_string()))?)?;
    }
    Ok(followed)
}

fn say_where(context: &mut Context, listener: &TcpListener, token: Option<&Token>) -> Result<(), Failure> {
    let address = listener.local_addr().map_err(|error| Failure::input(error.to_string()))?;
    let token = token.map(Token::as_str);
    if context.output.json() {
        context.output.value(&serde_json::json!({ "url": format!("http://{address}/"), "token": token }))?;
    } else {
        context.output.line(&match token {
            None => format!("the page: http://{address}/"),
            Some(token) => format!("the page, for who may publish: http://{address}/#token={token}\nfor others: http://{address}/"),
        })?;
    }
    if !address.ip().is_loopback() {
        eprintln!("cosmic: whoever reaches {address} sees these segments; nothing is encrypted");
    }
    context.output.flush()
}

/// Tells a segment what comes, and what time it is while nothing does.
async fn follow(mut source: Source, segment: Segment) {
    let mut tick = tokio::time::interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            biased;
            _ = tick.tick() => segment.advance(source.now()),
            next = source.next() => match next {
                Some(Ok(tapped)) => {
                    warn(&tapped);
                    segment.on_tapped(&tapped);
                }
                Some(Err(failure)) => return segment.trouble(Some(failure.to_string())),
                None => return segment.trouble(Some("the log has ended".to_owned())),
            },
        }
    }
}

/// Publishes what is ordered, one after the other, as a node that starts with the first.
async fn publish_all(context: &Context, identity: &Identity, mut orders: mpsc::Receiver<Order>) {
    let mut node = None;
    let mut announced = HashMap::new();
    while let Some((request, answer)) = orders.recv().await {
        let published = publish(context, identity, &mut node, &mut announced, &request).await;
        // Who asked may have gone.
        let _ = answer.send(published.map_err(|failure| failure.to_string()));
    }
    // Nobody may publish.
    std::future::pending().await
}

async fn publish(
    context: &Context,
    identity: &Identity,
    node: &mut Option<Node>,
    announced: &mut HashMap<Subject, Publisher<Payload>>,
    request: &PublishRequest,
) -> Result<(), Failure> {
    if request.segment != 0 {
        return Err(Failure::input("only the segment of --link can be published on"));
    }
    let (channel, at) = part::soft_channel(context.plan.as_ref(), &request.channel)?;
    let content = part::event_of(&part::content(context.plan.as_ref().zip(at), &request.content)?)?;
    let node = match node {
        Some(node) => node,
        None => node.insert(part::start(context, identity, None).await?),
    };
    let subject = channel.subject();
    let is_full = announced.len() >= MOST_CHANNELS;
    let publisher = match announced.entry(subject) {
        Entry::Occupied(known) => known.into_mut(),
        Entry::Vacant(_) if is_full => {
            return Err(Failure::input(format!(
                "this page has published on {MOST_CHANNELS} channels: start it anew"
            )));
        }
        Entry::Vacant(place) => {
            let publisher = node.announce(&channel).map_err(|error| Failure::input(error.to_string()))?;
            part::named(identity, publisher.bound()).await?;
            place.insert(publisher)
        }
    };
    let before = node.channel_counters(subject).unwrap_or_default();
    publisher.publish_event(&Event::new(content)).map_err(|error| Failure::input(error.to_string()))?;
    part::concluded(node, subject).await;
    let after = node.channel_counters(subject).unwrap_or_default();
    let what = match (after.sent == before.sent, after.discarded == before.discarded) {
        (false, true) => return Ok(()),
        (_, false) => "the event expired before it could be sent",
        (true, true) => "the event still waits to be sent",
    };
    Err(Failure::link(format!("{what}: the bus is too busy, or the link is down")))
}

/// So many events wait to be published.
const MOST_ORDERS: usize = 16;
/// So many channels are announced.
const MOST_CHANNELS: usize = 32;
/// How often a quiet segment is told the time.
const TICK: Duration = Duration::from_millis(100);
