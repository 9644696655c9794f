//! Where received events wait for their subscribers: one pool for all queues of a node.

use crate::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use crate::time::{Duration, Instant};

/// An event as it waits in a queue: 24 bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Waiting {
    /// When its frame arrived; for a local publication, when it was published; for a hard real-time
    /// event, when it became visible.
    pub(crate) received_at: Instant,
    /// Its priority says, with the time of arrival, when the deadline is.
    pub(crate) id: Id,
    /// The payload of its frame, taken apart so that `next` finds room.
    bytes: [u8; Payload::MAX_LEN],
    len: u8,
    /// The next place of the same queue, or of the free places. Behind the last of a queue it means
    /// nothing; the number of places ends the free ones.
    next: u8,
}

impl Waiting {
    /// Attributes of context, if the channel has them, and content.
    #[inline]
    #[allow(clippy::indexing_slicing, reason = "`min` keeps it within the bytes")]
    pub(crate) fn as_slice(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len).min(Payload::MAX_LEN)]
    }

    /// The payload of the frame that brought it.
    pub(crate) fn payload(&self) -> Payload {
        Payload::truncated(self.bytes, self.len.into())
    }
}

/// The deadline as a frame tells it: one step for each priority.
#[expect(clippy::arithmetic_side_effects, reason = "a step is at most 17 ms")]
fn deadline(id: Id, received_at: Instant, step: Duration) -> Instant {
    received_at + Duration::from_ticks(u64::from(id.priority().get()) * step.as_ticks())
}

/// Room for `N` ≤ 255 events.
#[derive(Clone, Debug)]
pub(super) struct Pool<const N: usize> {
    places: [Waiting; N],
    free: u8,
}

/// The queue of one subscription: a list in the pool.
#[derive(Clone, Debug)]
pub(super) struct List {
    first: u8,
    last: u8,
    len: u8,
}

/// The pool has no room.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct PoolFull;

impl<const N: usize> Pool<N> {
    #[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
    #[expect(clippy::arithmetic_side_effects, reason = "at most 255 places, which was asserted")]
    pub(super) const fn new() -> Self {
        const { assert!(N > 0 && N <= 255, "a node has room for 1..=255 waiting events") };
        let nothing = Waiting {
            received_at: Instant::EPOCH,
            id: Id::new(Priority::LEAST, TxNode::MIN, Etag::BOUND_LAST),
            bytes: [0; Payload::MAX_LEN],
            len: 0,
            next: 0,
        };
        let mut places = [nothing; N];
        let mut at = 0;
        while at < N {
            places[at].next = at as u8 + 1;
            at += 1;
        }
        Self { places, free: 0 }
    }

    #[inline]
    fn allocate(&mut self, frame: &Frame, received_at: Instant) -> Result<u8, PoolFull> {
        let at = self.free;
        let place = self.places.get_mut(usize::from(at)).ok_or(PoolFull)?;
        self.free = place.next;
        place.received_at = received_at;
        place.id = frame.id;
        place.bytes = frame.payload.padded();
        place.len = frame.payload.len() as u8;
        Ok(at)
    }

    #[inline]
    fn link(&mut self, from: u8, to: u8) {
        if let Some(place) = self.places.get_mut(usize::from(from)) {
            place.next = to;
        }
    }
}

impl List {
    pub(super) const fn new() -> Self {
        Self { first: 0, last: 0, len: 0 }
    }

    #[inline]
    pub(super) const fn len(&self) -> u8 {
        self.len
    }

