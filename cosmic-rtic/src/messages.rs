//! Messages longer than a frame: a task waits until one is complete, or has left the node. The observer is told of
//! each of their frames, as of an event.

use core::convert::Infallible;
use core::future::poll_fn;
use core::marker::PhantomData;
use core::task::{Poll, Waker};

use cosmic_core::Half as _;
use cosmic_core::Subject;
use cosmic_core::can::{Payload, TxNode};
use cosmic_core::event_layer::{
    self, AnnounceError, Content, Delivered, Depth, Filter, MessageChannel, Policy, PublishError,
    SubscribeError,
};
use cosmic_core::network::fragments::ReassemblyCounters;
use cosmic_core::time::Duration;
use rtic_core::Mutex;

use crate::application::Ticker;
use crate::board::Board as _;
use crate::node::Node;
use crate::observer::Observes;
use crate::system::System;

/// The right to publish messages of up to `LEN` bytes on a channel. One for each channel and node.
#[derive(Debug)]
pub struct MessagePublisher<C, const LEN: usize> {
    subject: Subject,
    inner: event_layer::MessagePublisher<LEN>,
    content: PhantomData<fn(&C)>,
}

/// A subscription to a channel of messages of up to `LEN` bytes, from up to `PUBLISHERS` nodes at once.
#[derive(Debug)]
pub struct MessageSubscriber<C, const LEN: usize, const PUBLISHERS: usize> {
    subject: Subject,
    inner: event_layer::MessageSubscriber<PUBLISHERS, LEN>,
    content: PhantomData<fn() -> C>,
}

/// A message as it is delivered.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Message<C> {
    /// What was published.
    pub content: C,
    /// The node that published it.
    pub publisher: TxNode,
}

/// Why a message was not sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MessageError {
    /// One of its frames was refused.
    Publish(PublishError),
    /// One of its frames expired, or lost its identifier, before it was sent. Receivers drop the rest.
    Discarded,
}

impl<C: Content, const LEN: usize> MessagePublisher<C, LEN> {
    /// Announces the channel.
    ///
    /// # Errors
    /// [`AnnounceError`]: a channel that is not in the plan of this node, mostly.
    pub fn announce<T: System, const PUBLISHERS: usize>(
        channel: &'static MessageChannel<C, LEN, PUBLISHERS>,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<Self, AnnounceError> {
        let fragments = channel.fragments();
        let publication = node.lock(|node| node.announce(fragments))?;
        let inner = event_layer::MessagePublisher::new(publication);
        Ok(Self { subject: fragments.subject(), inner, content: PhantomData })
    }

