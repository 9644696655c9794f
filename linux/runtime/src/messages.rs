//! Messages longer than a frame, on non real-time channels: the node cuts them into frames and puts those of others
//! together, whether anybody asks for them now or not.
//!
//! | bound | |
//! |---|---|
//! | bytes of a message | 1024 |
//! | messages of a channel that wait to be sent | [`WAITING_MESSAGES`], one more is on its way |
//! | publishers of a channel whose messages arrive at the same time | [`MESSAGES_AT_ONCE`] |
//! | whole messages that wait for a subscriber | its [`Policy`] |
//! | until a message is given up of which nothing more comes | two seconds |

use std::collections::VecDeque;
use std::future::poll_fn;
use std::marker::PhantomData;
use std::task::{Poll, Waker};

use cosmic_core::Subject;
use cosmic_core::can::{Id, Priority};
use cosmic_core::event_layer::{
    self, Attributes, ChannelCounters, Content, Context, Delivered, Depth, Filter, MessageChannel, Policy,
    PublishError, SubscribeError,
};
use cosmic_core::network::fragments::{MAX_MESSAGE_LEN, ReassemblyCounters};
use cosmic_core::time::{Duration, Instant};

use crate::application::AnnounceError;
use crate::node::Node;
use crate::shared::{Core, Half};

/// Messages of a channel that wait to be sent, beside the one that is.
pub const WAITING_MESSAGES: usize = 8;
/// So many nodes may send a message of several frames on one channel at the same time.
pub const MESSAGES_AT_ONCE: usize = 32;

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
    /// [`PublishError::NotBound`]; [`PublishError::QueueFull`]: [`WAITING_MESSAGES`] wait to be sent.
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

/// The messages of a node.
#[derive(Default)]
pub(crate) struct Messages {
    /// One for each channel.
    outboxes: Vec<Outbox>,
    inboxes: Vec<Inbox>,
    last_number: u64,
}

struct Outbox {
    subject: Subject,
    publisher: Box<event_layer::MessagePublisher<MAX_MESSAGE_LEN>>,
    /// With the instant from which on they are of no use.
    waiting: VecDeque<(Vec<u8>, Option<Instant>)>,
    validity: Option<Duration>,
    holders: usize,
    /// Of what happened here, not in the core.
    counters: ChannelCounters,
}

struct Inbox {
    number: u64,
    subject: Subject,
    subscriber: Box<event_layer::MessageSubscriber<MESSAGES_AT_ONCE, MAX_MESSAGE_LEN>>,
    is_content: fn(&[u8]) -> bool,
    waiting: VecDeque<Delivered<Vec<u8>>>,
    policy: Policy,
    waker: Option<Waker>,
    /// Of what happened here, not in the core.
    counters: ChannelCounters,
}

impl Messages {
    /// Takes what has arrived, and sends what can leave; at the end, calls of the core may be due. O(messages that are
    /// complete or waiting + frames that wait).
    pub(crate) fn attend(core: &mut Core, now: Instant) -> bool {
        let Core { half, messages, .. } = core;
        messages.inboxes.iter_mut().for_each(|inbox| inbox.receive(half, now));
        let mut dues = Vec::new();
        for outbox in &mut messages.outboxes {
            outbox.send(half, now, &mut dues);
        }
        let any = !dues.is_empty();
        dues.into_iter().for_each(|due| core.carry_out(due, now));
        any
    }

    /// When there is a message to be given up, if nothing happens before.
    pub(crate) fn next_wakeup(&self) -> Instant {
        let wakeups = self.inboxes.iter().map(|inbox| inbox.subscriber.next_wakeup());
        wakeups.min().unwrap_or(Instant::FAR_FUTURE)
    }

    /// What happened to whole messages of a channel, beside what the core counts of their frames.
    pub(crate) fn add_to(&self, subject: Subject, counters: &mut ChannelCounters) {
        let inboxes = self.inboxes.iter().filter(|it| it.subject == subject).map(|it| &it.counters);
        let outboxes = self.outboxes.iter().filter(|it| it.subject == subject).map(|it| &it.counters);
        for of_messages in inboxes.chain(outboxes) {
            counters.refused = counters.refused.wrapping_add(of_messages.refused);
            counters.discarded = counters.discarded.wrapping_add(of_messages.discarded);
            counters.published = counters.published.wrapping_add(of_messages.published);
            counters.overflowed = counters.overflowed.wrapping_add(of_messages.overflowed);
            counters.replaced = counters.replaced.wrapping_add(of_messages.replaced);
        }
    }
}

impl Outbox {
    fn take(
        &mut self,
        now: Instant,
        content: Vec<u8>,
        validity: Option<Duration>,
    ) -> Result<(), PublishError> {
        if self.waiting.len() >= WAITING_MESSAGES {
            self.counters.refused = self.counters.refused.wrapping_add(1);
            return Err(PublishError::QueueFull);
        }
        let expires_at = validity.or(self.validity).map(|validity| now + validity);
        self.waiting.push_back((content, expires_at));
        Ok(())
    }

    /// Ends: each turn starts a message that waits, or is the last.
    fn send(&mut self, half: &mut Half, now: Instant, dues: &mut Vec<cosmic_core::event_half::Due>) {
        loop {
            // Of a message that cannot be sent, the counters of its channel say so.
            if let Ok(due) = half.send_message(now, &mut self.publisher)
                && due.command().is_some()
            {
                dues.push(due);
            }
            if !self.publisher.is_idle() {
                return;
            }
            let Some((content, expires_at)) = self.waiting.pop_front() else { return };
            if expires_at.is_some_and(|expires_at| expires_at <= now) {
                // It counts as one event.
                self.counters.published = self.counters.published.wrapping_add(1);
                self.counters.discarded = self.counters.discarded.wrapping_add(1);
                continue;
            }
            // It is idle, and nothing longer is taken.
            let _ = self.publisher.start(&content);
        }
    }
}

impl Inbox {
    fn receive(&mut self, half: &mut Half, now: Instant) {
        loop {
            let is_content = self.is_content;
            let whole = half.poll_message(
                &mut self.subscriber,
                now,
                Waker::noop(),
                |_| (),
                |message| {
                    let id = Id::new(Priority::LEAST, message.publisher, message.etag);
                    is_content(message.content).then(|| (id, message.content.to_vec()))
                },
            );
            let Poll::Ready((id, content)) = whole else { return };
            let (context, publisher) = (Context::EMPTY, id.tx_node());
            self.put(Delivered { content, context, publisher, id, received_at: now });
        }
    }

    fn put(&mut self, message: Delivered<Vec<u8>>) {
        match self.policy {
            Policy::Latest => {
                let replaced = self.waiting.len();
                self.waiting.clear();
                self.counters.replaced = self.counters.replaced.wrapping_add(u32::from(replaced > 0));
            }
            Policy::Fifo(depth) | Policy::DeadlineOrder(depth) => {
                if self.waiting.len() >= usize::from(depth.get()) {
                    self.counters.overflowed = self.counters.overflowed.wrapping_add(1);
                    return;
                }
            }
        }
        self.waiting.push_back(message);
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }

    fn next<C: Content>(&mut self) -> Option<Delivered<C>> {
        let Delivered { content, context, publisher, id, received_at } = self.waiting.pop_front()?;
        // Only such bytes are taken.
        let content = C::decode(&content)?;
        Some(Delivered { content, context, publisher, id, received_at })
    }
}

/// Frames are put together as they come; so many may come between two looks.
const FRAMES: Depth = Depth::new(254).unwrap();
/// A message of which nothing more comes for so long is given up.
const TIME_OUT: Duration = Duration::from_secs(2);
