//! Pseudo-random spans, so that nodes that failed together do not try again together.

use crate::time::Duration;

/// A sequence that depends on its seed only (SplitMix64): nodes with different seeds go different ways,
/// and a test can repeat them.
#[derive(Clone, Debug)]
pub(crate) struct Jitter(u64);

impl Jitter {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A span that is less than `limit`, or zero.
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "32 bits by 32 bits fit 64, and the sum is below the limit"
    )]
    pub(crate) fn below(&mut self, limit: Duration) -> Duration {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        // What is above the point of the product is uniform below the limit, without a division.
        let fraction = (mixed ^ mixed >> 31) >> 32;
        let (high, low) = (limit.as_ticks() >> 32, limit.as_ticks() & u64::from(u32::MAX));
        Duration::from_ticks(high * fraction + ((low * fraction) >> 32))
    }

    /// A span from half of `mean` to one and a half of it.
    pub(crate) fn around(&mut self, mean: Duration) -> Duration {
        Duration::from_ticks((mean.as_ticks() / 2).saturating_add(self.below(mean).as_ticks()))
    }
}

/// `span` a number of times, without an overflow: `fugit`'s own product would panic.
pub(crate) const fn times(span: Duration, factor: u64) -> Duration {
    Duration::from_ticks(span.as_ticks().saturating_mul(factor))
}

/// `span` doubled so often, less than 64 times, without an overflow.
pub(crate) fn doubled(span: Duration, times: u8) -> Duration {
    Duration::from_ticks(span.as_ticks().min(u64::MAX >> times) << times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_stay_below_their_limit_and_differ() {
        let limit = Duration::from_millis(10);
        let (mut one, mut other) = (Jitter::new(1), Jitter::new(2));
        let mut equal = 0;
        for _ in 0..1000 {
            let (a, b) = (one.below(limit), other.below(limit));
            assert!(a < limit && b < limit);
            equal += u32::from(a == b);
        }
        assert_eq!(equal, 0);
        assert_eq!(one.below(Duration::from_ticks(0)), Duration::from_ticks(0));
        // Far beyond the longest span: no overflow, and spans as long as that.
        let spans = [(); 1000].map(|()| one.below(Duration::from_ticks(u64::MAX)).as_ticks());
        assert!(spans.iter().any(|span| *span > u64::MAX / 100 * 99));
        assert!(spans.iter().any(|span| *span < u64::MAX / 100));
        assert!(one.around(limit) >= Duration::from_millis(5));
    }

    #[test]
    fn spans_are_doubled_up_to_the_longest() {
        let doubled = |span, times| doubled(Duration::from_ticks(span), times).as_ticks();
        assert_eq!((doubled(3, 0), doubled(3, 4)), (3, 48));
        assert_eq!(doubled(u64::MAX / 2, 8), u64::MAX >> 8 << 8);
    }
}
