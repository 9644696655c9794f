//! What an application calls. Each call locks the node for its own time only.

use core::convert::Infallible;
use core::future::poll_fn;
use core::marker::PhantomData;
use core::task::{Poll, Waker};

use cosmic_core::Subject;
use cosmic_core::calendar::Slot;
use cosmic_core::event_layer::{
    AnnounceError, Channel, Content, Delivered, Event, Exception, Filter, Policy, Publication, PublishError,
    SubscribeError, Subscription,
};
use cosmic_core::services::News;
use cosmic_core::time::{Duration, Instant};
use rtic_core::Mutex;

use crate::board::Board;
use crate::node::Node;
use crate::observer::Observes;
use crate::system::System;

/// The right to publish on a channel.
#[derive(Debug)]
pub struct Publisher<C> {
    subject: Subject,
    publication: Publication<C>,
}

/// A subscription to a channel.
#[derive(Debug)]
pub struct Subscriber<C> {
    subject: Subject,
    subscription: Subscription<C>,
}

impl<C: Content> Publisher<C> {
    /// Announces the channel. From then on a slot of a periodic hard real-time channel without an event is an
    /// error, so announce such a channel shortly before its first event.
    ///
    /// # Errors
    /// [`AnnounceError`]: a channel that is not in the plan of this node, mostly.
    pub fn announce<T: System>(
        channel: &'static Channel<C>,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<Self, AnnounceError> {
        let publication = node.lock(|node| node.announce(channel))?;
        Ok(Self { subject: channel.subject(), publication })
    }

    /// Publishes an event of now.
    ///
    /// # Errors
    /// [`PublishError`]: the event is not sent.
    #[inline]
    pub fn publish<T>(&self, content: C, node: &mut impl Mutex<T = Node<T>>) -> Result<(), PublishError>
    where
        T: System<Observer: Observes<C>>,
    {
        self.publish_event(&Event::new(content), node)
    }

