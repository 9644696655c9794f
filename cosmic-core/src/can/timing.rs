//! How long frames take.
//!
//! An extended data frame of `s` bytes has `54 + 8 s` bits that are subject to bit stuffing, 10 that
//! are not, and 3 bits of inter-frame space. At worst every fourth stuffable bit behind the first is
//! followed by a stuff bit: `67 + 8 s + floor((53 + 8 s) / 4) = 80 + 10 s` bits. (The formula of 1994
//! gives 154 for eight bytes; real frames of 158 exist.)

use crate::time::Duration;

/// The longest frame with its inter-frame space: eight bytes, all stuff bits.
pub const LONGEST_FRAME_BITS: u32 = longest_frame_bits(super::Payload::MAX_LEN);

/// Bits from the detection of an error until the next frame can start, at worst.
pub const ERROR_RECOVERY_BITS: u32 = 31;

/// Length in bits of the longest frame with `len` bytes of data, inter-frame space included.
#[expect(clippy::arithmetic_side_effects, reason = "a length is at most eight")]
pub const fn longest_frame_bits(len: usize) -> u32 {
    80 + 10 * len as u32
}

/// The bit rate of a segment.
///
/// Only rates whose bit time is a whole number of nanoseconds exist here, which all usual ones are
/// (1 Mbit/s, 800, 500, 250, 125, 100, 50, 20, 10 kbit/s).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BitRate(u32);

impl BitRate {
    /// 1 Mbit/s, the fastest.
    pub const MAX: Self = Self(1_000_000);
    /// 10 kbit/s, the slowest.
    pub const MIN: Self = Self(10_000);

    /// `None` outside `MIN..=MAX`, or if the bit time is no whole number of nanoseconds.
    #[expect(clippy::arithmetic_side_effects, reason = "not zero: it is at least the slowest rate")]
    pub const fn new(bits_per_second: u32) -> Option<Self> {
        if bits_per_second < Self::MIN.0
            || bits_per_second > Self::MAX.0
            || 1_000_000_000 % bits_per_second != 0
        {
            return None;
        }
        Some(Self(bits_per_second))
    }

    /// Bits per second.
    pub const fn bits_per_second(self) -> u32 {
        self.0
    }

    /// The time of one bit.
    pub const fn bit_time(self) -> Duration {
        self.bits(1)
    }

    /// The time of `count` bits.
    #[expect(clippy::arithmetic_side_effects, reason = "the product of 32 bits by 17 fits")]
    pub const fn bits(self, count: u32) -> Duration {
        // A rate is not zero; the compiler need not know.
        let bit_time = match 1_000_000_000_u32.checked_div(self.0) {
            Some(nanoseconds) => nanoseconds,
            None => 0,
        };
        Duration::from_ticks(count as u64 * bit_time as u64)
    }

    /// The longest time that a frame with `len` bytes takes, inter-frame space included.
    pub const fn longest_frame(self, len: usize) -> Duration {
        self.bits(longest_frame_bits(len))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longest_frames() {
        assert_eq!(longest_frame_bits(0), 80);
        assert_eq!(LONGEST_FRAME_BITS, 160);
        assert_eq!(BitRate::MAX.longest_frame(8), Duration::from_micros(160));
        let slow = BitRate::new(125_000).unwrap();
        assert_eq!(slow.bit_time(), Duration::from_micros(8));
    }

    #[test]
    fn odd_rates_are_refused() {
        assert_eq!(BitRate::new(0), None);
        assert_eq!(BitRate::new(333_333), None);
        assert_eq!(BitRate::new(2_000_000), None);
    }
}
