//! Faults on the wire: by chance, from a seed, or by rule, for tests.
//!
//! The model decides before each frame what will happen to it, and draws the same number of random
//! numbers for each, so that adding a rule does not change the chances of the later frames. It decides
//! one frame ahead: the bus can then tell how long nothing will be heard of the next frame, whichever
//! that will be.

use crate::event::StationId;
use crate::filter::Filter;
use crate::frame::WireFrame;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A probability.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Chance(f64);

impl Chance {
    /// Never.
    pub const NEVER: Self = Self(0.0);
    /// Always.
    pub const ALWAYS: Self = Self(1.0);

    /// `None` outside `0.0..=1.0`.
    pub fn new(probability: f64) -> Option<Self> {
        (0.0..=1.0).contains(&probability).then_some(Self(probability))
    }

    /// The probability, `0.0..=1.0`.
    pub const fn get(self) -> f64 {
        self.0
    }

    /// What a uniformly drawn 64-bit number is below with this probability: 2^64 for 1.
    const fn threshold(self) -> u128 {
        (self.0 * 18_446_744_073_709_551_616.0) as u128
    }
}

/// A bit of a frame on the wire, stuff bits counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum BitPosition {
    /// Drawn uniformly from start of frame to end of frame.
    Drawn,
    /// So many bits behind the start of frame bit, which is 0; at most the last bit of the frame.
    FromStart(u32),
    /// So many bits before the last bit of the end of frame, which is 0; at most the start of frame.
    FromEnd(u32),
}

/// Which of the stations that receive a frame see an error.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Victims {
    /// Each with chance one half, but at least one.
    Drawn,
    /// These, as far as they receive the frame.
    These(Vec<StationId>),
}

/// What the transmitter sees of an error in the last but one bit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Transmitter {
    /// It sees the error flags and sends the frame again: who had accepted it receives it twice.
    Retransmits,
    /// A second disturbance hides the flags from it: the frame counts as sent, the victims never get it.
    Accepts,
}

/// What befalls a frame.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Fault {
    /// The level of the bus is inverted in this bit, for all stations.
    Inverted(BitPosition),
    /// Some receivers see an error in the last but one bit of the end of frame and reject the frame; the
    /// others accept it (ISO 11898-1: a receiver accepts at that bit, a transmitter one bit later).
    InconsistentOmission {
        /// Who sees it.
        victims: Victims,
        /// What the transmitter makes of it.
        transmitter: Transmitter,
    },
}

/// A fault for chosen frames.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Rule {
    /// Which frames. Each attempt counts, retransmissions included.
    pub frames: Filter,
    /// So many matching frames pass first.
    pub skip: u32,
    /// Then so many are hit.
    pub count: u32,
    /// How.
    pub fault: Fault,
}

/// Decides what befalls each frame.
#[derive(Clone, Debug)]
pub struct FaultModel {
    random: Pcg64Mcg,
    inversion_below: u128,
    omission_below: u128,
    rules: Vec<Rule>,
    upcoming: Draws,
}

impl FaultModel {
    /// No faults, until rules are added.
    pub fn none() -> Self {
        Self::seeded(0)
    }

    /// No faults yet; what is added is drawn from this seed.
    pub fn seeded(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let upcoming = Draws::draw(&mut random);
        Self { random, inversion_below: 0, omission_below: 0, rules: Vec::new(), upcoming }
    }

    /// Each frame is destroyed with this chance, independently, by an inverted bit drawn uniformly.
    #[must_use]
    pub const fn with_inversion(mut self, chance: Chance) -> Self {
        self.inversion_below = chance.threshold();
        self
    }

    /// Each frame that is not destroyed is omitted by some receivers with this chance, independently, and
    /// sent again.
    #[must_use]
    pub const fn with_omission(mut self, chance: Chance) -> Self {
        self.omission_below = chance.threshold();
        self
    }

    /// Adds a rule. Rules come before chance, and earlier rules before later ones.
    #[must_use]
    pub fn with_rule(mut self, rule: Rule) -> Self {
        self.add_rule(rule);
        self
    }

    /// Adds a rule while the bus runs.
    pub fn add_rule(&mut self, rule: Rule) {
        self.rules.push(rule);
    }