    /// Publishes an event with times or context of its own.
    ///
    /// # Errors
    /// [`PublishError`]: the event is not sent.
    #[inline]
    pub fn publish_event<T>(
        &self,
        event: &Event<C>,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<(), PublishError>
    where
        T: System<Observer: Observes<C>>,
    {
        node.lock(|node| node.publish(self.subject, &self.publication, event))
    }

    /// Waits until the node has its TxNode and the channel its etag, where a broker gives them. Before that, publishing
    /// is refused.
    pub async fn bound<T: System>(&self, node: &mut impl Mutex<T = Node<T>>) {
        while !node.lock(|node| node.is_bound(self.subject)) {
            T::Board::delay_until(T::Board::now() + BETWEEN_LOOKS).await;
        }
    }

    /// Gives up the announcement. Events that wait to be sent are discarded if it was the last one of the channel.
    pub fn cancel<T: System>(self, node: &mut impl Mutex<T = Node<T>>) {
        node.lock(|node| node.cancel_publication(self.publication));
    }
}

impl<C: Content> Subscriber<C> {
    /// Subscribes to all events of the channel.
    ///
    /// # Errors
    /// [`SubscribeError`]: a channel that is not in the plan, or no room.
    pub fn subscribe<T: System>(
        channel: &'static Channel<C>,
        policy: Policy,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<Self, SubscribeError> {
        Self::subscribe_filtered(channel, Filter::ALL, policy, node)
    }

    /// Subscribes to those events that pass the filter.
    ///
    /// # Errors
    /// As [`subscribe`](Self::subscribe).
    pub fn subscribe_filtered<T: System>(
        channel: &'static Channel<C>,
        filter: Filter,
        policy: Policy,
        node: &mut impl Mutex<T = Node<T>>,
    ) -> Result<Self, SubscribeError> {
        let subscription = node.lock(|node| node.subscribe(channel, filter, policy))?;
        Ok(Self { subject: channel.subject(), subscription })
    }

    /// Waits for the next event.
    pub async fn next<T>(&self, node: &mut impl Mutex<T = Node<T>>) -> Delivered<C>
    where
        T: System<Observer: Observes<C>>,
    {
        let Self { subject, subscription } = self;
        poll_fn(|context| node.lock(|node| node.poll_next(*subject, subscription, context.waker()))).await
    }

    /// The next event, if there is one.
    pub fn try_next<T>(&self, node: &mut impl Mutex<T = Node<T>>) -> Option<Delivered<C>>
    where
        T: System<Observer: Observes<C>>,
    {
        let Self { subject, subscription } = self;
        let next = node.lock(|node| node.poll_next(*subject, subscription, Waker::noop()));
        if let Poll::Ready(event) = next { Some(event) } else { None }
    }

    /// Gives up the subscription, with the events that wait for it.
    pub fn cancel<T: System>(self, node: &mut impl Mutex<T = Node<T>>) {
        node.lock(|node| node.cancel_subscription(self.subject, self.subscription));
    }
}

/// Waits for the next exception.
pub async fn next_exception<T: System>(node: &mut impl Mutex<T = Node<T>>) -> Exception {
    poll_fn(|context| node.lock(|node| node.poll_exception(context.waker()))).await
}

/// Waits for the next piece of news of the cluster: this node has its TxNode, others have come or gone, somebody wants a
/// channel. For one task of the node, whose services tell news: [`NodeServices`](cosmic_core::services::NodeServices).
pub async fn next_news<T: System>(node: &mut impl Mutex<T = Node<T>>) -> News {
    poll_fn(|context| node.lock(|node| node.poll_news(context.waker()))).await
}

/// Takes one exception after the other, so that the observer hears of each.
pub async fn report_exceptions<T: System>(mut node: impl Mutex<T = Node<T>>) {
    loop {
        next_exception(&mut node).await;
    }
}

/// Waits until this node knows the time of the cluster, without which it takes no part in hard real-time.
pub async fn synchronised<T: System>(node: &mut impl Mutex<T = Node<T>>) {
    synchronised_since(node).await;
}

/// Waits until this node knows the time of the cluster, and all nodes that were switched on with it do: they may
/// have missed the first frames of the time master. What is published before may be lost.
pub async fn settled<T: System>(node: &mut impl Mutex<T = Node<T>>) {
    let since = synchronised_since(node).await;
    let period = node.lock(|node| node.sync_period());
    T::Board::delay_until(since + period * FRAMES_TO_SETTLE).await;
}

/// Waits until this node knows the time of the cluster; returns when it was first seen to.
async fn synchronised_since<T: System>(node: &mut impl Mutex<T = Node<T>>) -> Instant {
    let period = node.lock(|node| node.sync_period());
    loop {
        let now = T::Board::now();
        if let Some(since) = node.lock(|node| node.synchronised_since(now)) {
            return since;
        }
        T::Board::delay_until(now + period).await;
    }
}

/// Waits until `lead` before the next slot: the time to publish what the slot is to carry.
pub async fn before_slot<T: System>(slot: &Slot, lead: Duration, node: &mut impl Mutex<T = Node<T>>) {
    let instant = node.lock(|node| node.before_slot(slot, lead, T::Board::now()));
    T::Board::delay_until(instant).await;
}

/// Publishes an event in each slot of a hard real-time channel, for ever: `next` makes it, `lead` before the slot.
/// Starts when the clocks are [settled], and announces the channel then. An event that is not published is counted,
/// and the observer is told.
///
/// # Errors
/// Only if the channel cannot be announced.
pub async fn publish_in_slots<T, C, N>(
    channel: &'static Channel<C>,
    slot: &Slot,
    lead: Duration,
    node: &mut N,
    mut next: impl FnMut(&mut N) -> C,
) -> Result<Infallible, AnnounceError>
where
    T: System<Observer: Observes<C>>,
    C: Content,
    N: Mutex<T = Node<T>>,
{
    settled(node).await;
    before_slot(slot, lead, node).await;
    let publisher = Publisher::announce(channel, node)?;
    loop {
        let content = next(node);
        let _ = publisher.publish(content, node);
        before_slot(slot, lead, node).await;
    }
}

/// Announces a channel and publishes an event in each period, for ever: `next` makes it. An event that is not
/// published is counted, and the observer is told.
///
/// # Errors
/// Only if the channel cannot be announced.
pub async fn publish_every<T, C, N>(
    channel: &'static Channel<C>,
    period: Duration,
    node: &mut N,
    mut next: impl FnMut(&mut N) -> C,
) -> Result<Infallible, AnnounceError>
where
    T: System<Observer: Observes<C>>,
    C: Content,
    N: Mutex<T = Node<T>>,
{
    let publisher = Publisher::announce(channel, node)?;
    let mut ticker = Ticker::<T::Board>::every(period);
    loop {
        ticker.tick().await;
        let content = next(node);
        let _ = publisher.publish(content, node);
    }
}

/// Instants at a constant distance, on the clock of a board.
pub struct Ticker<B> {
    next: Instant,
    period: Duration,
    _board: PhantomData<B>,
}

impl<B: Board> Ticker<B> {
    /// From now on.
    pub fn every(period: Duration) -> Self {
        Self { next: B::now(), period, _board: PhantomData }
    }

    /// Waits for the next instant.
    pub async fn tick(&mut self) {
        self.next = self.next + self.period;
        B::delay_until(self.next).await;
    }
}

/// Between two looks whether something has happened that nobody tells.
const BETWEEN_LOOKS: Duration = Duration::from_millis(10);
/// Sync frames, and the node that missed the first has taken the second and third.
const FRAMES_TO_SETTLE: u32 = 3;
