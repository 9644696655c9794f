//! How busy the bus is: bits and frames of each class over the last second, and a minute of history.

use std::collections::VecDeque;

use cosmic_bus::TrafficClass;
use cosmic_core::can::BitRate;
use cosmic_core::time::Instant;

use crate::snapshot::{LoadView, Share};

const CLASSES: usize = TrafficClass::ALL.len();

/// Counts what crosses the bus. Every call takes constant time.
#[derive(Clone, Debug)]
pub(crate) struct Load {
    started: u64,
    /// The number of the present tenth of a second.
    present: u64,
    /// The last second, and the present tenth.
    tenths: [Tenth; TENTHS],
    history: VecDeque<[f64; CLASSES]>,
    frames: u64,
    bits: u64,
}

#[derive(Clone, Copy, Default, Debug)]
struct Tenth {
    bits: [u32; CLASSES],
    frames: [u32; CLASSES],
}

impl Load {
    pub(crate) fn new(at: Instant) -> Self {
        let present = tenth_of(at);
        let (tenths, history) = ([Tenth::default(); TENTHS], VecDeque::new());
        Self { started: present, present, tenths, history, frames: 0, bits: 0 }
    }

    /// A frame of so many bits, the space behind it included.
    pub(crate) fn add(&mut self, class: TrafficClass, bits: u32, at: Instant, rate: BitRate) {
        self.advance(at, rate);
        let tenth = &mut self.tenths[self.present as usize % TENTHS];
        let class = class as usize;
        tenth.bits[class] = tenth.bits[class].saturating_add(bits);
        tenth.frames[class] = tenth.frames[class].saturating_add(1);
        self.frames += 1;
        self.bits += u64::from(bits);
    }

    pub(crate) fn advance(&mut self, at: Instant, rate: BitRate) {
        let now = tenth_of(at);
        // What is older than the history is not walked through.
        let longest = (SECONDS + 2) as u64 * 10;
        self.present = self.present.max(now.saturating_sub(longest));
        while self.present < now {
            self.present += 1;
            self.tenths[self.present as usize % TENTHS] = Tenth::default();
            if self.present.is_multiple_of(10) {
                if self.history.len() == SECONDS {
                    self.history.pop_front();
                }
                self.history.push_back(self.shares(rate));
            }
        }
    }

    /// The share of the last second, or of what there is of it.
    fn shares(&self, rate: BitRate) -> [f64; CLASSES] {
        let bits = rate.bits_per_second() as f64 * self.seconds();
        let mut shares = [0.0; CLASSES];
        for (class, share) in shares.iter_mut().enumerate() {
            *share = self.whole_tenths().map(|tenth| f64::from(tenth.bits[class])).sum::<f64>() / bits;
        }
        shares
    }

    fn seconds(&self) -> f64 {
        (self.present - self.started).clamp(1, 10) as f64 / 10.0
    }

    fn whole_tenths(&self) -> impl Iterator<Item = &Tenth> {
        let present = self.present as usize % TENTHS;
        self.tenths.iter().enumerate().filter(move |(at, _)| *at != present).map(|(_, tenth)| tenth)
    }

    pub(crate) fn view(&self, rate: BitRate) -> LoadView {
        let frames = self.whole_tenths().flat_map(|tenth| tenth.frames).map(f64::from).sum::<f64>();
        LoadView {
            bits_per_second: rate.bits_per_second(),
            now: share(self.shares(rate)),
            history: self.history.iter().copied().map(share).collect(),
            frames_per_second: frames / self.seconds(),
            frames: self.frames,
            bits: self.bits,
        }
    }
}

fn share([hard, soft, non_real_time, foreign]: [f64; CLASSES]) -> Share {
    Share { hard, soft, non_real_time, foreign }
}

fn tenth_of(at: Instant) -> u64 {
    at.since_epoch().as_ticks() / 100_000_000
}

const TENTHS: usize = 11;
/// Of history.
const SECONDS: usize = 60;

/// Events a second, over the last second.
#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct Rate {
    second: u64,
    present: u32,
    before: u32,
}

impl Rate {
    pub(crate) fn add(&mut self, at: Instant) {
        self.advance(at);
        self.present = self.present.saturating_add(1);
    }

    fn advance(&mut self, at: Instant) {
        let second = at.since_epoch().as_secs();
        if second != self.second {
            self.before = if second == self.second + 1 { self.present } else { 0 };
            (self.present, self.second) = (0, second);
        }
    }

    /// What there is of the present second, and the rest of the one before it.
    pub(crate) fn per_second(mut self, at: Instant) -> f64 {
        self.advance(at);
        let passed = (at.since_epoch().as_ticks() % 1_000_000_000) as f64 / 1e9;
        f64::from(self.present) + f64::from(self.before) * (1.0 - passed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::time::Duration;

    fn at(ms: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(ms))
    }

    #[test]
    fn the_share_is_of_the_last_second() {
        let mut load = Load::new(at(0));
        for ms in 0..2_000 {
            load.add(TrafficClass::Soft, 128, at(ms), BitRate::MAX);
            load.add(TrafficClass::Hard, 160, at(ms), BitRate::MAX);
        }
        load.advance(at(2_000), BitRate::MAX);
        let view = load.view(BitRate::MAX);
        assert_eq!((view.now.soft, view.now.hard, view.now.foreign), (0.128, 0.16, 0.0));
        assert_eq!((view.frames_per_second, view.frames, view.history.len()), (2_000.0, 4_000, 2));
        load.advance(at(3_200), BitRate::MAX);
        assert_eq!(load.view(BitRate::MAX).now.soft, 0.0);
    }

    #[test]
    fn a_leap_of_years_takes_a_bounded_walk() {
        let mut load = Load::new(at(0));
        load.add(TrafficClass::Soft, 128, Instant::FAR_FUTURE, BitRate::MAX);
        assert!(load.view(BitRate::MAX).history.len() <= SECONDS);
    }

    #[test]
    fn a_rate_falls_to_zero_when_nothing_comes() {
        let mut rate = Rate::default();
        (0..100).for_each(|event| rate.add(at(1_000 + 10 * event)));
        assert_eq!(rate.per_second(at(2_000)), 100.0);
        assert_eq!(rate.per_second(at(2_500)), 50.0);
        assert_eq!(rate.per_second(at(3_000)), 0.0);
    }
}
