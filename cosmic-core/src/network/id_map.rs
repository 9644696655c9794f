//! From an identifier to what it means here, in bounded time.
//!
//! A node must tell at once whether a received frame concerns it, however many channels it has; the
//! sequential table of an earlier implementation was its main cost (UPS). Most frames on a bus concern
//! others, so what counts is how long a *miss* takes, in the worst case.
//!
//! This is a cuckoo hash table (Pagh and Rodler, *Cuckoo hashing*, 2004) with buckets of two. A key is in
//! its bucket of the left half, or in its bucket of the right half, or it is not there: a look-up compares
//! at most [`COMPARES`] keys, however full the table is and whatever other keys are in it. An insertion
//! into two full buckets moves a key to its bucket in the other half. The broker hands etags out in
//! sequence and calendars number theirs in sequence; the bucket of the left half is given by the low bits
//! as they are, so a sequence fits there, and a hit costs one or two compares.

/// A look-up compares at most this many keys.
pub const COMPARES: usize = 4;

/// An insertion moves at most this many keys.
const MOVES: usize = 32;

/// An identifier is an etag and, above it, a TxNode and a priority.
const ETAG_BITS: u32 = 14;

/// Two places. A place is one word: the key and, in the low bits, the value.
type Bucket = [u32; 2];

/// The key of no identifier of 29 bits.
const VACANT: u32 = u32::MAX;

/// A map from etags or identifiers to numbers of `BITS` bits. A key has at most `32 - BITS` bits, not all of
/// them set. `N`, a power of two or zero, is the number of keys that it is meant for; it has twice as many places.
#[derive(Clone, Debug)]
pub struct IdMap<const BITS: u32, const N: usize> {
    buckets: [Bucket; N],
}

/// The key found no place, nor could one be made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoPlace;

impl<const BITS: u32, const N: usize> IdMap<BITS, N> {
    /// The buckets of one half. A map for one key has no right half.
    const HALF: usize = {
        assert!(N == 0 || N.is_power_of_two(), "the capacity of a map must be a power of two");
        if N > 1 { N / 2 } else { 1 }
    };

    /// An empty map.
    pub const fn new() -> Self {
        Self { buckets: [[VACANT; 2]; N] }
    }

    /// What stands under the key. At most [`COMPARES`] compares.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "constants")]
    pub fn get(&self, key: u32) -> Option<u32> {
        let place = match find(self.buckets.get(Self::left(key))?, key, BITS) {
            None => find(self.buckets.get(Self::right(key))?, key, BITS)?,
            Some(place) => place,
        };
        Some(place & ((1 << BITS) - 1))
    }

    /// Puts `value` under `key`, in place of an earlier value. Moves at most 32 other keys.
    ///
    /// # Errors
    /// [`NoPlace`] if there is none, or the key or the value has too many bits; the map is as before.
    pub fn insert(&mut self, key: u32, value: u32) -> Result<(), NoPlace> {
        if key >= VACANT >> BITS || value >> BITS != 0 {
            return Err(NoPlace);
        }
        let mut homeless = key << BITS | value;
        if let Some(place) = self.place_mut(key) {
            *place = homeless;
            return Ok(());
        }
        for moved in 0..MOVES {
            if self.settle(homeless) {
                return Ok(());
            }
            self.displace(moved, &mut homeless);
        }
        for moved in (0..MOVES).rev() {
            self.displace(moved, &mut homeless);
        }
        Err(NoPlace)
    }

    /// Removes the key, if it is there. At most [`COMPARES`] compares.
    pub fn remove(&mut self, key: u32) {
        if let Some(place) = self.place_mut(key) {
            *place = VACANT;
        }
    }

    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "constants: a map has at least two buckets")]
    fn left(key: u32) -> usize {
        key as usize & (Self::HALF - 1)
    }

    /// What tells keys of one left bucket apart has its part in it: the rest of the etag, and the TxNode.
    #[inline]
    #[expect(clippy::arithmetic_side_effects, reason = "the sum is below the number of buckets")]
    fn right(key: u32) -> usize {
        let folded = key ^ key >> Self::HALF.trailing_zeros() ^ key >> ETAG_BITS;
        Self::HALF + (folded as usize & (Self::HALF - 1))
    }

    fn place_mut(&mut self, key: u32) -> Option<&mut u32> {
        let at = [Self::left(key), Self::right(key)];
        let at = at
            .into_iter()
            .find(|&at| self.buckets.get(at).is_some_and(|it| find(it, key, BITS).is_some()))?;
        self.buckets.get_mut(at)?.iter_mut().find(|place| **place >> BITS == key)
    }

    /// Puts it into one of its buckets, if there is room.
    fn settle(&mut self, homeless: u32) -> bool {
        let key = homeless >> BITS;
        for at in [Self::left(key), Self::right(key)] {
            let places = self.buckets.get_mut(at).into_iter().flatten();
            if let Some(place) = places.into_iter().find(|place| **place == VACANT) {
                *place = homeless;
                return true;
            }
        }
        false
    }

    /// Exchanges it for one that was in one of its buckets; the same again undoes that. Left and right take
    /// turns, and so do the places of a bucket, or two keys would chase each other.
    #[allow(clippy::indexing_slicing, reason = "a bucket has two places")]
    fn displace(&mut self, moved: usize, homeless: &mut u32) {
        let key = *homeless >> BITS;
        let at = if moved.is_multiple_of(2) { Self::left(key) } else { Self::right(key) };
        if let Some(bucket) = self.buckets.get_mut(at) {
            core::mem::swap(&mut bucket[moved / 2 % 2], homeless);
        }
    }
}

