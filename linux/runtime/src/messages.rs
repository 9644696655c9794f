//! Messages longer than a frame, on non real-time channels: the node cuts them into frames and puts those of others
//! together, whether anybody asks for them now or not.
//!
//! | bound | |
//! |---|---|
//! | bytes of a message | 1024 |
//! | messages of a channel that wait to be sent | [`WAITING_MESSAGES`](crate::WAITING_MESSAGES), one more is on its way |
//! | publishers of a channel whose messages arrive at the same time | [`MESSAGES_AT_ONCE`](crate::MESSAGES_AT_ONCE) |
//! | whole messages that wait for a subscriber | its [`Policy`] |
//! | until a message is given up of which nothing more comes | two seconds |

use std::collections::VecDeque;
use std::future::poll_fn;
use std::marker::PhantomData;
use std::task::Poll;

use cosmic_core::Subject;
use cosmic_core::event_layer::{
    self, Attributes, ChannelCounters, Content, Delivered, Filter, MessageChannel, Policy, PublishError,
    SubscribeError,
};
use cosmic_core::network::fragments::ReassemblyCounters;
use cosmic_core::time::Duration;

use crate::application::AnnounceError;
use crate::message_queues::{FRAMES, Inbox, MESSAGES_AT_ONCE, Outbox, TIME_OUT};
use crate::node::Node;

/// The right to publish messages on a channel. Given up when it is dropped; messages that wait to be sent are then
/// discarded, if it was the last one of the channel.
pub struct MessagePublisher<C> {
    node: Node,
    subject: Subject,
    content: PhantomData<fn(&C)>,
}

/// A subscription to a channel of messages. Given up when it is dropped, with the messages that wait for it.
pub struct MessageSubscriber<C> {
    node: Node,
    number: u64,
    content: PhantomData<fn() -> C>,
}

impl Node {
    /// Announces a channel of messages.
    ///
    /// # Errors
    /// [`AnnounceError`]
    pub fn announce_messages<C: Content, const LEN: usize, const PUBLISHERS: usize>(
        &self,
        channel: &MessageChannel<C, LEN, PUBLISHERS>,
    ) -> Result<MessagePublisher<C>, AnnounceError> {
        let (fragments, subject) = (channel.fragments(), channel.subject());
        self.shared().act(|core, _| {
            // What two publishers of a node send would be taken for one message.
            if let Some(outbox) = core.messages.outboxes.iter_mut().find(|outbox| outbox.subject == subject) {
                outbox.holders += 1;
                return Ok(());
            }
            let publication = core.half.announce(fragments).map_err(AnnounceError::Refused)?;
            core.messages.outboxes.push(Outbox {
                subject,
                publisher: Box::new(event_layer::MessagePublisher::new(publication)),
                waiting: VecDeque::new(),
                validity: match fragments.attributes() {
                    Attributes::NonRealTime(attributes) => attributes.validity,
                    Attributes::Soft(_) | Attributes::Hard(_) => None,
                },
                holders: 1,
                counters: ChannelCounters::default(),
            });
            Ok(())
        })?;
        Ok(MessagePublisher { node: self.clone(), subject, content: PhantomData })
    }

    /// Subscribes to a channel of messages. The policy is of whole messages.
    ///
    /// # Errors
    /// [`SubscribeError`]
    pub fn subscribe_messages<C: Content, const LEN: usize, const PUBLISHERS: usize>(
        &self,
        channel: &MessageChannel<C, LEN, PUBLISHERS>,
        policy: Policy,
    ) -> Result<MessageSubscriber<C>, SubscribeError> {
        const { assert!(PUBLISHERS <= MESSAGES_AT_ONCE, "a node on Linux has no place for so many publishers") };
        let number = self.shared().act(|core, _| {
            let fragments = channel.fragments();
            let subscription = core.half.subscribe_early(fragments, Filter::ALL, Policy::Fifo(FRAMES))?;
            core.messages.last_number += 1;
            core.messages.inboxes.push(Inbox {
                number: core.messages.last_number,
                subject: channel.subject(),
                subscriber: Box::new(event_layer::MessageSubscriber::new(subscription, TIME_OUT)),
                is_content: |bytes| C::decode(bytes).is_some(),
                waiting: VecDeque::new(),
                policy,
                waker: None,
                counters: ChannelCounters::default(),
            });
            Ok(core.messages.last_number)
        })?;
        Ok(MessageSubscriber { node: self.clone(), number, content: PhantomData })
    }
}

