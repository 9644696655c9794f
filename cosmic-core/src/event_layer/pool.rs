//! Where received events wait for their subscribers: one pool for all queues of a node.

use crate::can::{Payload, Priority, TxNode};
use crate::time::{Duration, Instant};

/// An event as it waits in a queue: 24 bytes with its place in the list.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Waiting {
    /// When its frame arrived; for a local publication, when it was published; for a hard real-time
    /// event, when it became visible.
    pub(crate) received_at: Instant,
    /// Attributes of context, if the channel has them, and content.
    pub(crate) payload: Payload,
    pub(crate) publisher: TxNode,
    /// Says, with the time of arrival, when the deadline is.
    pub(crate) priority: Priority,
}

impl Waiting {
    /// The deadline as the frame tells it: one step for each priority.
    fn deadline(&self, step: Duration) -> Instant {
        self.received_at + Duration::from_ticks(u64::from(self.priority.get()) * step.as_ticks())
    }
}

/// No node: the end of a list.
const END: u8 = u8::MAX;

#[derive(Clone, Copy, Debug)]
struct Node {
    event: Waiting,
    next: u8,
}

/// Room for `N` ≤ 255 events.
#[derive(Clone, Debug)]
pub(super) struct Pool<const N: usize> {
    nodes: [Node; N],
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
    pub(super) const fn new() -> Self {
        const { assert!(N > 0 && N < END as usize, "a node has room for 1..=254 waiting events") };
        let nothing = Node {
            event: Waiting {
                received_at: Instant::EPOCH,
                payload: Payload::EMPTY,
                publisher: TxNode::MIN,
                priority: Priority::LEAST,
            },
            next: END,
        };
        let mut nodes = [nothing; N];
        let mut at = 0;
        while at + 1 < N {
            nodes[at].next = at as u8 + 1;
            at += 1;
        }
        Self { nodes, free: 0 }
    }

    #[inline]
    fn allocate(&mut self, event: &Waiting) -> Result<u8, PoolFull> {
        let at = self.free;
        let node = self.nodes.get_mut(usize::from(at)).ok_or(PoolFull)?;
        self.free = node.next;
        node.event = *event;
        node.next = END;
        Ok(at)
    }

    #[inline]
    fn get(&self, at: u8) -> Option<&Node> {
        self.nodes.get(usize::from(at))
    }

    #[inline]
    fn link(&mut self, from: u8, to: u8) {
        if let Some(node) = self.nodes.get_mut(usize::from(from)) {
            node.next = to;
        }
    }
}

impl List {
    pub(super) const fn new() -> Self {
        Self { first: END, last: END, len: 0 }
    }

    #[inline]
    pub(super) const fn len(&self) -> u8 {
        self.len
    }

    /// Adds an event at the end. O(1).
    #[inline]
    pub(super) fn push<const N: usize>(
        &mut self,
        pool: &mut Pool<N>,
        event: &Waiting,
    ) -> Result<(), PoolFull> {
        let at = pool.allocate(event)?;
        if self.first == END {
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
        event: &Waiting,
        step: Duration,
    ) -> Result<(), PoolFull> {
        let deadline = event.deadline(step);
        let mut before = END;
        let mut next = self.first;
        while let Some(node) = pool.get(next).filter(|node| node.event.deadline(step) <= deadline) {
            before = next;
            next = node.next;
        }
        if next == END {
            return self.push(pool, event);
        }
        let at = pool.allocate(event)?;
        pool.link(at, next);
        if before == END {
            self.first = at;
        } else {
            pool.link(before, at);
        }
        self.len += 1;
        Ok(())
    }

    /// Takes the first event, and hands it to `read` where it lies. O(1).
    #[inline]
    pub(super) fn pop<const N: usize, R>(
        &mut self,
        pool: &mut Pool<N>,
        read: impl FnOnce(&Waiting) -> R,
    ) -> Option<R> {
        let at = self.first;
        let node = pool.nodes.get_mut(usize::from(at))?;
        let result = read(&node.event);
        self.first = node.next;
        node.next = pool.free;
        pool.free = at;
        self.len -= 1;
        Some(result)
    }

    /// Gives all events back to the pool. O(length).
    pub(super) fn clear<const N: usize>(&mut self, pool: &mut Pool<N>) {
        while self.pop(pool, |_| ()).is_some() {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    const STEP: Duration = Duration::from_micros(160);

    fn event(number: u8, priority: u8) -> Waiting {
        Waiting {
            received_at: Instant::EPOCH,
            payload: Payload::new(&[number]).unwrap(),
            publisher: TxNode::MIN,
            priority: Priority::new(priority),
        }
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
                        list.insert(&mut pool, &event(number, priority), STEP)
                    } else {
                        list.push(&mut pool, &event(number, priority))
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
                    let expected = oracle[at].pop_front().map(|(priority, number)| event(number, priority));
                    prop_assert_eq!(lists[at].pop(&mut pool, |event| *event), expected);
                }
                prop_assert_eq!(usize::from(lists[at].len()), oracle[at].len());
            }
        }
    }
}
