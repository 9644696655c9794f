//! A bounded priority queue: smallest key first, first in first out among equal keys. Its head may be out of it, in a
//! mailbox, and come back.
//!
//! A binary heap of places. The places behind the heap are free, but for the last while an item is out; so the array is
//! always a permutation and no free list is needed. Items never move, whether they wait or are out.

/// What waits in a [`Queue`].
pub(super) trait Ranked {
    /// The smallest is the first.
    fn key(&self) -> u64;
    /// Its order of arrival, with which it was made.
    fn order(&self) -> u32;
}

#[derive(Clone, Copy)]
struct Rank {
    key: u64,
    order: u32,
}

impl Rank {
    #[inline]
    const fn precedes(self, other: Self) -> bool {
        // The order of arrival wraps; all that is in the queue arrived within half of its range.
        self.key < other.key || (self.key == other.key && (self.order.wrapping_sub(other.order) as i32) < 0)
    }
}

/// A queue of at most `N` items, `N` ≤ 255, the one that is out included. One with no places costs nothing.
#[derive(Clone, Debug)]
pub(super) struct Queue<T, const N: usize> {
    items: [Option<T>; N],
    arrivals: u32,
    places: [u8; N],
    len: u8,
    /// The item in the last of the places is out.
    is_out: bool,
}

impl<T: Ranked, const N: usize> Queue<T, N> {
    /// An empty queue.
    #[allow(clippy::indexing_slicing, reason = "within the length, by the loop")]
    #[expect(clippy::arithmetic_side_effects, reason = "within the length, by the loop")]
    pub(super) const fn new() -> Self {
        const { assert!(N <= 255, "a queue has 255 places at most") };
        let mut places = [0; N];
        let mut place = 0;
        while place < N {
            places[place] = place as u8;
            place += 1;
        }
        Self { items: [const { None }; N], arrivals: 0, places, len: 0, is_out: false }
    }

    /// How many items wait, and are out.
    #[expect(clippy::arithmetic_side_effects, reason = "at most 255, and one")]
    #[inline]
    pub(super) fn len(&self) -> usize {
        usize::from(self.len) + usize::from(self.is_out)
    }

    /// Returns whether none waits, and none is out.
    #[inline]
    pub(super) const fn is_empty(&self) -> bool {
        self.len == 0 && !self.is_out
    }

    /// The first of those that wait.
    pub(super) fn first(&self) -> Option<&T> {
        if self.len == 0 { None } else { self.item(0) }
    }

