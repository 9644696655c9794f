//! A queue from one context to another, without locks.
//!
//! That of `heapless` divides at each step, and can panic where it does. Here the number of places is a power of two,
//! and a position is never out of bounds.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

/// The places of a queue for `S::len()` items: all of them can be in use. There may be none.
///
/// `written` and `taken` count for ever, and wrap: the difference is the number of items that wait.
pub(crate) struct Ring<S: ?Sized> {
    written: AtomicU32,
    taken: AtomicU32,
    places: S,
}

type Place<T> = UnsafeCell<MaybeUninit<T>>;

// SAFETY: places are reached by the one producer and the one consumer only, and each by one of them at a time: see
// there.
unsafe impl<S: ?Sized> Sync for Ring<S> {}

/// The end that items are put in.
pub(crate) struct Producer<T: 'static> {
    ring: &'static Ring<[Place<T>]>,
}

/// The end that items are taken from.
pub(crate) struct Consumer<T: 'static> {
    ring: &'static Ring<[Place<T>]>,
}

// SAFETY: an end moves items of `T` from one context to another, and nothing else.
unsafe impl<T: Send> Send for Producer<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Send for Consumer<T> {}

impl<T: Copy, const N: usize> Ring<[Place<T>; N]> {
    /// Nothing waits.
    pub(crate) const fn new() -> Self {
        const { assert!(N == 0 || N.is_power_of_two(), "the number of places must be a power of two") };
        Self {
            written: AtomicU32::new(0),
            taken: AtomicU32::new(0),
            places: [const { UnsafeCell::new(MaybeUninit::uninit()) }; N],
        }
    }

    /// The two ends. There are no others, since this borrows the ring for good.
    pub(crate) fn split(&'static mut self) -> (Producer<T>, Consumer<T>) {
        let ring: &'static Ring<[Place<T>]> = self;
        (Producer { ring }, Consumer { ring })
    }
}

impl<T> Ring<[Place<T>]> {
    /// The place with this number. `None` does not occur where there are any: the mask keeps the number within the length.
    #[inline]
    fn place(&self, number: u32) -> Option<&Place<T>> {
        let mask = self.places.len().wrapping_sub(1);
        self.places.get(number as usize & mask)
    }
}

impl<T: Copy> Producer<T> {
    /// Puts an item in, behind the others. Returns whether there was room.
    #[inline]
    pub(crate) fn put(&mut self, item: T) -> bool {
        let ring = self.ring;
        let written = ring.written.load(Ordering::Relaxed);
        if written.wrapping_sub(ring.taken.load(Ordering::Acquire)) as usize >= ring.places.len() {
            return false;
        }
        let Some(place) = ring.place(written) else { return false };
        // SAFETY: the consumer is behind this place, since fewer items wait than there are places, and comes to it only
        // when `written` has gone on. There is no other producer.
        unsafe { (*place.get()).write(item) };
        ring.written.store(written.wrapping_add(1), Ordering::Release);
        true
    }
}

impl<T: Copy> Consumer<T> {
    /// Takes the item that has waited longest, if there is one: `look` sees it where it is.
    #[inline]
    pub(crate) fn take<R>(&mut self, look: impl FnOnce(&T) -> R) -> Option<R> {
        let ring = self.ring;
        let taken = ring.taken.load(Ordering::Relaxed);
        if ring.written.load(Ordering::Acquire) == taken {
            return None;
        }
        let place = ring.place(taken)?;
        // SAFETY: `written` is beyond this place, so that the producer has written it, and does not write it again before
        // `taken` has gone on. There is no other consumer.
        let seen = look(unsafe { (*place.get()).assume_init_ref() });
        ring.taken.store(taken.wrapping_add(1), Ordering::Release);
        Some(seen)
    }
}

/// A ring for `N` items.
pub(crate) type Queue<T, const N: usize> = Ring<[Place<T>; N]>;

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;
    use std::thread;

    fn ends<const N: usize>() -> (Producer<u32>, Consumer<u32>) {
        Box::leak(Box::new(Queue::<u32, N>::new())).split()
    }

    #[test]
    fn items_come_out_in_order_and_what_finds_no_room_is_refused() {
        let (mut producer, mut consumer) = ends::<4>();
        for turn in 0..3 {
            assert!((0..4).all(|n| producer.put(10 * turn + n)));
            assert!(!producer.put(99));
            assert!((0..4).all(|n| consumer.take(|n| *n) == Some(10 * turn + n)));
            assert_eq!(consumer.take(|n| *n), None);
        }
    }

    #[test]
    fn a_queue_without_places_refuses_everything() {
        let (mut producer, mut consumer) = ends::<0>();
        assert!(!producer.put(1));
        assert_eq!(consumer.take(|n| *n), None);
    }

    #[test]
    fn counters_may_wrap() {
        let ring = Box::leak(Box::new(Queue::<u32, 2>::new()));
        for counter in [&ring.written, &ring.taken] {
            counter.store(u32::MAX, Ordering::Relaxed);
        }
        let (mut producer, mut consumer) = ring.split();
        assert!(producer.put(1) && producer.put(2) && !producer.put(3));
        assert_eq!([(); 3].map(|()| consumer.take(|n| *n)), [Some(1), Some(2), None]);
    }

    #[test]
    fn nothing_is_lost_or_doubled_between_two_threads() {
        let (mut producer, mut consumer) = ends::<8>();
        let count = 100_000;
        let writer = thread::spawn(move || {
            for n in 0..count {
                while !producer.put(n) {
                    thread::yield_now();
                }
            }
        });
        for n in 0..count {
            let taken = loop {
                match consumer.take(|n| *n) {
                    Some(taken) => break taken,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(taken, n);
        }
        writer.join().unwrap();
    }
}
