//! Subscriptions on IP.

use std::marker::PhantomData;
use std::sync::Arc;

use cosmic_core::can::Payload;
use cosmic_core::event_layer::{Channel, Content, Context, Policy};
use zenoh::sample::Locality;

use super::inlet::Inlet;
use super::queue::Queue;
use super::{IpError, Node, Received, now};
use crate::counters::Outcome;
use crate::network::failed;

/// Where the events of a channel come in and wait.
pub(super) struct Intake {
    node: Node,
    queue: Arc<Queue>,
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

impl Intake {
    pub(super) async fn open<C: Content>(
        node: &Node,
        channel: &Channel<C>,
        policy: Policy,
    ) -> Result<Self, IpError> {
        let network = &node.inner.network;
        let queue = Arc::new(Queue::new(policy));
        let inlet = Inlet {
            door: network.door(),
            subject: channel.subject(),
            queue: Arc::clone(&queue),
            counters: node.inner.incoming.clone(),
            attributes: channel.attributes(),
            layout: channel.layout(),
        };
        let key = network.keys.events(channel.subject());
        let subscriber = network.session.declare_subscriber(key).allowed_origin(Locality::Remote);
        let subscriber = subscriber.callback(move |sample| inlet.pass(&sample)).await;
        let subscriber = subscriber.map_err(|error| failed(&error))?;
        Ok(Self { node: node.clone(), queue, _subscriber: subscriber })
    }

    /// Waits for the next event that this can read.
    async fn next<C>(&self, read: impl Fn(&[u8]) -> Option<(Context, C)>) -> Received<C> {
        loop {
            let told = self.queue.told();
            if let Some(event) = self.try_next(&read) {
                return event;
            }
            told.await;
        }
    }

    /// The next event that this can read. What has expired while it waited is passed over, and counted.
    fn try_next<C>(&self, read: impl Fn(&[u8]) -> Option<(Context, C)>) -> Option<Received<C>> {
        let counters = &self.node.inner.incoming;
        loop {
            let event = self.queue.pop()?;
            if event.expires_at.is_some_and(|at| at <= now()) {
                counters.count(Outcome::Expired);
                continue;
            }
            match read(&event.content) {
                Some((context, content)) => {
                    return Some(Received { context, ..event.map(|_| content) });
                }
                None => counters.count(Outcome::Malformed),
            }
        }
    }
}

/// A subscription to a channel. Given up when it is dropped, with the events that wait for it.
pub struct Subscriber<C> {
    pub(super) intake: Intake,
    pub(super) channel: Channel<C>,
}

impl<C: Content> Subscriber<C> {
    /// Waits for the next event. Cancelling the wait loses none.
    pub async fn next(&self) -> Received<C> {
        self.intake.next(|bytes| self.decode(bytes)).await
    }

    /// The next event, if there is one. What has expired while it waited is passed over, and counted.
    pub fn try_next(&self) -> Option<Received<C>> {
        self.intake.try_next(|bytes| self.decode(bytes))
    }

    fn decode(&self, bytes: &[u8]) -> Option<(Context, C)> {
        if self.channel.has_context() {
            let (context, content) = Context::split(&Payload::new(bytes)?)?;
            Some((context, C::decode(content.as_slice())?))
        } else {
            Some((Context::EMPTY, C::decode(bytes)?))
        }
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.intake.node
    }
}

/// A subscription to a channel of messages. Given up when it is dropped, with the messages that wait for it.
pub struct MessageSubscriber<C> {
    intake: Intake,
    content: PhantomData<fn() -> C>,
}

impl<C: Content> MessageSubscriber<C> {
    pub(super) const fn new(intake: Intake) -> Self {
        Self { intake, content: PhantomData }
    }

    /// Waits for the next message. Cancelling the wait loses none.
    pub async fn next(&self) -> Received<C> {
        self.intake.next(decode).await
    }

    /// The next message, if one has come. What has expired while it waited is passed over, and counted.
    pub fn try_next(&self) -> Option<Received<C>> {
        self.intake.try_next(decode)
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.intake.node
    }
}

/// A message has no attributes of context.
fn decode<C: Content>(bytes: &[u8]) -> Option<(Context, C)> {
    Some((Context::EMPTY, C::decode(bytes)?))
}
