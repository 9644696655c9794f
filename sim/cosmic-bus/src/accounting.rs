//! What the bus was busy with.

use crate::frame::WireFrame;
use cosmic_core::can::{Frame, Priority};

/// The class of traffic a frame belongs to, by its priority field.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum TrafficClass {
    /// Hard real-time.
    Hard,
    /// Soft real-time.
    Soft,
    /// Non real-time, configuration and binding included.
    NonRealTime,
    /// Standard and remote frames: not of COSMIC.
    Foreign,
}

impl TrafficClass {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Hard, Self::Soft, Self::NonRealTime, Self::Foreign];

    /// The class of a frame.
    pub fn of(frame: &WireFrame) -> Self {
        match Frame::try_from(*frame).map(|frame| frame.id.priority()) {
            Ok(Priority::HARD) => Self::Hard,
            Ok(priority) if priority <= Priority::SOFT_LEAST_URGENT => Self::Soft,
            Ok(_) => Self::NonRealTime,
            Err(_) => Self::Foreign,
        }
    }
}

/// Counters since the start of the simulation.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Accounting {
    bits: [u64; TrafficClass::ALL.len()],
    frames: [u64; TrafficClass::ALL.len()],
    pub(crate) error_bits: u64,
    pub(crate) failed_attempts: u64,
    pub(crate) inverted: u64,
    pub(crate) omitted: u64,
    omission_degrees: Vec<u64>,
}

impl Accounting {
    /// Bits of complete frames of a class, the three bits of intermission behind each included.
    pub const fn bits(&self, class: TrafficClass) -> u64 {
        self.bits[class as usize]
    }

    /// Complete frames of a class.
    pub const fn frames(&self, class: TrafficClass) -> u64 {
        self.frames[class as usize]
    }

    /// Bits of frames that failed and of error frames, intermission included.
    pub const fn error_bits(&self) -> u64 {
        self.error_bits
    }

    /// All bits in which the bus was not free.
    pub fn busy_bits(&self) -> u64 {
        self.bits.iter().sum::<u64>() + self.error_bits
    }

    /// Frames on the wire that ended in an error frame, whatever the reason.
    pub const fn failed_attempts(&self) -> u64 {
        self.failed_attempts
    }

    /// Frames that the fault model hit with an inverted bit.
    pub const fn inverted(&self) -> u64 {
        self.inverted
    }

    /// Inconsistent omissions that the fault model made.
    pub const fn omitted(&self) -> u64 {
        self.omitted
    }

    /// Frames by the number of attempts that failed before the frame was sent: element k counts those with
    /// omission degree k. Frames withdrawn or still pending are not counted.
    pub fn omission_degrees(&self) -> &[u64] {
        &self.omission_degrees
    }

    pub(crate) fn complete(&mut self, frame: &WireFrame, bits: u32) {
        let class = TrafficClass::of(frame) as usize;
        self.bits[class] += u64::from(bits);
        self.frames[class] += 1;
    }

    pub(crate) fn sent_after(&mut self, failures: u32) {
        let degree = failures as usize;
        if self.omission_degrees.len() <= degree {
            self.omission_degrees.resize(degree + 1, 0);
        }
        self.omission_degrees[degree] += 1;
    }
}
