//! Bit timing: CNF1, CNF2 and CNF3 (data sheet, section 5).

use cosmic_core::can::BitRate;

/// The bit timing of a rate and an oscillator.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BitTiming {
    prescaler: u32,
    propagation: u32,
    segment_1: u32,
    segment_2: u32,
}

impl BitTiming {
    /// The exact timing whose sample point is nearest to 87.5 %; `None` if the oscillator does not give the
    /// rate exactly. One of 8 MHz does not give 1 Mbit/s: that would be four time quanta, and a bit has five
    /// at least.
    pub const fn new(oscillator_hz: u32, bit_rate: BitRate) -> Option<Self> {
        let mut best: Option<(Self, u32)> = None;
        let mut quanta = MOST_QUANTA;
        while quanta >= FEWEST_QUANTA {
            let divisor = 2 * quanta * bit_rate.bits_per_second();
            let prescaler = oscillator_hz / divisor;
            if oscillator_hz.is_multiple_of(divisor) && prescaler >= 1 && prescaler <= LARGEST_PRESCALER {
                let mut segment_2 = 2;
                while segment_2 <= 8 {
                    // Before the sample point: the synchronisation quantum, propagation and segment 1, which
                    // have up to eight quanta each and together no fewer than segment 2.
                    let rest = quanta.saturating_sub(1 + segment_2);
                    if rest >= 2 && rest <= 16 && rest >= segment_2 {
                        let propagation = rest / 2;
                        let timing =
                            Self { prescaler, propagation, segment_1: rest - propagation, segment_2 };
                        let off = timing.sample_point_permille().abs_diff(SAMPLE_POINT_PERMILLE);
                        let nearer = match best {
                            None => true,
                            Some((_, least)) => off < least,
                        };
                        if nearer {
                            best = Some((timing, off));
                        }
                    }
                    segment_2 += 1;
                }
            }
            quanta -= 1;
        }
        match best {
            Some((timing, _)) => Some(timing),
            None => None,
        }
    }

    /// CNF3, CNF2 and CNF1, which stand in this order. The synchronisation jump is as wide as segment 2
    /// allows: it must be longer.
    pub const fn registers(self) -> [u8; 3] {
        let jump = if self.segment_2 > 4 { 4 } else { self.segment_2 - 1 };
        [
            (self.segment_2 - 1) as u8,
            BTLMODE | ((self.segment_1 - 1) << 3 | (self.propagation - 1)) as u8,
            ((jump - 1) << 6 | (self.prescaler - 1)) as u8,
        ]
    }

    /// Where a bit is sampled, in thousandths of it.
    pub const fn sample_point_permille(self) -> u32 {
        (1 + self.propagation + self.segment_1) * 1_000 / self.quanta()
    }

    /// Time quanta in a bit.
    pub const fn quanta(self) -> u32 {
        1 + self.propagation + self.segment_1 + self.segment_2
    }
}

/// Segment 2 has the length that CNF3 says.
const BTLMODE: u8 = 1 << 7;
const FEWEST_QUANTA: u32 = 5;
const MOST_QUANTA: u32 = 25;
const LARGEST_PRESCALER: u32 = 64;
const SAMPLE_POINT_PERMILLE: u32 = 875;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_rates_are_exact_and_sampled_late() {
        for oscillator in [8_000_000, 16_000_000, 20_000_000] {
            for rate in [1_000_000, 500_000, 250_000, 125_000, 100_000, 50_000, 20_000] {
                let Some(timing) = BitTiming::new(oscillator, BitRate::new(rate).unwrap()) else {
                    assert_eq!((oscillator, rate), (8_000_000, 1_000_000));
                    continue;
                };
                assert_eq!(oscillator, 2 * timing.prescaler * timing.quanta() * rate);
                let sample = timing.sample_point_permille();
                // Eight quanta have no room for more than 75 %.
                let least = if timing.quanta() < 10 { 750 } else { 800 };
                assert!((least..=900).contains(&sample), "{oscillator} {rate}: {sample}");
                let [cnf3, cnf2, cnf1] = timing.registers();
                assert!(u32::from(cnf1 >> 6) + 1 < timing.segment_2, "the jump is shorter than segment 2");
                assert_eq!((u32::from(cnf3) + 1, cnf2 >> 7), (timing.segment_2, 1));
            }
        }
    }

    #[test]
    fn literal_registers() {
        let of = |oscillator, rate| BitTiming::new(oscillator, BitRate::new(rate).unwrap()).unwrap();
        // Eight quanta: 1 + 2 + 3 + 2.
        assert_eq!(of(16_000_000, 1_000_000).registers(), [0x01, 0x91, 0x00]);
        // Sixteen quanta: 1 + 6 + 7 + 2.
        assert_eq!(of(16_000_000, 500_000).registers(), [0x01, 0xB5, 0x00]);
        assert_eq!(of(8_000_000, 125_000).sample_point_permille(), 875);
    }
}
