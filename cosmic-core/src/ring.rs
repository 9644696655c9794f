//! A small first-in first-out queue.

/// Up to `N` values in the order of their arrival; of none it is never more than empty.
#[derive(Clone, Debug)]
pub(crate) struct Ring<T: Copy, const N: usize> {
    slots: [Option<T>; N],
    first: usize,
    len: usize,
}

impl<T: Copy, const N: usize> Ring<T, N> {
    pub(crate) const fn new() -> Self {
        Self { slots: [None; N], first: 0, len: 0 }
    }

    /// How many more values fit.
    #[expect(clippy::arithmetic_side_effects, reason = "never more than `N`")]
    pub(crate) const fn room(&self) -> usize {
        N - self.len
    }

    /// Appends `value`; `false` if there is no room.
    #[must_use]
    #[expect(clippy::arithmetic_side_effects, reason = "positions below `N`, which is not zero")]
    pub(crate) fn push(&mut self, value: T) -> bool {
        if N == 0 || self.len == N {
            return false;
        }
        if let Some(slot) = self.slots.get_mut(Self::wrapped(self.first + self.len)) {
            *slot = Some(value);
            self.len += 1;
        }
        true
    }

    /// Removes the oldest value.
    #[expect(clippy::arithmetic_side_effects, reason = "positions below `N`, and it was not empty")]
    pub(crate) fn pop(&mut self) -> Option<T> {
        let value = self.slots.get_mut(self.first)?.take()?;
        self.first = Self::wrapped(self.first + 1);
        self.len -= 1;
        Some(value)
    }

    /// `at` places behind the first of the array, which is less than twice its length.
    #[expect(clippy::arithmetic_side_effects, reason = "which was asked")]
    const fn wrapped(at: usize) -> usize {
        if at < N { at } else { at - N }
    }

    /// Returns whether there is none.
    pub(crate) const fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_in_first_out_and_no_more_than_fits() {
        let mut ring = Ring::<u8, 2>::new();
        for round in 0..5 {
            assert!(ring.push(round) && ring.push(round + 1));
            assert!(!ring.push(9));
            assert_eq!((ring.pop(), ring.pop(), ring.pop()), (Some(round), Some(round + 1), None));
        }
        assert_eq!(ring.room(), 2);
    }
}