    /// Sends a message, and waits until all of it has left the node. Frames of others come in between.
    ///
    /// A call that is given up leaves the rest of its message to the next call, which sends it first.
    ///
    /// # Errors
    /// [`MessageError`]: nobody has received the message.
    pub async fn publish<T>(
        &mut self,
        content: &C,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<(), MessageError>
    where
        T: System<Observer: Observes<Payload>>,
    {
        // Of a call before that was given up, it is no concern of this one how its message ended.
        let _ = self.departure(node).await;
        // It fits, which the type of the channel says, and nothing is under way.
        let _ = self.inner.start_content(content);
        self.departure(node).await
    }

    /// Waits until nothing is under way any more.
    async fn departure<T>(&mut self, node: &mut impl Mutex<T = Node<T>>) -> Result<(), MessageError>
    where
        T: System<Observer: Observes<Payload>>,
    {
        let discarded = self.inner.discarded();
        let (subject, publisher) = (self.subject, &mut self.inner);
        poll_fn(|context| node.lock(|node| node.poll_departure(subject, publisher, context.waker())))
            .await
            .map_err(MessageError::Publish)?;
        if self.inner.discarded() == discarded { Ok(()) } else { Err(MessageError::Discarded) }
    }

    /// Gives up the announcement. What is under way is not sent to its end.
    pub fn cancel<T: System>(self, node: &mut impl Mutex<T = Node<T>>) {
        node.lock(|node| node.cancel_publication(self.inner.into_publication()));
    }
}

impl<C: Content, const LEN: usize, const PUBLISHERS: usize> MessageSubscriber<C, LEN, PUBLISHERS> {
    /// Subscribes to all messages of the channel. One that stops is dropped after `time_out`, which should be longer
    /// than the bus is ever kept from non real-time traffic.
    ///
    /// # Errors
    /// [`SubscribeError`]: a channel that is not in the plan, or no room.
    pub fn subscribe<T: System>(
        channel: &'static MessageChannel<C, LEN, PUBLISHERS>,
        time_out: Duration,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<Self, SubscribeError> {
        let fragments = channel.fragments();
        let subscription = node.lock(|node| node.subscribe(fragments, Filter::ALL, FRAGMENTS))?;
        let inner = event_layer::MessageSubscriber::new(subscription, time_out);
        Ok(Self { subject: fragments.subject(), inner, content: PhantomData })
    }

    /// Waits for the next message. One whose bytes are no value of the channel's type is passed over, with
    /// an exception.
    pub async fn next<T>(&mut self, node: &mut impl Mutex<T = Node<T>>) -> Message<C>
    where
        T: System<Observer: Observes<Payload>>,
    {
        let (subject, subscriber) = (self.subject, &mut self.inner);
        poll_fn(|context| node.lock(|node| node.poll_message(subject, subscriber, context.waker()))).await
    }

    /// What was delivered and dropped.
    pub const fn counters(&self) -> &ReassemblyCounters {
        self.inner.counters()
    }

    /// Gives up the subscription, with what has arrived of messages.
    pub fn cancel<T: System>(self, node: &mut impl Mutex<T = Node<T>>) {
        node.lock(|node| node.cancel_subscription(self.subject, self.inner.into_subscription()));
    }
}

/// Announces a channel and sends a message in each period, for ever: `next` makes it. One that is not sent is counted.
///
/// # Errors
/// Only if the channel cannot be announced.
pub async fn publish_message_every<T, C, N, const LEN: usize, const PUBLISHERS: usize>(
    channel: &'static MessageChannel<C, LEN, PUBLISHERS>,
    period: Duration,
    node: &mut N,
    mut next: impl FnMut(&mut N) -> C,
) -> Result<Infallible, AnnounceError>
where
    T: System<Observer: Observes<Payload>>,
    C: Content,
    N: Mutex<T = Node<T>>,
{
    let mut publisher = MessagePublisher::announce(channel, node)?;
    let mut ticker = Ticker::<T::Board>::every(period);
    loop {
        ticker.tick().await;
        let content = next(node);
        let _ = publisher.publish(&content, node).await;
    }
}

impl<T> Node<T>
where
    T: System<Observer: Observes<Payload>>,
{
    /// Sends the next frame of a message if it is time to; ready when none is left.
    fn poll_departure<const LEN: usize>(
        &mut self,
        subject: Subject,
        publisher: &mut event_layer::MessagePublisher<LEN>,
        waker: &Waker,
    ) -> Poll<Result<(), PublishError>> {
        if publisher.is_idle() {
            return Poll::Ready(Ok(()));
        }
        let now = T::Board::now();
        let (before, _) = publisher.last_fragment();
        let sent = self.half.send_message(now, publisher).map(|due| self.carry_out(due));
        self.wake.something_due();
        let (after, fragment) = publisher.last_fragment();
        if after != before {
            self.observer.published(subject, &fragment, now, sent);
        }
        sent?;
        if publisher.is_idle() {
            return Poll::Ready(Ok(()));
        }
        self.departures.register(waker);
        Poll::Pending
    }

    fn poll_message<C: Content, const PLACES: usize, const LEN: usize>(
        &mut self,
        subject: Subject,
        subscriber: &mut event_layer::MessageSubscriber<PLACES, LEN>,
        waker: &Waker,
    ) -> Poll<Message<C>> {
        let Self { half, observer, .. } = self;
        let now = T::Board::now();
        let each = |fragment: &Delivered<Payload>| observer.delivered(subject, fragment, now);
        half.poll_message(subscriber, now, waker, each, |message| {
            let content = C::decode(message.content)?;
            Some(Message { content, publisher: message.publisher })
        })
    }
}

/// Fragments that may wait: more than arrive before the task runs.
const FRAGMENTS: Policy = Policy::Fifo(Depth::new(8).unwrap());