    /// Adds an event at the end. O(1).
    #[inline]
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "each event has a place, of which there are 255 at most"
    )]
    pub(super) fn push<const N: usize>(
        &mut self,
        pool: &mut Pool<N>,
        frame: &Frame,
        received_at: Instant,
    ) -> Result<(), PoolFull> {
        let at = pool.allocate(frame, received_at)?;
        if self.len == 0 {
            self.first = at;
        } else {
            pool.link(self.last, at);
        }
        self.last = at;
        self.len += 1;
        Ok(())
    }

    /// Adds an event before the first with a later deadline. O(length).
    pub(super) fn insert<const N: usize>(
        &mut self,
        pool: &mut Pool<N>,
        frame: &Frame,
        received_at: Instant,
        step: Duration,
    ) -> Result<(), PoolFull> {
        let due = deadline(frame.id, received_at, step);
        let mut before = None;
        let mut next = self.first;
        for _ in 0..self.len {
            match pool.places.get(usize::from(next)) {
                Some(there) if deadline(there.id, there.received_at, step) <= due => {
                    before = Some(next);
                    next = there.next;
                }
                _ => return self.insert_at(pool, (before, next), frame, received_at),
            }
        }
        self.push(pool, frame, received_at)
    }

    #[expect(
        clippy::arithmetic_side_effects,
        reason = "each event has a place, of which there are 255 at most"
    )]
    fn insert_at<const N: usize>(
        &mut self,
        pool: &mut Pool<N>,
        (before, next): (Option<u8>, u8),
        frame: &Frame,
        received_at: Instant,
    ) -> Result<(), PoolFull> {
        let at = pool.allocate(frame, received_at)?;
        pool.link(at, next);
        match before {
            None => self.first = at,
            Some(before) => pool.link(before, at),
        }
        self.len += 1;
        Ok(())
    }

    /// Takes the first event. It may be read where it lies, until the place is used again. O(1).
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "it is not empty")]
    pub(super) fn pop<'p, const N: usize>(&mut self, pool: &'p mut Pool<N>) -> Option<&'p Waiting> {
        if self.len == 0 {
            return None;
        }
        let at = self.first;
        let place = pool.places.get_mut(usize::from(at))?;
        self.first = core::mem::replace(&mut place.next, pool.free);
        pool.free = at;
        self.len -= 1;
        Some(place)
    }

    /// Gives all events back to the pool. O(length).
    pub(super) fn clear<const N: usize>(&mut self, pool: &mut Pool<N>) {
        while self.pop(pool).is_some() {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    const STEP: Duration = Duration::from_micros(160);

    fn frame(number: u8, priority: u8) -> Frame {
        let id = Id::new(Priority::new(priority), TxNode::MIN, Etag::BOUND_FIRST);
        Frame::new(id, Payload::new(&[number]).unwrap())
    }

    proptest! {
        #[test]
        fn lists_share_the_pool_and_never_mix(
            steps in prop::collection::vec((0_usize..3, prop::bool::weighted(0.6), 0_u8..5), 0..200)
        ) {
            let mut pool = Pool::<6>::new();
            let mut lists = [List::new(), List::new(), List::new()];
            // Lists 0 and 1 are first in first out, list 2 is in the order of the deadlines.
            let mut oracle: [VecDeque<(u8, u8)>; 3] = Default::default();
            for (number, (at, push, priority)) in (0_u8..).zip(steps) {
                let waiting: usize = oracle.iter().map(VecDeque::len).sum();
                if push {
                    let list = &mut lists[at];
                    let pushed = if at == 2 {
                        list.insert(&mut pool, &frame(number, priority), Instant::EPOCH, STEP)
                    } else {
                        list.push(&mut pool, &frame(number, priority), Instant::EPOCH)
                    };
                    prop_assert_eq!(pushed.is_ok(), waiting < 6);
                    if pushed.is_ok() {
                        oracle[at].push_back((priority, number));
                        if at == 2 {
                            let mut sorted: Vec<_> = oracle[2].drain(..).collect();
                            sorted.sort_by_key(|(priority, _)| *priority);
                            oracle[2] = sorted.into();
                        }
                    }
                } else {
                    let expected = oracle[at].pop_front().map(|(priority, number)| frame(number, priority));
                    prop_assert_eq!(lists[at].pop(&mut pool).map(|it| Frame::new(it.id, it.payload())), expected);
                }
                prop_assert_eq!(usize::from(lists[at].len()), oracle[at].len());
            }
        }
    }
}
