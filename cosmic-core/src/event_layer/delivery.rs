//! How a received frame becomes an event of a subscriber: into its queue by the subscriber's policy, and out of it.

use super::channel::{NONE, Policy, Route, Subscriber, Subscription};
use super::content::Content;
use super::declared::Listed;
use super::filter::Context;
use super::layer::{EventLayer, key_of_hard};
use super::pool::{Pool, PoolFull, Waiting};
use crate::can::{Frame, Id, TxNode};
use crate::network::soft::{PriorityMap, Tag};
use crate::time::Instant;
use crate::uid::Subject;

/// An event as a subscriber gets it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Delivered<C> {
    /// What was published.
    pub content: C,
    /// The attributes of context.
    pub context: Context,
    /// Who published it.
    pub publisher: TxNode,
    /// The identifier of its frame. The priority of a soft real-time event says what was left then to its deadline.
    pub id: Id,
    /// When its frame arrived; for a local publication, when it was published; for a hard real-time
    /// event, when it became visible.
    pub received_at: Instant,
}

/// What a received frame is.
#[derive(Clone, Copy, Debug)]
#[must_use]
pub(crate) enum Received {
    /// It belongs to no channel that is known here.
    Foreign,
    Delivered,
    /// It belongs to this channel, and is still to be delivered.
    Undelivered(Tag),
}

/// What happened to a frame that was offered to the layer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[must_use]
pub(crate) enum Accepted {
    /// It belongs to no channel that is subscribed to here.
    Foreign,
    Delivered,
    /// It belongs to the channel, and this went wrong.
    Overflowed(Subject),
    Malformed(Subject),
    Unplanned(Subject),
}