/// The place of the key in a bucket.
#[inline]
fn find([first, second]: &Bucket, key: u32, bits: u32) -> Option<u32> {
    if first >> bits == key {
        return Some(*first);
    }
    if second >> bits == key { Some(*second) } else { None }
}

impl<const BITS: u32, const N: usize> Default for IdMap<BITS, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashMap;
    use std::vec::Vec;

    type Channels<const N: usize> = IdMap<16, N>;
    type Identifiers<const N: usize> = IdMap<8, N>;

    #[test]
    fn a_fifth_rival_is_refused_and_leaves_the_map_as_it_was() {
        let buckets = |key| (Channels::<16>::left(key), Channels::<16>::right(key));
        let rivals: Vec<u32> = (0..0x4000).filter(|&key| buckets(key) == buckets(0)).collect();
        let mut map = Channels::<16>::new();
        for (value, &key) in (0..).zip(&rivals[..4]) {
            map.insert(key, value).unwrap();
        }
        for _ in 0..2 {
            assert_eq!(map.insert(rivals[4], 1), Err(NoPlace));
            assert_eq!(map.get(rivals[4]), None);
            assert!((0..).zip(&rivals[..4]).all(|(value, &key)| map.get(key) == Some(value)));
        }
        map.remove(rivals[2]);
        assert_eq!(map.insert(rivals[4], 9), Ok(()));
        assert_eq!(map.get(rivals[4]), Some(9));
    }

    #[test]
    fn sequences_and_strides_fill_it_to_its_capacity() {
        for stride in [1, 2, 3, 5, 16, 32] {
            let mut map = Channels::<64>::new();
            for n in 0..64 {
                assert_eq!(map.insert(16_383 - n * stride, n), Ok(()), "stride {stride}, key {n}");
            }
            assert!((0..64).all(|n| map.get(16_383 - n * stride) == Some(n)));
        }
    }

    #[test]
    fn publishers_of_one_channel_fill_it_to_its_capacity() {
        let mut map = Identifiers::<128>::new();
        for publisher in 0..127 {
            map.insert(publisher << ETAG_BITS | 100, publisher).unwrap();
        }
        assert!((0..127).all(|publisher| map.get(publisher << ETAG_BITS | 100) == Some(publisher)));
    }

    /// Of a thousand sets of as many random etags as the map is meant for, none is refused.
    #[test]
    fn random_etags_fill_it_to_its_capacity() {
        let mut state = 1_u64;
        for _ in 0..1_000 {
            let mut map = Channels::<64>::new();
            for value in 0..64 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                assert_eq!(map.insert((state >> 50) as u32, value), Ok(()));
            }
        }
    }

    #[test]
    fn what_has_too_many_bits_is_refused() {
        let mut map = Channels::<4>::new();
        assert_eq!(map.insert(0xFFFF, 0), Err(NoPlace));
        assert_eq!(map.insert(1 << 16, 0), Err(NoPlace));
        assert_eq!(map.insert(0xFFFE, 0xFFFF), Ok(()));
        assert_eq!(map.insert(0, 0x1_0000), Err(NoPlace));
        assert_eq!(map.get(0xFFFE), Some(0xFFFF));
    }

    proptest! {
        #[test]
        fn it_is_a_map(steps in prop::collection::vec((0_u32..64, prop::option::of(0_u32..256)), 0..200)) {
            let mut map = Identifiers::<8>::new();
            let mut oracle = HashMap::new();
            for (key, value) in steps {
                match value {
                    Some(value) => {
                        if map.insert(key * 3, value).is_ok() {
                            oracle.insert(key * 3, value);
                        }
                    }
                    None => {
                        map.remove(key * 3);
                        oracle.remove(&(key * 3));
                    }
                }
                for key in 0..192 {
                    prop_assert_eq!(map.get(key), oracle.get(&key).copied());
                }
            }
        }

        #[test]
        fn maps_of_every_size_hold_one_key(key in 0_u32..1 << 21) {
            let mut map = Identifiers::<1>::new();
            prop_assert_eq!(map.insert(key, 7), Ok(()));
            prop_assert_eq!(map.get(key), Some(7));
            prop_assert_eq!(map.get(key ^ 1), None);
        }
    }
}
