//! The events of a channel, whichever it carries: of a frame, or messages of several.

use cosmic_core::can::Payload;
use cosmic_core::event_layer::{Bytes, Delivered, Policy, SubscribeError};
use cosmic_linux::{MessageSubscriber, Node, Subscriber};

use crate::quality::{Declared, LONGEST_MESSAGE};

/// A subscription to a channel that is [declared](Declared) as bytes.
pub enum Events {
    /// Events of a frame.
    Frames(Subscriber<Payload>),
    /// Messages.
    Messages(MessageSubscriber<Bytes<LONGEST_MESSAGE>>),
}

impl Events {
    /// Subscribes.
    ///
    /// # Errors
    /// [`SubscribeError`]
    pub fn of(node: &Node, channel: &Declared, policy: Policy) -> Result<Self, SubscribeError> {
        match channel {
            Declared::Events(channel) => node.subscribe(channel, policy).map(Self::Frames),
            Declared::Messages(channel) => node.subscribe_messages(channel, policy).map(Self::Messages),
        }
    }

    /// Waits for the next one. Cancelling the wait loses none.
    pub async fn next(&self) -> Delivered<Vec<u8>> {
        match self {
            Self::Frames(subscriber) => {
                let event = subscriber.next().await;
                of_bytes(&event, event.content.as_slice())
            }
            Self::Messages(subscriber) => {
                let message = subscriber.next().await;
                of_bytes(&message, message.content.as_slice())
            }
        }
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        match self {
            Self::Frames(subscriber) => subscriber.node(),
            Self::Messages(subscriber) => subscriber.node(),
        }
    }
}

fn of_bytes<C>(event: &Delivered<C>, content: &[u8]) -> Delivered<Vec<u8>> {
    let Delivered { context, publisher, id, received_at, .. } = *event;
    Delivered { content: content.to_vec(), context, publisher, id, received_at }
}