impl<const CHANNELS: usize, const SUBSCRIPTIONS: usize, const EVENTS: usize, D: Listed>
    EventLayer<CHANNELS, SUBSCRIPTIONS, EVENTS, D>
{
    /// A frame has arrived. It is delivered here, if that can be done without a closer look; otherwise
    /// that is left to [`deliver`](Self::deliver). O(1).
    ///
    /// A frame with the etag of a hard real-time channel is foreign: events of such channels come out of the
    /// HRT message buffers at their instant, and in no other way.
    #[inline]
    pub(crate) fn receive(&mut self, frame: &Frame, received_at: Instant) -> Received {
        self.receive_as::<true>(frame.id.etag().get().into(), frame, received_at)
    }

    /// As [`receive`](Self::receive), for an event that has come out of an HRT message buffer.
    #[inline]
    pub(crate) fn receive_hard(&mut self, frame: &Frame, received_at: Instant) -> Received {
        self.receive_as::<false>(key_of_hard(frame.id.etag()), frame, received_at)
    }

    /// `MAY_BE_AWAITED`: not a hard real-time event, whose absence the calendar notices.
    #[inline(always)]
    fn receive_as<const MAY_BE_AWAITED: bool>(
        &mut self,
        key: u32,
        frame: &Frame,
        received_at: Instant,
    ) -> Received {
        let Some(route) = self.by_etag.get(key).map(Route::decode) else { return Received::Foreign };
        let Some(subscriber) = self.subscribers.get_mut(usize::from(route.only)) else {
            return Received::Undelivered(route.tag);
        };
        let list = &mut subscriber.list;
        if list.len() >= subscriber.takes_any {
            return Received::Undelivered(route.tag);
        }
        if D::RATES && MAY_BE_AWAITED && route.is_awaited {
            match self.channels.get_mut(usize::from(route.tag.0)) {
                Some(Some(entry)) if entry.awaited_since <= received_at => entry.awaited_since = received_at,
                // The next is overdue earlier than was thought.
                _ => return Received::Undelivered(route.tag),
            }
        }
        if list.push(&mut self.pool, frame, received_at).is_err() {
            return Received::Undelivered(route.tag);
        }
        subscriber.note_delivery();
        Received::Delivered
    }

    /// Gives an event to the subscribers of its channel: O(1) for each, or O(length) of the queue of one
    /// who wants the earliest deadline first.
    #[inline(never)]
    pub(crate) fn deliver(&mut self, tag: Tag, frame: &Frame, received_at: Instant) -> Accepted {
        let Some(Some(entry)) = self.channels.get_mut(usize::from(tag.0)) else { return Accepted::Foreign };
        let mut at = entry.first_subscription;
        if at == NONE {
            return Accepted::Foreign;
        }
        if entry.publishers.is_some_and(|publishers| !publishers.contains(frame.id.tx_node())) {
            entry.counters.unplanned = entry.counters.unplanned.wrapping_add(1);
            return Accepted::Unplanned(entry.declared().subject);
        }
        let mut context = Context::EMPTY;
        if entry.has_context() {
            let Some((carried, _)) = Context::split(&frame.payload) else {
                entry.counters.malformed = entry.counters.malformed.wrapping_add(1);
                return Accepted::Malformed(entry.declared().subject);
            };
            context = carried;
        }
        if entry.is_awaited() {
            entry.awaited_since = received_at;
            self.first_overdue = self.first_overdue.min(entry.overdue_at());
        }
        let mut accepted = Accepted::Delivered;
        while let Some(subscriber) = self.subscribers.get_mut(usize::from(at)) {
            let next = subscriber.next;
            if subscriber.list.len() < subscriber.takes_any
                && subscriber.list.push(&mut self.pool, frame, received_at).is_ok()
            {
                subscriber.note_delivery();
            } else {
                accepted = self.offer((tag, at), (frame, received_at), &context).unwrap_or(accepted);
            }
            at = next;
        }
        accepted
    }

    /// Gives an event to a subscriber who does not take every one, or has no room for it. Says what went wrong.
    // Seldom, so that the way of an event that every subscriber takes is short.
    #[cold]
    fn offer(
        &mut self,
        (tag, at): (Tag, u8),
        (frame, received_at): (&Frame, Instant),
        context: &Context,
    ) -> Option<Accepted> {
        let entry = self.channels.get_mut(usize::from(tag.0))?.as_mut()?;
        let subscriber = self.subscribers.get_mut(usize::from(at))?;
        let counters = &mut entry.counters;
        if D::CONTEXTS && !subscriber.filter.matches(context) {
            counters.filtered = counters.filtered.wrapping_add(1);
            return None;
        }
        match subscriber.queue(&mut self.pool, frame, received_at, self.map) {
            Ok(replaced) => {
                counters.replaced = counters.replaced.wrapping_add(replaced.into());
                subscriber.note_delivery();
                None
            }
            Err(PoolFull) => {
                counters.overflowed = counters.overflowed.wrapping_add(1);
                Some(Accepted::Overflowed(entry.declared.borrow().subject))
            }
        }
    }

    /// Fetches the next event of a subscription; if its content is no value of the channel's type, only
    /// when it arrived. O(1).
    #[inline]
    pub(crate) fn next<C: Content>(
        &mut self,
        subscription: &Subscription<C>,
    ) -> Option<Result<Delivered<C>, Instant>> {
        let subscriber = self.subscribers.get_mut(usize::from(subscription.index))?;
        let event = subscriber.list.pop(&mut self.pool)?;
        Some(decode(event, D::CONTEXTS && subscription.context).ok_or(event.received_at))
    }
}

impl Subscriber {
    /// Queues an event by the subscriber's policy. Returns whether it replaced an earlier one.
    fn queue<const N: usize>(
        &mut self,
        pool: &mut Pool<N>,
        frame: &Frame,
        received_at: Instant,
        map: PriorityMap,
    ) -> Result<bool, PoolFull> {
        let full = self.list.len() >= self.policy.depth();
        match self.policy {
            Policy::Fifo(_) if !full => self.list.push(pool, frame, received_at).map(|()| false),
            Policy::Latest => {
                let replaced = full && self.list.pop(pool).is_some();
                self.list.push(pool, frame, received_at).map(|()| replaced)
            }
            Policy::DeadlineOrder(_) if !full => {
                self.list.insert(pool, frame, received_at, map.step()).map(|()| false)
            }
            _ => Err(PoolFull),
        }
    }
}

#[inline]
fn decode<C: Content>(event: &Waiting, with_context: bool) -> Option<Delivered<C>> {
    let (context, content) = if with_context {
        let (context, content) = Context::split(&event.payload())?;
        (context, C::decode(content.as_slice())?)
    } else {
        (Context::EMPTY, C::decode(event.as_slice())?)
    };
    // The identifier whole: to take the priority out costs an instruction more, whether anybody wants it or not.
    let (publisher, id) = (event.id.tx_node(), event.id);
    Some(Delivered { content, context, publisher, id, received_at: event.received_at })
}
