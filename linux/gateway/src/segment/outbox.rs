//! Messages of several frames on their way into a segment: one frame at a time, so that they keep nobody waiting.
//!
//! A node's own [publisher of messages](cosmic_linux::MessagePublisher) does not do: here each frame has the message's expiry,
//! and what became of each message is told.

use std::time::Duration as Span;

use cosmic_core::can::Payload;
use cosmic_core::event_layer::{ChannelCounters, Event, PublishError};
use cosmic_core::network::fragments::{Fragmenter, MAX_MESSAGE_LEN};
use cosmic_core::time::Instant;
use cosmic_linux::{Publisher, WAITING_MESSAGES};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::counters::{Counters, Outcome};

/// The messages of a channel that wait to be sent. What becomes of each is counted when it is known.
pub(super) struct Outbox {
    waiting: mpsc::Sender<Message>,
    task: JoinHandle<()>,
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.task.abort();
    }
}

struct Message {
    content: Vec<u8>,
    expires_at: Option<Instant>,
}

impl Outbox {
    pub(super) fn new(publisher: Publisher<Payload>, counters: Counters) -> Self {
        let (waiting, messages) = mpsc::channel(WAITING_MESSAGES);
        Self { waiting, task: tokio::spawn(send(publisher, messages, counters)) }
    }

    /// Keeps a place for a message, if there is one. Never waits.
    pub(super) fn place(&self) -> Result<Place<'_>, Outcome> {
        self.waiting.try_reserve().map(Place).map_err(|_| Outcome::QueueFull)
    }
}

/// A place that is kept for a message.
pub(super) struct Place<'a>(mpsc::Permit<'a, Message>);

impl Place<'_> {
    pub(super) fn take(self, content: &[u8], expires_at: Option<Instant>) {
        self.0.send(Message { content: content.to_vec(), expires_at });
    }
}

async fn send(publisher: Publisher<Payload>, mut messages: mpsc::Receiver<Message>, counters: Counters) {
    let mut fragmenter = Box::new(Fragmenter::new());
    while let Some(message) = messages.recv().await {
        let outcome = send_one(&publisher, &mut fragmenter, &message).await;
        counters.count(outcome.err().unwrap_or(Outcome::Forwarded));
    }
}

async fn send_one(
    publisher: &Publisher<Payload>,
    fragmenter: &mut Fragmenter<MAX_MESSAGE_LEN>,
    message: &Message,
) -> Result<(), Outcome> {
    fragmenter.start(&message.content).map_err(|_| Outcome::TooLong)?;
    while let Some(fragment) = fragmenter.poll() {
        match send_fragment(publisher, fragment, message.expires_at).await {
            Ok(()) => fragmenter.on_sent(),
            Err(outcome) => {
                // Who has received the frames before drops them.
                fragmenter.on_discarded();
                return Err(outcome);
            }
        }
    }
    Ok(())
}

/// Publishes a frame, and waits until it has left the node.
async fn send_fragment(
    publisher: &Publisher<Payload>,
    fragment: Payload,
    expires_at: Option<Instant>,
) -> Result<(), Outcome> {
    let mut departures = publisher.node().departures();
    let mut event = Event::new(fragment);
    if let Some(at) = expires_at {
        event = event.expires_at(at);
    }
    let before = counters(publisher);
    loop {
        if expires_at.is_some_and(|at| at <= publisher.node().now()) {
            return Err(Outcome::Expired);
        }
        match publisher.publish_event(&event) {
            Ok(()) => break,
            Err(PublishError::QueueFull) => departure(&mut departures).await,
            Err(why) => return Err(refusal(why)),
        }
    }
    loop {
        let now = counters(publisher);
        if now.discarded != before.discarded {
            return Err(Outcome::Expired);
        } else if now.sent != before.sent {
            return Ok(());
        }
        departure(&mut departures).await;
    }
}

fn counters(publisher: &Publisher<Payload>) -> ChannelCounters {
    publisher.node().channel_counters(publisher.subject()).unwrap_or_default()
}

/// Waits until a frame has left the node. One that expires in its queue does so in silence.
async fn departure(departures: &mut tokio::sync::watch::Receiver<u64>) {
    let _ = tokio::time::timeout(LONGEST_DELAY, departures.changed()).await;
}

/// What it means for an event that the node does not publish it.
pub(super) const fn refusal(why: PublishError) -> Outcome {
    match why {
        PublishError::TooFast => Outcome::RateExceeded,
        PublishError::QueueFull => Outcome::QueueFull,
        PublishError::Deadline => Outcome::Expired,
        PublishError::TooLong => Outcome::TooLong,
        _ => Outcome::NotBound,
    }
}

const LONGEST_DELAY: Span = Span::from_millis(10);
