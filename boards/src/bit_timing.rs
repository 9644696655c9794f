//! The bit timing register (`CAN_BTR`) for a bit rate.
//!
//! A bit is divided into time quanta: one for synchronisation, segment 1 up to the sample point, and
//! segment 2 behind it (RM0090, bxCAN bit timing). Of the divisions that give the bit rate exactly, the
//! one whose sample point lies nearest to 87.5 % is taken, which CiA 301 recommends.

use cosmic_core::can::BitRate;

/// A division of the bit, as the register holds it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BitTiming {
    prescaler: u32,
    segment_1: u32,
    segment_2: u32,
}

impl BitTiming {
    /// The division of a bit of `bit_rate` where the peripheral runs at `clock` Hz. `None` if that clock
    /// cannot give the rate exactly.
    pub const fn new(clock: u32, bit_rate: BitRate) -> Option<Self> {
        let mut best: Option<(Self, u32)> = None;
        // More quanta place the sample point more finely, so that a tie goes to the larger number.
        let mut quanta = MOST_QUANTA;
        while quanta >= FEWEST_QUANTA {
            let divisor = bit_rate.bits_per_second() * quanta;
            if clock.is_multiple_of(divisor) && clock / divisor <= LARGEST_PRESCALER {
                // The sample point stands behind the synchronisation quantum and segment 1.
                let before = (quanta * SAMPLE_POINT_PERMILLE + 500) / 1000;
                let segment_2 = quanta - before;
                let off = before * 1_000_000 / quanta;
                let off = off.abs_diff(SAMPLE_POINT_PERMILLE * 1000);
                let nearer = match best {
                    None => true,
                    Some((_, least)) => off < least,
                };
                if nearer && segment_2 >= 1 && segment_2 <= 8 && before >= 2 && before <= 17 {
                    let timing = Self { prescaler: clock / divisor, segment_1: before - 1, segment_2 };
                    best = Some((timing, off));
                }
            }
            quanta -= 1;
        }
        match best {
            Some((timing, _)) => Some(timing),
            None => None,
        }
    }

    /// The value of `CAN_BTR`, with the widest resynchronisation jump that segment 2 allows.
    pub const fn register(self) -> u32 {
        let jump = if self.segment_2 < 4 { self.segment_2 } else { 4 };
        (jump - 1) << 24 | (self.segment_2 - 1) << 20 | (self.segment_1 - 1) << 16 | (self.prescaler - 1)
    }

    /// Where the bit is sampled, in thousandths of it, rounded.
    pub const fn sample_point_permille(self) -> u32 {
        ((1 + self.segment_1) * 1000 + self.quanta() / 2) / self.quanta()
    }

    /// Time quanta in a bit.
    pub const fn quanta(self) -> u32 {
        1 + self.segment_1 + self.segment_2
    }

    /// By what the peripheral's clock is divided to give one time quantum.
    pub const fn prescaler(self) -> u32 {
        self.prescaler
    }
}

/// The clock of the controllers on every board: APB1 at 42 MHz, a quarter of the core's 168 MHz.
pub const APB1: u32 = 42_000_000;

// What CAN is used at, every board must give exactly, and sample where CiA 301 recommends.
const _: () = {
    let rates = [125_000, 250_000, 500_000, 1_000_000];
    let mut n = 0;
    while n < rates.len() {
        let Some(rate) = BitRate::new(rates[n]) else { panic!("a bit rate") };
        let Some(timing) = BitTiming::new(APB1, rate) else { panic!("a rate that APB1 cannot give") };
        let sample_point = timing.sample_point_permille();
        assert!(sample_point >= 850 && sample_point <= 900, "a bit is sampled too early or too late");
        n += 1;
    }
};

const FEWEST_QUANTA: u32 = 8;
const MOST_QUANTA: u32 = 25;
const LARGEST_PRESCALER: u32 = 1024;
const SAMPLE_POINT_PERMILLE: u32 = 875;

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK: u32 = 42_000_000;

    #[test]
    fn every_usual_rate_is_exact() {
        for rate in [1_000_000, 500_000, 250_000, 125_000, 100_000, 50_000, 20_000, 10_000] {
            let timing = BitTiming::new(CLOCK, BitRate::new(rate).unwrap()).unwrap();
            assert_eq!(CLOCK / timing.prescaler() / timing.quanta(), rate);
            assert_eq!(CLOCK % (timing.prescaler() * timing.quanta()), 0);
            let sample = timing.sample_point_permille();
            assert!((850..=900).contains(&sample), "{rate}: sample point at {sample} permille");
        }
    }

    #[test]
    fn the_register_of_one_megabit() {
        let timing = BitTiming::new(CLOCK, BitRate::MAX).unwrap();
        // 14 quanta: prescaler 3, segment 1 of 11, segment 2 of 2, jump of 2.
        assert_eq!(timing, BitTiming { prescaler: 3, segment_1: 11, segment_2: 2 });
        assert_eq!(timing.register(), 0x011A_0002);
    }

    #[test]
    fn the_page_of_the_boards_has_the_timing_of_each_rate() {
        let page = include_str!("../../docs/boards.md");
        for rate in [1_000_000, 500_000, 250_000, 125_000] {
            let timing = BitTiming::new(APB1, BitRate::new(rate).unwrap()).unwrap();
            let BitTiming { prescaler, segment_1, segment_2 } = timing;
            let (quanta, point) = (timing.quanta(), timing.sample_point_permille());
            let row = std::format!(
                "| {} kbit/s | {prescaler} | {quanta} | {segment_1}, {segment_2} | {}.{} % | `0x{:08X}` |",
                rate / 1000,
                point / 10,
                point % 10,
                timing.register()
            );
            assert!(page.contains(&row), "docs/boards.md lacks: {row}");
        }
    }

    #[test]
    fn a_rate_that_the_clock_cannot_give_is_refused() {
        assert_eq!(BitTiming::new(CLOCK, BitRate::new(800_000).unwrap()), None);
    }
}
