//! The way of a channel's events onto the network.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use cosmic_core::event_layer::{Attributes, Channel, Content, PublishError};
use cosmic_core::protocol::{Class, LayoutHash};
use cosmic_core::time::Duration;
use tokio::sync::Notify;
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;

use super::{IpError, Node};
use crate::clock::Reading;
use crate::counters::Outcome;
use crate::encoding::Envelope;
use crate::network::failed;

pub(super) struct Outlet {
    pub(super) node: Node,
    layout: LayoutHash,
    publisher: zenoh::pubsub::Publisher<'static>,
    wanted: Arc<(AtomicBool, Notify)>,
    sequence: AtomicU64,
}

impl Outlet {
    pub(super) async fn open<C: Content>(node: &Node, channel: &Channel<C>) -> Result<Self, IpError> {
        let network = &node.inner.network;
        let key = network.keys.event(channel.subject(), &node.inner.name);
        let soft = matches!(channel.attributes(), Attributes::Soft(_));
        let publisher = network.session.declare_publisher(key).allowed_destination(Locality::Remote);
        let publisher = publisher
            .congestion_control(CongestionControl::Drop)
            .priority(if soft { Priority::RealTime } else { Priority::Data })
            .express(soft);
        let publisher = publisher.await.map_err(|error| failed(&error))?;
        let wanted = Arc::new((AtomicBool::new(false), Notify::new()));
        let told = Arc::clone(&wanted);
        let listener = publisher.matching_listener().callback(move |status| {
            told.0.store(status.matching(), Ordering::Relaxed);
            told.1.notify_waiters();
        });
        listener.background().await.map_err(|error| failed(&error))?;
        if publisher.matching_status().await.map_err(|error| failed(&error))?.matching() {
            wanted.0.store(true, Ordering::Relaxed);
        }
        let (node, layout) = (node.clone(), channel.layout());
        Ok(Self { node, layout, publisher, wanted, sequence: AtomicU64::new(0) })
    }

    /// Sends it with these times that are left of it.
    pub(super) fn send(
        &self,
        class: Class,
        to_deadline: Option<Duration>,
        to_expiry: Option<Duration>,
        content: Vec<u8>,
    ) -> Result<(), PublishError> {
        // A number is drawn for what is sent, or the others would miss it.
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let (layout, sender) = (self.layout, self.node.inner.network.sender);
        let sent_at = Reading::now();
        let envelope = Envelope {
            class,
            node: None,
            layout,
            sender,
            sequence,
            sent_at,
            to_deadline,
            to_expiry,
            content,
        };
        let put = self.publisher.put(envelope.encode()).wait();
        let outcome = if put.is_ok() { Outcome::Forwarded } else { Outcome::NotSent };
        self.node.inner.outgoing.count(outcome);
        put.map_err(|_| PublishError::QueueFull)
    }

    pub(super) fn is_wanted(&self) -> bool {
        self.wanted.0.load(Ordering::Relaxed)
    }

    pub(super) async fn wanted(&self) {
        loop {
            let told = self.wanted.1.notified();
            if self.is_wanted() {
                return;
            }
            told.await;
        }
    }
}
