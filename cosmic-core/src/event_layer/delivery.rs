//! How a received frame becomes an event of a subscriber: into its queue by the subscriber's policy, and out of it.

use super::channel::{Policy, Subscriber};
use super::content::Content;
use super::filter::Context;
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

impl Subscriber {
    /// Queues an event by the subscriber's policy. Returns whether it replaced an earlier one.
    pub(super) fn queue<const N: usize>(
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
pub(super) fn decode<C: Content>(event: &Waiting, with_context: bool) -> Option<Delivered<C>> {
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
