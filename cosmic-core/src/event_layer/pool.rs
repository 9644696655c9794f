//! Where received events wait for their subscribers: one pool for all queues of a node.

use super::filter::Context;
use crate::can::{Payload, TxNode};
use crate::time::Instant;

/// An event as it waits in a queue.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Received {
    /// When its frame arrived; for a local publication, when it was published; for a hard real-time
    /// event, when it became visible.
    pub received_at: Instant,
    /// Who published it.
    pub publisher: TxNode,
    /// The attributes of context that it carries.
    pub context: Context,
    /// The content, behind the attributes.
    pub content: Payload,
}

/// No node: the end of a list.
const END: u8 = u8::MAX;

#[derive(Clone, Copy, Debug)]
struct Node {
    event: Received,
    /// Orders the list of a subscriber that wants the earliest deadline first.
    key: Instant,
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
            event: Received {
                received_at: Instant::EPOCH,
                publisher: TxNode::MIN,
                context: Context::EMPTY,
                content: Payload::EMPTY,
            },
            key: Instant::EPOCH,
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
    fn allocate(&mut self, event: Received, key: Instant) -> Result<u8, PoolFull> {
        let at = self.free;
        let node = self.nodes.get_mut(usize::from(at)).ok_or(PoolFull)?;
        self.free = node.next;
        *node = Node { event, key, next: END };
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
        event: Received,
        key: Instant,
    ) -> Result<(), PoolFull> {
        let at = pool.allocate(event, key)?;
        if self.first == END {
            self.first = at;
        } else {
            pool.link(self.last, at);
        }
        self.last = at;
        self.len += 1;
        Ok(())
    }

    /// Adds an event before the first with a later key. O(length).
    pub(super) fn insert<const N: usize>(
        &mut self,
        pool: &mut Pool<N>,
        event: Received,
        key: Instant,
    ) -> Result<(), PoolFull> {
        let mut before = END;
        let mut next = self.first;
        while let Some(node) = pool.get(next).filter(|node| node.key <= key) {
            before = next;
            next = node.next;
        }
        if next == END {
            return self.push(pool, event, key);
        }
        let at = pool.allocate(event, key)?;
        pool.link(at, next);
        if before == END {
            self.first = at;
        } else {
            pool.link(before, at);
        }
        self.len += 1;
        Ok(())
    }

    /// Takes the first event. O(1).
    #[inline]
    pub(super) fn pop<const N: usize>(&mut self, pool: &mut Pool<N>) -> Option<Received> {
        let at = self.first;
        let node = pool.nodes.get_mut(usize::from(at))?;
        let event = node.event;
        self.first = node.next;
        node.next = pool.free;
        pool.free = at;
        self.len -= 1;
        Some(event)
    }

    /// Gives all events back to the pool. O(length).
    pub(super) fn clear<const N: usize>(&mut self, pool: &mut Pool<N>) {
        while self.pop(pool).is_some() {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Duration;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    fn event(number: u8) -> Received {
        Received {
            received_at: Instant::EPOCH,
            publisher: TxNode::MIN,
            context: Context::EMPTY,
            content: Payload::new(&[number]).unwrap(),
        }
    }

    fn key(ticks: u64) -> Instant {
        Instant::from_epoch(Duration::from_ticks(ticks))
    }

    proptest! {
        #[test]
        fn lists_share_the_pool_and_never_mix(
            steps in prop::collection::vec((0_usize..3, prop::bool::weighted(0.6), 0_u64..5), 0..200)
        ) {
            let mut pool = Pool::<6>::new();
            let mut lists = [List::new(), List::new(), List::new()];
            // Lists 0 and 1 are first in first out, list 2 is in the order of the keys.
            let mut oracle: [VecDeque<(u64, u8)>; 3] = Default::default();
            for (number, (at, push, ticks)) in (0_u8..).zip(steps) {
                let waiting: usize = oracle.iter().map(VecDeque::len).sum();
                if push {
                    let list = &mut lists[at];
                    let pushed = if at == 2 {
                        list.insert(&mut pool, event(number), key(ticks))
                    } else {
                        list.push(&mut pool, event(number), key(ticks))
                    };
                    prop_assert_eq!(pushed.is_ok(), waiting < 6);
                    if pushed.is_ok() {
                        oracle[at].push_back((ticks, number));
                        if at == 2 {
                            let mut sorted: Vec<_> = oracle[2].drain(..).collect();
                            sorted.sort_by_key(|(ticks, _)| *ticks);
                            oracle[2] = sorted.into();
                        }
                    }
                } else {
                    let expected = oracle[at].pop_front().map(|(_, number)| event(number));
                    prop_assert_eq!(lists[at].pop(&mut pool), expected);
                }
                prop_assert_eq!(usize::from(lists[at].len()), oracle[at].len());
            }
        }
    }
}
