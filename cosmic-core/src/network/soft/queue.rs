//! A bounded priority queue: smallest key first, first in first out among equal keys.
//!
//! A binary heap of ranks over a fixed set of places. The ranks behind the heap name the free places, so
//! the array is always a permutation and no free list is needed. Items never move.

#[derive(Clone, Copy, Debug)]
struct Rank {
    key: u64,
    order: u32,
    place: u8,
}

impl Rank {
    #[inline]
    fn precedes(&self, other: &Self) -> bool {
        // The order of arrival wraps; all that is in the queue arrived within half of its range.
        self.key < other.key || (self.key == other.key && (self.order.wrapping_sub(other.order) as i32) < 0)
    }
}

/// A queue of at most `N` items, `N` ≤ 255. One with no places costs nothing.
#[derive(Clone, Debug)]
pub struct Queue<T, const N: usize> {
    len: usize,
    ranks: [Rank; N],
    items: [Option<T>; N],
    arrivals: u32,
}

impl<T, const N: usize> Queue<T, N> {
    /// An empty queue.
    #[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
    #[expect(clippy::arithmetic_side_effects, reason = "within the length, by the loop")]
    pub const fn new() -> Self {
        const { assert!(N <= 255, "a queue has 255 places at most") };
        let mut ranks = [Rank { key: 0, order: 0, place: 0 }; N];
        let mut place = 0;
        while place < N {
            ranks[place].place = place as u8;
            place += 1;
        }
        Self { len: 0, ranks, items: [const { None }; N], arrivals: 0 }
    }

    /// How many items wait.
    #[inline]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Returns whether none waits.
    #[inline]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The key of the first item.
    #[inline]
    pub fn first_key(&self) -> Option<u64> {
        if self.len == 0 { None } else { self.ranks.first().map(|rank| rank.key) }
    }

    /// Adds an item behind those with the same key. O(log N).
    ///
    /// # Errors
    /// The item, if the queue is full.
    pub fn push(&mut self, key: u64, item: T) -> Result<(), T> {
        self.arrivals = self.arrivals.wrapping_add(1);
        self.insert(key, self.arrivals, item)
    }

    /// Takes the first item, with its key and order of arrival for [`Queue::put_back`]. O(log N).
    pub fn pop(&mut self) -> Option<(u64, u32, T)> {
        self.remove(0)
    }

    /// Puts an item back where it was taken from. O(log N).
    ///
    /// # Errors
    /// The item, if the queue is full.
    pub fn put_back(&mut self, key: u64, order: u32, item: T) -> Result<(), T> {
        self.insert(key, order, item)
    }

    /// Takes the first item found that meets the condition, in no particular order. O(N).
    pub fn take_where(&mut self, mut condition: impl FnMut(&T) -> bool) -> Option<T> {
        let at = (0..self.len).find(|&at| self.item(at).is_some_and(&mut condition))?;
        self.remove(at).map(|(_, _, item)| item)
    }

