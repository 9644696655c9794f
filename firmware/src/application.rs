//! What an application calls: publishers and subscribers that also write the records.

use core::future::poll_fn;

use boards::clock;
use boards::stm32f4::MeasuringPoint;
use cosmic_core::event_half::Delivered;
use cosmic_core::event_layer::{Channel, Event, Policy, Publication, Subscription};
use rtic::Mutex;
use rtic_sync::signal::SignalWriter;

use crate::cluster;
use crate::node::Node;
use crate::records::{Records, Sequenced};

/// The right to publish on a channel.
pub struct Publisher<C> {
    channel: Channel<C>,
    publication: Publication<C>,
}

/// A subscription to a channel.
pub struct Subscriber<C> {
    channel: Channel<C>,
    subscription: Subscription<C>,
}

/// Shows what happens to events: by records, logs and measuring points.
pub struct Reporter {
    records: Records,
    wake: SignalWriter<'static, ()>,
    published: MeasuringPoint<13>,
    exception: MeasuringPoint<15>,
}

impl<C: Sequenced + defmt::Format> Publisher<C> {
    /// Announces the channel. A channel that cannot be announced is a mistake in the source: the
    /// application ends, with a log.
    pub fn announce(channel: &Channel<C>, node: &mut impl Mutex<T = Node>) -> Self {
        let publication = node.lock(|node| node.announce(channel));
        let publication = defmt::unwrap!(publication);
        Self { channel: *channel, publication }
    }

    /// Publishes an event of now.
    pub fn publish(
        &self,
        content: C,
        node: &mut impl Mutex<T = Node>,
        reporter: &mut impl Mutex<T = Reporter>,
    ) {
        let sequence = content.sequence();
        let now = clock::now();
        let event = Event::new(content);
        let result = node.lock(|node| node.publish(now, &self.publication, &event));
        reporter.lock(|reporter| {
            reporter.published.toggle();
            // There may be more to do than could be done at once, or something to be done later.
            reporter.wake.write(());
            reporter.records.published(&self.channel, sequence, now, result.is_ok());
        });
        if let Err(error) = result {
            defmt::warn!("event {} of {} was not published: {}", sequence, self.channel.subject(), error);
        }
    }
}

impl<C: Sequenced> Subscriber<C> {
    /// Subscribes to all events of the channel; as [`Publisher::announce`].
    pub fn subscribe(channel: &Channel<C>, policy: Policy, node: &mut impl Mutex<T = Node>) -> Self {
        let subscription = node.lock(|node| node.subscribe(channel, policy));
        let subscription = defmt::unwrap!(subscription);
        Self { channel: *channel, subscription }
    }

    /// Waits for the next event.
    pub async fn next(
        &self,
        node: &mut impl Mutex<T = Node>,
        reporter: &mut impl Mutex<T = Reporter>,
    ) -> Delivered<C> {
        let event =
            poll_fn(|context| node.lock(|node| node.half().poll_next(&self.subscription, context.waker())))
                .await;
        let now = clock::now();
        reporter.lock(|reporter| reporter.records.delivered(&self.channel, &event, now));
        event
    }
}

impl Reporter {
    pub(crate) fn new(
        records: Records,
        wake: SignalWriter<'static, ()>,
        published: MeasuringPoint<13>,
        exception: MeasuringPoint<15>,
    ) -> Self {
        Self { records, wake, published, exception }
    }
}

/// Waits until this node knows the time of the cluster, without which it takes no part in hard real-time.
pub async fn synchronised(node: &mut impl Mutex<T = Node>) {
    while !node.lock(|node| node.clock().is_synchronised(clock::now())) {
        clock::delay_until(clock::now() + cluster::plan::SYNC.period).await;
    }
}

/// Reports exceptions as they come, for ever.
pub async fn report_exceptions(mut node: impl Mutex<T = Node>, mut reporter: impl Mutex<T = Reporter>) -> ! {
    loop {
        let exception =
            poll_fn(|context| node.lock(|node| node.half().poll_exception(context.waker()))).await;
        reporter.lock(|reporter| {
            reporter.exception.toggle();
            reporter.records.exception(&exception);
        });
        defmt::warn!("{}", exception);
    }
}