    /// Adds the item that `make` makes of its order of arrival, behind those with the same key; there must be a place.
    /// O(log N).
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "at most 254 have waited")]
    pub(super) fn push(&mut self, make: impl FnOnce(u32) -> T) {
        if self.len() >= N {
            return;
        }
        self.arrivals = self.arrivals.wrapping_add(1);
        let order = self.arrivals;
        let at = usize::from(self.len);
        if let Some(place) = self.place_mut(at) {
            *place = Some(make(order));
        }
        self.len += 1;
        self.sift_up(at);
    }

    /// Adds an item and takes it out at once; nothing may wait, and none be out. O(1).
    #[inline]
    pub(super) fn push_out(&mut self, make: impl FnOnce(u32) -> T) {
        // Before all that come later.
        let order = self.arrivals;
        if let Some(place) = self.place_mut(Self::LAST) {
            *place = Some(make(order));
            self.is_out = true;
        }
    }

    /// Takes the first item out, if none is. O(log N).
    pub(super) fn take_out(&mut self) -> Option<&T> {
        if self.is_out || self.len == 0 {
            return None;
        }
        self.detach(0);
        self.exchange(usize::from(self.len), Self::LAST);
        self.is_out = true;
        self.out()
    }

    /// The item that is out.
    #[inline]
    pub(super) fn out(&self) -> Option<&T> {
        if self.is_out { self.item(Self::LAST) } else { None }
    }

    /// As [`out`](Self::out), to be changed; but not its key.
    pub(super) fn out_mut(&mut self) -> Option<&mut T> {
        if self.is_out { self.place_mut(Self::LAST)?.as_mut() } else { None }
    }

    /// Removes the item that is out.
    pub(super) fn remove_out(&mut self) -> Option<T> {
        if !core::mem::take(&mut self.is_out) {
            return None;
        }
        self.place_mut(Self::LAST)?.take()
    }

    /// Puts the item that is out back where it was taken from. O(log N).
    #[expect(clippy::arithmetic_side_effects, reason = "at most 254 have waited while one was out")]
    pub(super) fn put_back(&mut self) {
        if !core::mem::take(&mut self.is_out) {
            return;
        }
        let at = usize::from(self.len);
        self.exchange(at, Self::LAST);
        self.len += 1;
        self.sift_up(at);
    }

    /// Takes an item that waits and meets the condition. O(N).
    pub(super) fn take_where(&mut self, mut condition: impl FnMut(&T) -> bool) -> Option<T> {
        let at = (0..usize::from(self.len)).find(|&at| self.item(at).is_some_and(&mut condition))?;
        self.detach(at);
        self.place_mut(usize::from(self.len))?.take()
    }

    /// The items that wait, in no particular order, to be changed; but not their keys.
    pub(super) fn waiting_mut(&mut self) -> impl Iterator<Item = &mut T> {
        let out = if self.is_out { self.places.last().copied() } else { None };
        // The items first: then no number is asked for behind the last, which may be the largest there is.
        let places = self.items.iter_mut().zip(0_u8..);
        places.filter(move |&(_, place)| Some(place) != out).filter_map(|(item, _)| item.as_mut())
    }

    /// Where in the array of places the one of the item that is out is.
    const LAST: usize = N.saturating_sub(1);

    #[inline]
    fn item(&self, at: usize) -> Option<&T> {
        let place = *self.places.get(at)?;
        self.items.get(usize::from(place))?.as_ref()
    }

    #[inline]
    fn place_mut(&mut self, at: usize) -> Option<&mut Option<T>> {
        let place = *self.places.get(at)?;
        self.items.get_mut(usize::from(place))
    }

    /// Takes an item from the heap: its place is the first behind it.
    fn detach(&mut self, at: usize) {
        let Some(last) = self.len.checked_sub(1) else { return };
        self.exchange(at, usize::from(last));
        self.len = last;
        if at < usize::from(last) {
            self.sift_down(at);
            self.sift_up(at);
        }
    }

    #[expect(clippy::arithmetic_side_effects, reason = "it is not zero")]
    fn sift_up(&mut self, mut at: usize) {
        let Some(rank) = self.rank(at) else { return };
        while at > 0 {
            let parent = (at - 1) / 2;
            if !self.rank(parent).is_some_and(|above| rank.precedes(above)) {
                return;
            }
            self.exchange(at, parent);
            at = parent;
        }
    }

    #[expect(clippy::arithmetic_side_effects, reason = "twice 255 at most")]
    fn sift_down(&mut self, mut at: usize) {
        let Some(rank) = self.rank(at) else { return };
        loop {
            let left = 2 * at + 1;
            let (smaller, below) = match (self.rank(left), self.rank(left + 1)) {
                (Some(first), Some(second)) if second.precedes(first) => (left + 1, second),
                (Some(first), _) => (left, first),
                (None, _) => return,
            };
            if !below.precedes(rank) {
                return;
            }
            self.exchange(at, smaller);
            at = smaller;
        }
    }

    /// The rank of an item that waits.
    fn rank(&self, at: usize) -> Option<Rank> {
        let item = if at < usize::from(self.len) { self.item(at)? } else { return None };
        Some(Rank { key: item.key(), order: item.order() })
    }

    #[inline]
    fn exchange(&mut self, one: usize, other: usize) {
        if let (Some(&first), Some(&second)) = (self.places.get(one), self.places.get(other)) {
            for (at, place) in [(one, second), (other, first)] {
                if let Some(at) = self.places.get_mut(at) {
                    *at = place;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    #[derive(Clone, Copy, PartialEq, Eq, Debug)]
    struct Item {
        key: u64,
        serial: u64,
        order: u32,
    }

    impl Ranked for Item {
        fn key(&self) -> u64 {
            self.key
        }

        fn order(&self) -> u32 {
            self.order
        }
    }

    #[derive(Clone, Debug)]
    enum Operation {
        Push(u64),
        TakeOut,
        RemoveOut,
        PutBack,
        TakeMultiplesOf(u64),
    }

    fn operation() -> impl Strategy<Value = Operation> {
        prop_oneof![
            4 => (0_u64..6).prop_map(Operation::Push),
            2 => Just(Operation::TakeOut),
            1 => Just(Operation::RemoveOut),
            1 => Just(Operation::PutBack),
            1 => (2_u64..9).prop_map(Operation::TakeMultiplesOf),
        ]
    }

    #[test]
    fn the_largest_queue_fills() {
        let mut queue = Queue::<Item, 255>::new();
        for serial in 0..255 {
            queue.push(|order| Item { key: 0, serial, order });
        }
        // One by one: not all ways to go through them ask for a number behind the last.
        let waiting = |queue: &mut Queue<Item, 255>| {
            let mut items = queue.waiting_mut();
            let mut count = 0;
            while items.next().is_some() {
                count += 1;
            }
            count
        };
        assert_eq!(waiting(&mut queue), 255);
        assert_eq!(queue.take_out().map(|item| item.serial), Some(0));
        assert_eq!(waiting(&mut queue), 254);
        queue.push(|order| Item { key: 0, serial: 255, order });
        assert_eq!(queue.len(), 255);
    }

    proptest! {
        #[test]
        fn smallest_key_first_then_first_in_first_out(
            first_order in prop_oneof![Just(0), Just(u32::MAX - 3), Just(i32::MAX as u32 - 3)],
            operations in prop::collection::vec(operation(), 0..300),
        ) {
            let mut queue = Queue::<Item, 8>::new();
            queue.arrivals = first_order;
            let mut waiting: Vec<(u64, u64)> = Vec::new();
            let mut out: Option<(u64, u64)> = None;
            let plain = |item: &Item| (item.key, item.serial);
            for (serial, operation) in (0_u64..).zip(operations) {
                match operation {
                    Operation::Push(key) if queue.is_empty() => {
                        queue.push_out(|order| Item { key, serial, order });
                        out = Some((key, serial));
                    }
                    Operation::Push(key) => {
                        queue.push(|order| Item { key, serial, order });
                        if waiting.len() + usize::from(out.is_some()) < 8 {
                            waiting.push((key, serial));
                            waiting.sort_unstable();
                        }
                    }
                    Operation::TakeOut => {
                        let taken = queue.take_out().map(plain);
                        if out.is_some() || waiting.is_empty() {
                            prop_assert_eq!(taken, None);
                        } else {
                            out = Some(waiting.remove(0));
                            prop_assert_eq!(taken, out);
                        }
                    }
                    Operation::RemoveOut => {
                        prop_assert_eq!(queue.remove_out().as_ref().map(plain), out.take());
                    }
                    Operation::PutBack => {
                        queue.put_back();
                        waiting.extend(out.take());
                        waiting.sort_unstable();
                    }
                    Operation::TakeMultiplesOf(number) => {
                        let taken = queue.take_where(|item| item.serial % number == 0);
                        prop_assert_eq!(taken.is_some(), waiting.iter().any(|(_, serial)| serial % number == 0));
                        waiting.retain(|&one| Some(one) != taken.as_ref().map(plain));
                    }
                }
                prop_assert_eq!(queue.len(), waiting.len() + usize::from(out.is_some()));
                prop_assert_eq!(queue.first().map(plain), waiting.first().copied());
                prop_assert_eq!(queue.out().map(plain), out);
                let mut all: Vec<_> = queue.waiting_mut().map(|item| plain(item)).collect();
                all.sort_unstable();
                prop_assert_eq!(&all, &waiting);
            }
        }
    }
}