    /// Takes back all rules that have not been used up.
    pub fn clear_rules(&mut self) {
        self.rules.clear();
    }

    /// Decides what befalls the next frame, which is this one.
    pub(crate) fn decide(&mut self, frame: &WireFrame) -> Option<Decision> {
        let draws = core::mem::replace(&mut self.upcoming, Draws::draw(&mut self.random));
        let fault = self.by_rule(frame).or_else(|| self.by_chance(&draws));
        fault.map(|fault| Decision { fault, draws })
    }

    fn by_rule(&mut self, frame: &WireFrame) -> Option<Fault> {
        let at = self.rules.iter_mut().position(|rule| {
            let hits = rule.frames.matches(frame);
            if hits && rule.skip > 0 {
                rule.skip -= 1;
                return false;
            }
            hits && rule.count > 0
        })?;
        let rule = &mut self.rules[at];
        rule.count -= 1;
        let fault = rule.fault.clone();
        self.rules.retain(|rule| rule.count > 0);
        Some(fault)
    }

    fn by_chance(&self, draws: &Draws) -> Option<Fault> {
        if u128::from(draws.inversion) < self.inversion_below {
            Some(Fault::Inverted(BitPosition::Drawn))
        } else if u128::from(draws.omission) < self.omission_below {
            Some(Fault::InconsistentOmission {
                victims: Victims::Drawn,
                transmitter: Transmitter::Retransmits,
            })
        } else {
            None
        }
    }

    /// The first bit in which the next frame can be hit, whichever frame that is; `None` if it will not be.
    pub(crate) fn earliest_bit(&self) -> Option<u32> {
        let by_rule = self.rules.iter().filter(|rule| rule.skip == 0);
        let by_rule = by_rule.map(|rule| self.upcoming.earliest_bit(&rule.fault)).min();
        let by_chance = self.by_chance(&self.upcoming).map(|fault| self.upcoming.earliest_bit(&fault));
        by_rule.into_iter().chain(by_chance).min()
    }
}

/// A fault and the random numbers of its frame.
#[derive(Debug)]
pub(crate) struct Decision {
    pub(crate) fault: Fault,
    draws: Draws,
}

impl Decision {
    /// The inverted bit of a frame of `bits` bits.
    pub(crate) fn bit(&self, position: BitPosition, bits: u32) -> u32 {
        self.draws.bit(position, bits)
    }

    /// Those of the receivers that are to reject the frame.
    pub(crate) fn victims(&self, victims: &Victims, receivers: Vec<StationId>) -> Vec<StationId> {
        match victims {
            Victims::These(stations) => receivers.into_iter().filter(|it| stations.contains(it)).collect(),
            Victims::Drawn => {
                let mut random = Pcg64Mcg::seed_from_u64(self.draws.victims);
                let one = ((u128::from(random.next_u64()) * receivers.len() as u128) >> 64) as usize;
                let drawn = receivers.into_iter().enumerate();
                drawn.filter(|(at, _)| random.next_u64() >> 63 == 1 || *at == one).map(|it| it.1).collect()
            }
        }
    }
}

/// The random numbers of one frame.
#[derive(Clone, Debug)]
struct Draws {
    inversion: u64,
    bit: u64,
    omission: u64,
    victims: u64,
}

impl Draws {
    fn draw(random: &mut Pcg64Mcg) -> Self {
        Self {
            inversion: random.next_u64(),
            bit: random.next_u64(),
            omission: random.next_u64(),
            victims: random.next_u64(),
        }
    }

    fn bit(&self, position: BitPosition, bits: u32) -> u32 {
        let last = bits - 1;
        match position {
            BitPosition::Drawn => ((u128::from(self.bit) * u128::from(bits)) >> 64) as u32,
            BitPosition::FromStart(bit) => bit.min(last),
            BitPosition::FromEnd(bit) => last.saturating_sub(bit),
        }
    }

    /// Grows with the length of the frame, so the shortest frame has the earliest bit.
    fn earliest_bit(&self, fault: &Fault) -> u32 {
        match fault {
            Fault::Inverted(position) => self.bit(*position, crate::bits::SHORTEST_FRAME_BITS),
            Fault::InconsistentOmission { .. } => crate::bits::SHORTEST_FRAME_BITS - 2,
        }
    }
}
