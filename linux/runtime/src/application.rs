//! What an application does on a channel: announces it, or subscribes to it, and what it then holds.

use std::fmt;
use std::future::poll_fn;

use cosmic_core::Subject;
use cosmic_core::client::AdmissionState;
use cosmic_core::event_layer::{
    self, Attributes, Channel, Content, Delivered, Event, Filter, Policy, Publication, PublishError,
    SubscribeError, Subscription,
};
use cosmic_core::protocol::AdmissionRefusal;

use crate::node::Node;

/// Why a channel cannot be announced.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AnnounceError {
    /// It is a hard real-time channel.
    HardRealTime,
    /// The middleware refuses it.
    Refused(event_layer::AnnounceError),
}

impl fmt::Display for AnnounceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::HardRealTime => f.write_str(
                "a node on Linux cannot publish on a hard real-time channel, for it has no clock that keeps to the \
                 slots of a calendar: subscribe to it, or publish on a soft real-time channel",
            ),
            Self::Refused(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for AnnounceError {}

impl Node {
    /// Announces a channel.
    ///
    /// # Errors
    /// [`AnnounceError`]; always for a hard real-time channel.
    pub fn announce<C: Content>(&self, channel: &Channel<C>) -> Result<Publisher<C>, AnnounceError> {
        if matches!(channel.attributes(), Attributes::Hard(_)) {
            return Err(AnnounceError::HardRealTime);
        }
        let publication = self.shared().act(|core, _| core.half.announce(channel));
        Ok(Publisher::new(self.clone(), channel, publication.map_err(AnnounceError::Refused)?))
    }

    /// Subscribes to all events of a channel.
    ///
    /// # Errors
    /// [`SubscribeError`]: no room, or a hard real-time channel that is not in the calendar.
    pub fn subscribe<C: Content>(
        &self,
        channel: &Channel<C>,
        policy: Policy,
    ) -> Result<Subscriber<C>, SubscribeError> {
        self.subscribe_filtered(channel, Filter::ALL, policy)
    }

    /// Subscribes to those events that pass the filter.
    ///
    /// # Errors
    /// As [`subscribe`](Self::subscribe).
    pub fn subscribe_filtered<C: Content>(
        &self,
        channel: &Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscriber<C>, SubscribeError> {
        let subscription = self.shared().act(|core, _| core.half.subscribe_early(channel, filter, policy))?;
        Ok(Subscriber::new(self.clone(), subscription))
    }
}

/// The right to publish on a channel. Given up when it is dropped; events that wait to be sent are then discarded, if
/// it was the last one of the channel.
pub struct Publisher<C> {
    node: Node,
    subject: Subject,
    /// `None` only while it is dropped.
    publication: Option<Publication<C>>,
}

impl<C: Content> Publisher<C> {
    pub(crate) fn new(node: Node, channel: &Channel<C>, publication: Publication<C>) -> Self {
        Self { node, subject: channel.subject(), publication: Some(publication) }
    }

    /// Publishes an event of now. Never waits.
    ///
    /// # Errors
    /// [`PublishError`]: the event is not sent.
    pub fn publish(&self, content: C) -> Result<(), PublishError> {
        self.publish_event(&Event::new(content))
    }

    /// Publishes an event with times or context of its own.
    ///
    /// # Errors
    /// [`PublishError`]: the event is not sent.
    pub fn publish_event(&self, event: &Event<C>) -> Result<(), PublishError> {
        let Some(publication) = &self.publication else { return Err(PublishError::NotAnnounced) };
        self.node.shared().act(|core, now| {
            let due = core.half.publish(now, publication, event)?;
            core.carry_out(due, now);
            Ok(())
        })
    }

    /// Waits until the node has its TxNode and the channel its etag. Before that, publishing is refused.
    pub async fn bound(&self) {
        self.node.until_bound(self.subject).await;
    }

    /// The channel's subject.
    pub const fn subject(&self) -> Subject {
        self.subject
    }

    /// Where the channel stands, if the plan does not know it and it is asked for; `None` for any other.
    pub fn admission(&self) -> Option<AdmissionState> {
        self.node.shared().look(|core| core.half.services().admission_of(self.subject))
    }

    /// Waits until the channel may be published: it is [bound](Self::bound), and admitted if the plan does not know it.
    ///
    /// # Errors
    /// Why it was refused. It is asked for again later, as long as this exists.
    pub async fn admitted(&self) -> Result<(), AdmissionRefusal> {
        self.bound().await;
        let decided = |_: &Node| match self.admission() {
            Some(AdmissionState::Waiting) => None,
            Some(AdmissionState::Refused(refusal)) => Some(Err(refusal)),
            Some(AdmissionState::Admitted(_)) | None => Some(Ok(())),
        };
        self.node.until(decided).await
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }
}

impl<C> Drop for Publisher<C> {
    fn drop(&mut self) {
        if let Some(publication) = self.publication.take() {
            self.node.shared().act(|core, now| {
                for due in core.half.cancel_publication(publication) {
                    core.carry_out(due, now);
                }
            });
        }
    }
}

/// A subscription to a channel. Given up when it is dropped, with the events that wait for it.
pub struct Subscriber<C> {
    node: Node,
    /// `None` only while it is dropped.
    subscription: Option<Subscription<C>>,
}

impl<C: Content> Subscriber<C> {
    pub(crate) const fn new(node: Node, subscription: Subscription<C>) -> Self {
        Self { node, subscription: Some(subscription) }
    }

    /// Waits for the next event. Cancelling the wait loses none.
    pub async fn next(&self) -> Delivered<C> {
        let Some(subscription) = &self.subscription else { return std::future::pending().await };
        poll_fn(|context| self.node.shared().look(|core| core.half.poll_next(subscription, context.waker())))
            .await
    }

    /// The next event, if there is one.
    pub fn try_next(&self) -> Option<Delivered<C>> {
        let subscription = self.subscription.as_ref()?;
        self.node.shared().look(|core| core.half.next(subscription))
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }
}

impl<C> Drop for Subscriber<C> {
    fn drop(&mut self) {
        if let Some(subscription) = self.subscription.take() {
            self.node.shared().act(|core, _| core.half.cancel_subscription(subscription));
        }
    }
}