impl<C: Content> MessagePublisher<C> {
    /// Publishes a message. Never waits.
    ///
    /// # Errors
    /// [`PublishError::NotBound`]; [`PublishError::QueueFull`]: [`WAITING_MESSAGES`](crate::WAITING_MESSAGES) wait to be sent.
    pub fn publish(&self, content: &C) -> Result<(), PublishError> {
        self.publish_within(content, None)
    }

    /// Publishes a message of which nothing is sent any more when this span is over before it has begun; `None`: as the
    /// channel says.
    ///
    /// # Errors
    /// As [`publish`](Self::publish).
    pub fn publish_within(&self, content: &C, validity: Option<Duration>) -> Result<(), PublishError> {
        let mut bytes = vec![0; C::LEN];
        content.encode(&mut bytes);
        bytes.truncate(content.encoded_len());
        self.node.shared().act(|core, now| {
            let services = core.half.services();
            if services.tx_node().is_none() || services.etag_of(self.subject).is_none() {
                return Err(PublishError::NotBound);
            }
            let outbox = core.messages.outboxes.iter_mut().find(|outbox| outbox.subject == self.subject);
            let outbox = outbox.ok_or(PublishError::NotAnnounced)?;
            outbox.take(now, bytes, validity)
        })
    }

    /// Waits until the node has its TxNode and the channel its etag. Before that, publishing is refused.
    pub async fn bound(&self) {
        self.node.until_bound(self.subject).await;
    }

    /// Returns whether nothing waits to be sent.
    pub fn is_idle(&self) -> bool {
        self.node.shared().look(|core| {
            let outbox = core.messages.outboxes.iter().find(|outbox| outbox.subject == self.subject);
            outbox.is_none_or(|outbox| outbox.waiting.is_empty() && outbox.publisher.is_idle())
        })
    }

    /// So many messages of this node were not sent whole: they expired, or a frame of them was discarded. Wraps.
    pub fn discarded(&self) -> u32 {
        self.node.shared().look(|core| {
            let outbox = core.messages.outboxes.iter().find(|outbox| outbox.subject == self.subject);
            outbox.map_or(0, |outbox| outbox.publisher.discarded().wrapping_add(outbox.counters.discarded))
        })
    }

    /// The channel's subject.
    pub const fn subject(&self) -> Subject {
        self.subject
    }
}

impl<C> Drop for MessagePublisher<C> {
    fn drop(&mut self) {
        self.node.shared().act(|core, now| {
            let outboxes = &mut core.messages.outboxes;
            let Some(at) = outboxes.iter().position(|outbox| outbox.subject == self.subject) else { return };
            outboxes[at].holders -= 1;
            if outboxes[at].holders == 0 {
                let publication = outboxes.swap_remove(at).publisher.into_publication();
                for due in core.half.cancel_publication(publication) {
                    core.carry_out(due, now);
                }
            }
        });
    }
}

impl<C: Content> MessageSubscriber<C> {
    /// Waits for the next message. Cancelling the wait loses none.
    pub async fn next(&self) -> Delivered<C> {
        poll_fn(|context| {
            self.with(|inbox| match inbox.next() {
                Some(message) => Poll::Ready(message),
                None => {
                    inbox.waker = Some(context.waker().clone());
                    Poll::Pending
                }
            })
            .unwrap_or(Poll::Pending)
        })
        .await
    }

    /// The next message, if one has come.
    pub fn try_next(&self) -> Option<Delivered<C>> {
        self.with(Inbox::next)?
    }

    /// What was put together, and what was dropped because frames were missing.
    pub fn reassembly(&self) -> ReassemblyCounters {
        self.with(|inbox| *inbox.subscriber.counters()).unwrap_or_default()
    }

    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }

    fn with<R>(&self, look: impl FnOnce(&mut Inbox) -> R) -> Option<R> {
        let is_it = |inbox: &&mut Inbox| inbox.number == self.number;
        self.node.shared().look(|core| core.messages.inboxes.iter_mut().find(is_it).map(look))
    }
}

impl<C> Drop for MessageSubscriber<C> {
    fn drop(&mut self) {
        self.node.shared().act(|core, _| {
            let inboxes = &mut core.messages.inboxes;
            if let Some(at) = inboxes.iter().position(|inbox| inbox.number == self.number) {
                let inbox = inboxes.swap_remove(at);
                core.half.cancel_subscription(inbox.subscriber.into_subscription());
            }
        });
    }
}