    /// The items, in no particular order.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.items.iter_mut().flatten()
    }

    fn item(&self, at: usize) -> Option<&T> {
        let place = self.ranks.get(at)?.place;
        self.items.get(usize::from(place))?.as_ref()
    }

    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "there was a place behind the last")]
    fn insert(&mut self, key: u64, order: u32, item: T) -> Result<(), T> {
        let at = self.len;
        let Some(rank) = self.ranks.get_mut(at) else { return Err(item) };
        rank.key = key;
        rank.order = order;
        let place = usize::from(rank.place);
        if let Some(place) = self.items.get_mut(place) {
            *place = Some(item);
        }
        self.len += 1;
        self.sift_up(at);
        Ok(())
    }

    #[expect(clippy::arithmetic_side_effects, reason = "it is not empty")]
    fn remove(&mut self, at: usize) -> Option<(u64, u32, T)> {
        if at >= self.len {
            return None;
        }
        let last = self.len - 1;
        let rank = *self.ranks.get(at)?;
        *self.ranks.get_mut(at)? = core::mem::replace(self.ranks.get_mut(last)?, rank);
        self.len = last;
        if at < last {
            self.sift_down(at);
            self.sift_up(at);
        }
        let item = self.items.get_mut(usize::from(rank.place))?.take()?;
        Some((rank.key, rank.order, item))
    }

    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "it is not zero")]
    fn sift_up(&mut self, mut at: usize) {
        let Some(ranks) = self.ranks.get_mut(..self.len) else { return };
        while at > 0 {
            let parent = (at - 1) / 2;
            match (ranks.get(at), ranks.get(parent)) {
                (Some(child), Some(above)) if child.precedes(above) => exchange(ranks, at, parent),
                _ => return,
            }
            at = parent;
        }
    }

    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "twice 255 at most")]
    fn sift_down(&mut self, mut at: usize) {
        let Some(ranks) = self.ranks.get_mut(..self.len) else { return };
        loop {
            let left = 2 * at + 1;
            let smaller = match (ranks.get(left), ranks.get(left + 1)) {
                (Some(first), Some(second)) if second.precedes(first) => left + 1,
                (Some(_), _) => left,
                (None, _) => return,
            };
            match (ranks.get(smaller), ranks.get(at)) {
                (Some(below), Some(above)) if below.precedes(above) => exchange(ranks, at, smaller),
                _ => return,
            }
            at = smaller;
        }
    }
}

/// As `swap`, whose panic the compiler would have to prove away where it optimises for size, too.
#[inline]
fn exchange(ranks: &mut [Rank], one: usize, other: usize) {
    if let (Some(&first), Some(&second)) = (ranks.get(one), ranks.get(other)) {
        for (at, rank) in [(one, second), (other, first)] {
            if let Some(place) = ranks.get_mut(at) {
                *place = rank;
            }
        }
    }
}

impl<T, const N: usize> Default for Queue<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    #[derive(Clone, Debug)]
    enum Operation {
        Push(u64),
        Pop,
        PopAndPutBack,
        TakeMultiplesOf(u64),
    }

    fn operation() -> impl Strategy<Value = Operation> {
        prop_oneof![
            3 => (0_u64..6).prop_map(Operation::Push),
            2 => Just(Operation::Pop),
            1 => Just(Operation::PopAndPutBack),
            1 => (2_u64..9).prop_map(Operation::TakeMultiplesOf),
        ]
    }

    proptest! {
        /// The oracle is a vector kept in order of (key, arrival).
        #[test]
        fn smallest_key_first_then_first_in_first_out(
            operations in prop::collection::vec(operation(), 0..300)
        ) {
            let mut queue = Queue::<u64, 8>::new();
            let mut oracle: Vec<(u64, u64)> = Vec::new();
            for (serial, operation) in (0_u64..).zip(operations) {
                match operation {
                    Operation::Push(key) => {
                        let pushed = queue.push(key, serial);
                        prop_assert_eq!(pushed.is_ok(), oracle.len() < 8);
                        if pushed.is_ok() {
                            oracle.push((key, serial));
                            oracle.sort_unstable();
                        }
                    }
                    Operation::Pop => {
                        let expected = (!oracle.is_empty()).then(|| oracle.remove(0));
                        prop_assert_eq!(queue.pop().map(|(key, _, item)| (key, item)), expected);
                    }
                    Operation::PopAndPutBack => {
                        if let Some((key, order, item)) = queue.pop() {
                            queue.put_back(key, order, item).unwrap();
                        }
                    }
                    Operation::TakeMultiplesOf(number) => {
                        let taken = queue.take_where(|item| item % number == 0);
                        prop_assert_eq!(
                            taken.is_some(),
                            oracle.iter().any(|(_, item)| item % number == 0)
                        );
                        oracle.retain(|(_, item)| Some(*item) != taken);
                    }
                }
                prop_assert_eq!(queue.len(), oracle.len());
                prop_assert_eq!(queue.first_key(), oracle.first().map(|(key, _)| *key));
            }
        }
    }
}
