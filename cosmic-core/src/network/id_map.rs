//! From an identifier to what it means here, in bounded time.
//!
//! A node must tell at once whether a received frame concerns it, however many channels it has; the
//! sequential table of an earlier implementation was its main cost (UPS). This is an open hash table
//! with linear probing whose *insertion* refuses any place more than [`PROBES`] from home, so that every
//! look-up, hit or miss, ends after at most that many compares. The broker hands etags out in sequence
//! and calendars number theirs in sequence; the table uses the low bits as they are, so such etags get
//! places of their own and a look-up costs one compare.

/// A look-up compares at most this many keys.
pub const PROBES: usize = 8;

// Identifiers have 29 bits, so these are none.
const VACANT: u32 = u32::MAX;
const REMOVED: u32 = u32::MAX - 1;

/// A map from identifiers, or etags, to small indices. `N`, a power of two, is the number of keys that it
/// is meant for; it has twice as many places.
#[derive(Clone, Debug)]
pub struct IdMap<const N: usize> {
    keys: [[u32; 2]; N],
    values: [[u8; 2]; N],
}

/// No place within [`PROBES`] of home is left for the key.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoPlace;

impl<const N: usize> IdMap<N> {
    const MASK: usize = {
        assert!(N.is_power_of_two(), "the capacity of a map must be a power of two");
        2 * N - 1
    };

    /// An empty map.
    pub const fn new() -> Self {
        Self { keys: [[VACANT; 2]; N], values: [[0; 2]; N] }
    }

    /// What stands under the key. At most [`PROBES`] compares.
    #[inline]
    pub fn get(&self, key: u32) -> Option<u8> {
        let at = self.find(key)?;
        self.values.as_flattened().get(at).copied()
    }

    /// Puts `value` under `key`, in place of an earlier value. At most 2 · [`PROBES`] compares.
    ///
    /// # Errors
    /// [`NoPlace`] if there is none; the map is as before.
    pub fn insert(&mut self, key: u32, value: u8) -> Result<(), NoPlace> {
        let at = self.find(key).or_else(|| self.free_place(key)).ok_or(NoPlace)?;
        self.keys.as_flattened_mut()[at] = key;
        self.values.as_flattened_mut()[at] = value;
        Ok(())
    }

    /// Removes the key, if it is there. At most [`PROBES`] compares.
    pub fn remove(&mut self, key: u32) {
        if let Some(at) = self.find(key) {
            // Not vacant: keys behind this place must still be found.
            self.keys.as_flattened_mut()[at] = REMOVED;
        }
    }

    #[inline]
    fn find(&self, key: u32) -> Option<usize> {
        let keys = self.keys.as_flattened();
        let mut at = key as usize & Self::MASK;
        for _ in 0..PROBES {
            match keys.get(at) {
                Some(&found) if found == key => return Some(at),
                Some(&VACANT) | None => return None,
                Some(_) => at = (at + 1) & Self::MASK,
            }
        }
        None
    }

    fn free_place(&self, key: u32) -> Option<usize> {
        let keys = self.keys.as_flattened();
        (0..PROBES)
            .map(|probe| (key as usize + probe) & Self::MASK)
            .find(|&at| matches!(keys.get(at), Some(&(VACANT | REMOVED))))
    }
}

impl<const N: usize> Default for IdMap<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashMap;

    #[test]
    fn a_full_neighbourhood_is_refused_and_leaves_the_map_as_it_was() {
        let mut map = IdMap::<16>::new();
        for key in 0..PROBES as u32 {
            map.insert(key * 32, key as u8).unwrap();
        }
        assert_eq!(map.insert(32 * 100, 1), Err(NoPlace));
        assert_eq!(map.get(32 * 100), None);
        assert_eq!(map.get(32 * 7), Some(7));
    }

    #[test]
    fn sequences_of_etags_fill_it_to_its_capacity() {
        let mut map = IdMap::<64>::new();
        for n in 0..64 {
            map.insert(16_383 - n, n as u8).unwrap();
        }
        assert!((0..64).all(|n| map.get(16_383 - n) == Some(n as u8)));
    }

    proptest! {
        #[test]
        fn it_is_a_map(steps in prop::collection::vec((0_u32..64, prop::option::of(any::<u8>())), 0..200)) {
            let mut map = IdMap::<32>::new();
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
    }
}
