//! What may cross, and how much of it.
//!
//! A channel crosses only if the configuration names it, and only out of and into the segments that it allows. Toward a
//! segment three bounds hold:
//!
//! 1. the rate of the channel: a token bucket, in the node, as for every publisher of a channel that has a rate;
//! 2. the [ceiling](Ceiling) of the segment: the share of its bus that all that comes in may take. What the rate refuses
//!    is not charged to it, so a channel that is flooded does not keep the others out;
//! 3. the class: nothing comes in as hard real-time, and no etag comes from outside: the node binds the subject itself.

use cosmic_core::can::BitRate;
use cosmic_core::event_layer::EventRate;
use cosmic_core::time::{Duration, Instant};

use crate::keys::Name;

/// Segments that a channel may leave, or enter.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Reach {
    /// All of them.
    All,
    /// These.
    Only(Vec<Name>),
}

impl Reach {
    /// No segment.
    pub const NONE: Self = Self::Only(Vec::new());

    /// Returns whether this segment is one of them.
    pub fn has(&self, segment: &Name) -> bool {
        match self {
            Self::All => true,
            Self::Only(names) => names.contains(segment),
        }
    }
}

/// A share of a bus, in percent: 1 to 100.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Percent(u8);

impl Percent {
    /// `None` for zero, and above 100.
    pub const fn new(percent: u8) -> Option<Self> {
        if percent == 0 || percent > 100 { None } else { Some(Self(percent)) }
    }

    /// The number.
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// What the events that enter a segment may take of its bus: a token bucket of frame times. A frame counts as the
/// longest of its length.
#[derive(Clone, Copy, Debug)]
pub struct Ceiling {
    bit_rate: BitRate,
    share: Percent,
    /// The instant from which on the bucket would be full.
    nominal: Instant,
}

impl Ceiling {
    /// With a full bucket.
    pub const fn new(bit_rate: BitRate, share: Percent) -> Self {
        Self { bit_rate, share, nominal: Instant::EPOCH }
    }

    /// Returns whether one more frame may come in.
    pub fn has_room(&self, now: Instant) -> bool {
        self.nominal.saturating_since(now) <= BURST
    }

    /// A frame of so many bytes has come in.
    pub fn charge(&mut self, len: usize, now: Instant) {
        let frame = self.bit_rate.longest_frame(len).as_ticks();
        let of_share = Duration::from_ticks(frame.saturating_mul(100) / u64::from(self.share.0));
        self.nominal = self.nominal.max(now) + of_share;
    }
}

/// How often messages of several frames enter: a token bucket, as the node has one for events of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Bucket {
    rate: EventRate,
    /// The instant from which on the bucket would be full.
    nominal: Instant,
}

impl Bucket {
    /// A full bucket.
    pub const fn new(rate: EventRate) -> Self {
        Self { rate, nominal: Instant::EPOCH }
    }

    /// Charges a message. Returns whether it may enter; else nothing is charged.
    pub fn charge(&mut self, now: Instant) -> bool {
        let nominal = self.nominal.max(now);
        let fits = nominal.saturating_since(now) <= self.rate.tolerance();
        if fits {
            self.nominal = nominal + self.rate.interval();
        }
        fits
    }
}

/// So much of the share may come at once.
const BURST: Duration = Duration::from_millis(20);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_segment_gets_no_more_than_its_share() {
        let share = Percent::new(10).unwrap();
        let mut ceiling = Ceiling::new(BitRate::MAX, share);
        let (mut passed, mut first_burst) = (0, 0);
        // Ten thousand events a second, for ten seconds.
        for number in 0..100_000_u64 {
            let now = Instant::from_epoch(Duration::from_micros(1_000_000 + 100 * number));
            if ceiling.has_room(now) {
                ceiling.charge(8, now);
                passed += 1;
            }
            if number == 99 {
                first_burst = passed;
            }
        }
        // A frame takes 160 µs: a tenth of the bus are 625 a second.
        assert!((6250..=6270).contains(&passed), "{passed}");
        assert!((13..=20).contains(&first_burst), "{first_burst}");
    }

    #[test]
    fn messages_come_as_often_as_the_rate_says() {
        let mut bucket = Bucket::new(EventRate::sporadic(Duration::from_millis(10)).with_burst(3));
        let at = |milliseconds: u64| Instant::from_epoch(Duration::from_millis(1000 + milliseconds));
        let passed: Vec<_> =
            [0, 0, 0, 0, 9, 10, 10, 20, 100, 100, 100, 100].map(|ms| bucket.charge(at(ms))).into();
        let expected = [true, true, true, false, false, true, false, true, true, true, true, false];
        assert_eq!(passed, expected);
    }

    #[test]
    fn a_reach_names_segments() {
        let (here, there) = (Name::new("here").unwrap(), Name::new("there").unwrap());
        let reach = Reach::Only(vec![here.clone()]);
        assert!(reach.has(&here) && !reach.has(&there) && Reach::All.has(&there) && !Reach::NONE.has(&here));
        assert_eq!((Percent::new(0), Percent::new(101)), (None, None));
    }
}
