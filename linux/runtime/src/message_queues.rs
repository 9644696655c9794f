//! Messages of a node that wait: to be sent, frame by frame, and for whoever subscribes.

use std::collections::VecDeque;
use std::task::{Poll, Waker};

use cosmic_core::Subject;
use cosmic_core::can::{Id, Priority};
use cosmic_core::event_half::Due;
use cosmic_core::event_layer::{
    self, ChannelCounters, Content, Context, Delivered, Depth, Policy, PublishError,
};
use cosmic_core::network::fragments::MAX_MESSAGE_LEN;
use cosmic_core::time::{Duration, Instant};

use crate::half::Half;

/// Messages of a channel that wait to be sent, beside the one that is.
pub const WAITING_MESSAGES: usize = 8;
/// So many nodes may send a message of several frames on one channel at the same time.
pub const MESSAGES_AT_ONCE: usize = 32;

/// The messages of a node.
#[derive(Default)]
pub(crate) struct Messages {
    /// One for each channel.
    pub(crate) outboxes: Vec<Outbox>,
    pub(crate) inboxes: Vec<Inbox>,
    pub(crate) last_number: u64,
}

pub(crate) struct Outbox {
    pub(crate) subject: Subject,
    pub(crate) publisher: Box<event_layer::MessagePublisher<MAX_MESSAGE_LEN>>,
    /// With the instant from which on they are of no use.
    pub(crate) waiting: VecDeque<(Vec<u8>, Option<Instant>)>,
    pub(crate) validity: Option<Duration>,
    pub(crate) holders: usize,
    /// Of what happened here, not in the core.
    pub(crate) counters: ChannelCounters,
}

pub(crate) struct Inbox {
    pub(crate) number: u64,
    pub(crate) subject: Subject,
    pub(crate) subscriber: Box<event_layer::MessageSubscriber<MESSAGES_AT_ONCE, MAX_MESSAGE_LEN>>,
    pub(crate) is_content: fn(&[u8]) -> bool,
    pub(crate) waiting: VecDeque<Delivered<Vec<u8>>>,
    pub(crate) policy: Policy,
    pub(crate) waker: Option<Waker>,
    /// Of what happened here, not in the core.
    pub(crate) counters: ChannelCounters,
}

impl Messages {
    /// Takes what has arrived, and sends what can leave; what is due then is to be carried out. O(messages that are
    /// complete or waiting + frames that wait).
    pub(crate) fn attend(&mut self, half: &mut Half, now: Instant) -> Vec<Due> {
        self.inboxes.iter_mut().for_each(|inbox| inbox.receive(half, now));
        let mut dues = Vec::new();
        for outbox in &mut self.outboxes {
            outbox.send(half, now, &mut dues);
        }
        dues
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
    pub(crate) fn take(
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
    fn send(&mut self, half: &mut Half, now: Instant, dues: &mut Vec<Due>) {
        loop {
            let (before, _) = self.publisher.last_fragment();
            // Of a message that cannot be sent, the counters of its channel say so. A frame that waits behind another one
            // is due without a command: the core is to be asked anew when to look at it.
            if let Ok(due) = half.send_message(now, &mut self.publisher)
                && self.publisher.last_fragment().0 != before
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

    pub(crate) fn next<C: Content>(&mut self) -> Option<Delivered<C>> {
        let Delivered { content, context, publisher, id, received_at } = self.waiting.pop_front()?;
        // Only such bytes are taken.
        let content = C::decode(&content)?;
        Some(Delivered { content, context, publisher, id, received_at })
    }
}

/// Frames are put together as they come; so many may come between two looks.
pub(crate) const FRAMES: Depth = Depth::new(254).unwrap();
/// A message of which nothing more comes for so long is given up.
pub(crate) const TIME_OUT: Duration = Duration::from_secs(2);
