//! From an event to what leaves the node.

use super::attributes::Attributes;
use super::channel::Entry;
use super::content::Content;
use super::declared::Listed;
use super::filter::Context;
use super::gate::Gate;
use super::layer::EventLayer;
use crate::can::{Frame, Payload, Priority};
use crate::network::hard::BufferId;
use crate::network::soft::{Outgoing, Tag};
use crate::time::Instant;

/// Why an event was not published. It has been counted, in
/// [`ChannelCounters::refused`](super::ChannelCounters::refused), if the channel still exists.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PublishError {
    /// The publication has been cancelled.
    NotAnnounced,
    /// The broker has not told the channel's etag, or the node's TxNode, yet.
    NotBound,
    /// The deadline has passed, or the event expires before it.
    Deadline,
    /// A hard real-time event has no deadline of its own: the calendar has.
    HardDeadline,
    /// Content and context together are longer than a frame, or than the slot of the calendar; or the
    /// channel was declared without context.
    TooLong,
    /// The queue towards the bus is full.
    QueueFull,
    /// The channel is not in the plan, and the broker's node has not [admitted](crate::admission) it: not yet, or it said why
    /// not.
    NotAdmitted,
    /// Events come more often than the channel's [rate](super::EventRate) says. The bus is protected from that.
    TooFast,
}

/// An event as an application publishes it.
///
/// ```
/// use cosmic_core::event_layer::Event;
/// use cosmic_core::time::{Duration, Instant};
///
/// let now = Instant::EPOCH;
/// let event = Event::new(21_i16).deadline(now + Duration::from_millis(5));
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Event<C> {
    /// What is published.
    pub content: C,
    /// The attributes of context.
    pub context: Context,
    /// When it should have been sent; `None`: as the channel says. Not for hard real-time events.
    pub deadline: Option<Instant>,
    /// When it is of no use any more; `None`: as the channel says. Not for hard real-time events.
    pub expires_at: Option<Instant>,
}

impl<C> Event<C> {
    /// An event with the channel's own quality and no context.
    pub const fn new(content: C) -> Self {
        Self { content, context: Context::EMPTY, deadline: None, expires_at: None }
    }

    /// With this transmission deadline.
    pub fn deadline(self, deadline: Instant) -> Self {
        Self { deadline: Some(deadline), ..self }
    }

    /// With this expiration.
    pub fn expires_at(self, expires_at: Instant) -> Self {
        Self { expires_at: Some(expires_at), ..self }
    }

    /// With these attributes of context.
    pub fn context(self, context: Context) -> Self {
        Self { context, ..self }
    }
}

/// What an event states of itself.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Quality {
    pub(crate) context: Context,
    pub(crate) deadline: Option<Instant>,
    pub(crate) expires_at: Option<Instant>,
}

impl Quality {
    /// The channel's own, and no context.
    pub(crate) const PLAIN: Self = Self { context: Context::EMPTY, deadline: None, expires_at: None };

    #[inline]
    pub(crate) fn of<C>(event: &Event<C>) -> Self {
        Self { context: event.context, deadline: event.deadline, expires_at: event.expires_at }
    }

    #[inline]
    pub(crate) const fn is_plain(&self) -> bool {
        self.deadline.is_none() && self.expires_at.is_none() && self.context.presence() == 0
    }
}

/// The bytes of a content.
#[inline]
pub(crate) fn encode<C: Content>(content: &C) -> Payload {
    let mut bytes = [0; Payload::MAX_LEN];
    // No channel has a content that is longer than a payload.
    if let Some(bytes) = bytes.get_mut(..C::LEN) {
        content.encode(bytes);
    }
    Payload::truncated(bytes, content.encoded_len())
}

/// Where a published event goes; the owner of the layer takes it there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[must_use]
pub enum Published {
    /// Into this HRT message buffer.
    Hard(BufferId, Payload),
    /// To the soft real-time queue.
    Soft(Outgoing),
    /// To the non real-time queue.
    NonRealTime(Outgoing),
}

impl<const CHANNELS: usize, const SUBSCRIPTIONS: usize, const EVENTS: usize, D: Listed>
    EventLayer<CHANNELS, SUBSCRIPTIONS, EVENTS, D>
{
    /// What an event becomes on its way. O(1).
    // What comes out is taken apart again by the only caller.
    #[inline(always)]
    pub(crate) fn publish(
        &mut self,
        now: Instant,
        tag: Tag,
        mut payload: Payload,
        event: &Quality,
    ) -> Result<Published, PublishError> {
        let Some(Some(entry)) = self.channels.get_mut(usize::from(tag.0)) else {
            return Err(PublishError::NotAnnounced);
        };
        let Some(id) = entry.outlet.id(Priority::SOFT_MOST_URGENT) else { return Err(entry.why_closed()) };
        if entry.has_context() {
            payload = event.context.prepend(&payload).map_err(|_| PublishError::TooLong)?;
        } else if event.context.presence() != 0 {
            return Err(PublishError::TooLong);
        }
        let published = match entry.declared().attributes {
            Attributes::Hard(_) => {
                if event.deadline.is_some() || event.expires_at.is_some() {
                    return Err(PublishError::HardDeadline);
                }
                Published::Hard(entry.buffer.ok_or(PublishError::NotAnnounced)?, payload)
            }
            Attributes::Soft(soft) => {
                let deadline = event.deadline.unwrap_or(now + soft.deadline);
                let expires_at = event.expires_at.unwrap_or(now + soft.validity).max(deadline);
                let frame = Frame::new(id, payload);
                check_deadline(now, deadline, event.expires_at)?;
                Published::Soft(Outgoing { tag, frame, deadline, expires_at })
            }
            Attributes::NonRealTime(quality) => {
                let deadline = event.deadline.unwrap_or(Instant::FAR_FUTURE);
                let validity = quality.validity.map_or(Instant::FAR_FUTURE, |validity| now + validity);
                let expires_at = event.expires_at.unwrap_or(validity);
                let frame = Frame::new(id.with_priority(quality.importance.priority()), payload);
                check_deadline(now, deadline.min(expires_at), event.expires_at)?;
                Published::NonRealTime(Outgoing { tag, frame, deadline, expires_at })
            }
        };
        entry.counters.published = entry.counters.published.wrapping_add(1);
        Ok(published)
    }
}

impl<D> Entry<D> {
    /// Why nothing can be published, as far as is known without the channel's rate.
    #[cold]
    const fn why_closed(&self) -> PublishError {
        match (self.announcements, self.etag, self.gate) {
            (0, ..) => PublishError::NotAnnounced,
            (_, Some(_), Gate::Closed) => PublishError::NotAdmitted,
            _ => PublishError::NotBound,
        }
    }
}

/// An event that the application gave a time of its own must not be late from the start.
#[inline]
fn check_deadline(now: Instant, deadline: Instant, expires_at: Option<Instant>) -> Result<(), PublishError> {
    let expired = expires_at.is_some_and(|expires_at| expires_at < deadline);
    if deadline <= now || expired { Err(PublishError::Deadline) } else { Ok(()) }
}
