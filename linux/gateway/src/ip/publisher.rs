//! The right to publish, on IP.

use std::marker::PhantomData;

use cosmic_core::can::Payload;
use cosmic_core::event_layer::{Attributes, Channel, Content, Event, PublishError};
use cosmic_core::protocol::Class;
use cosmic_core::time::{Duration, Instant};

use super::outlet::Outlet;
use super::{Node, now};

/// The right to publish on a channel. Given up when it is dropped.
pub struct Publisher<C> {
    pub(super) outlet: Outlet,
    pub(super) channel: Channel<C>,
}

impl<C: Content> Publisher<C> {
    /// Publishes an event of now. Never waits. If nobody subscribes, it goes nowhere.
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
        let now = now();
        let (deadline, validity, class) = match self.channel.attributes() {
            Attributes::Soft(soft) => (Some(soft.deadline), Some(soft.validity), Class::Soft),
            Attributes::NonRealTime(quality) => (None, quality.validity, Class::NonRealTime),
            Attributes::Hard(_) => return Err(PublishError::HardDeadline),
        };
        let left = |at: Option<Instant>, of_channel: Option<Duration>| match at {
            Some(at) if at <= now => Err(PublishError::Deadline),
            Some(at) => Ok(Some(at.saturating_since(now))),
            None => Ok(of_channel),
        };
        let (to_deadline, to_expiry) = (left(event.deadline, deadline)?, left(event.expires_at, validity)?);
        let to_expiry = match (to_deadline, to_expiry, event.expires_at) {
            (Some(deadline), Some(expiry), Some(_)) if expiry < deadline => {
                return Err(PublishError::Deadline);
            }
            (Some(deadline), Some(expiry), None) => Some(expiry.max(deadline)),
            (_, expiry, _) => expiry,
        };
        let content = self.encode(event)?.as_slice().to_vec();
        self.outlet.send(class, to_deadline, to_expiry, content)
    }

    fn encode(&self, event: &Event<C>) -> Result<Payload, PublishError> {
        let mut bytes = [0; Payload::MAX_LEN];
        event.content.encode(&mut bytes[..C::LEN]);
        let content = Payload::new(&bytes[..event.content.encoded_len()]).ok_or(PublishError::TooLong)?;
        if self.channel.has_context() {
            event.context.prepend(&content).map_err(|_| PublishError::TooLong)
        } else if event.context.presence() != 0 {
            Err(PublishError::TooLong)
        } else {
            Ok(content)
        }
    }

    /// Returns whether somebody subscribes.
    pub fn is_wanted(&self) -> bool {
        self.outlet.is_wanted()
    }

    /// Waits until somebody subscribes.
    pub async fn wanted(&self) {
        self.outlet.wanted().await;
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.outlet.node
    }
}

/// The right to publish messages on a channel. Given up when it is dropped.
pub struct MessagePublisher<C> {
    outlet: Outlet,
    validity: Option<Duration>,
    content: PhantomData<fn(&C)>,
}

impl<C: Content> MessagePublisher<C> {
    pub(super) fn new(outlet: Outlet, fragments: &Channel<Payload>) -> Self {
        let validity = match fragments.attributes() {
            Attributes::NonRealTime(quality) => quality.validity,
            Attributes::Soft(_) | Attributes::Hard(_) => None,
        };
        Self { outlet, validity, content: PhantomData }
    }

    /// Publishes a message. Never waits. If nobody subscribes, it goes nowhere.
    ///
    /// # Errors
    /// [`PublishError`]: the message is not sent.
    pub fn publish(&self, content: &C) -> Result<(), PublishError> {
        self.publish_within(content, None)
    }

    /// Publishes a message that is of no use any more when this span is over; `None`: as the channel says.
    ///
    /// # Errors
    /// [`PublishError`]: the message is not sent.
    pub fn publish_within(&self, content: &C, validity: Option<Duration>) -> Result<(), PublishError> {
        let mut bytes = vec![0; C::LEN];
        content.encode(&mut bytes);
        bytes.truncate(content.encoded_len());
        self.outlet.send(Class::NonRealTime, None, validity.or(self.validity), bytes)
    }

    /// Returns whether somebody subscribes.
    pub fn is_wanted(&self) -> bool {
        self.outlet.is_wanted()
    }

    /// Waits until somebody subscribes.
    pub async fn wanted(&self) {
        self.outlet.wanted().await;
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.outlet.node
    }
}
