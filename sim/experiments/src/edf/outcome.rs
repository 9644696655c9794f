//! What a run at one load has shown.

use super::message_set::Timing;

/// A run at one load.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Run {
    /// Whether all deadlines were met.
    pub(super) all_met: bool,
    /// The share of the bus that the messages took, by the lengths that their frames had.
    pub(super) utilisation: f64,
}

/// Measures the lengths of the frames that were sent.
pub(super) struct Meter {
    /// Frames and bits of each message.
    sent: Vec<(u64, u64)>,
}

impl Meter {
    pub(super) fn new(messages: usize) -> Self {
        Self { sent: vec![(0, 0); messages] }
    }

    /// A frame of a message was sent; its length includes the intermission.
    pub(super) fn sent(&mut self, message: usize, bits: u32) {
        let (frames, total) = &mut self.sent[message];
        *frames += 1;
        *total += u64::from(bits);
    }

    pub(super) fn missed(&self, timings: &[Timing]) -> Run {
        Run { all_met: false, utilisation: self.utilisation(timings) }
    }

    pub(super) fn all_met(&self, timings: &[Timing]) -> Run {
        Run { all_met: true, utilisation: self.utilisation(timings) }
    }

    /// The sum over the messages of mean length by period. Independent of where in its periods a run ends.
    fn utilisation(&self, timings: &[Timing]) -> f64 {
        let share = |((frames, bits), timing): (&(u64, u64), &Timing)| {
            let mean = *bits as f64 / (*frames).max(1) as f64;
            mean * NANOSECONDS_A_BIT / timing.period.as_ticks() as f64
        };
        self.sent.iter().zip(timings).map(share).sum()
    }
}

const NANOSECONDS_A_BIT: f64 = 1_000.0;
