//! What the hard real-time frames take from the others.
//!
//! A frame of a slot is loaded at its ready instant and wins every arbitration from then on. What is
//! reserved but not used costs nothing: other frames go there by arbitration. So in any window the
//! calendar costs the frames whose loading falls into it; retransmissions are counted by the error model.

use crate::plan::found::Plan;

/// The most hard real-time transmission that can be loaded in any window of a given length.
#[derive(Clone, Default, Debug)]
pub struct CalendarLoad {
    cycle: u64,
    total: u64,
    /// By how much two ready instants can come closer: clocks differ, and nodes act late.
    slack: u64,
    /// (length of a closed window, most load in it), both rising.
    steps: Vec<(u64, u64)>,
}

impl CalendarLoad {
    /// The load of a plan. O(n² log n) in the slots of a cycle.
    pub fn of(plan: &Plan) -> Self {
        let rate = plan.segment().bit_rate;
        let frames: Vec<(u64, u64)> = plan
            .occurrences()
            .iter()
            .map(|(ready, planned)| {
                let frame = rate.longest_frame(usize::from(planned.slot.len));
                (ready.as_ticks(), frame.as_ticks())
            })
            .collect();
        Self::from_frames(plan.cycle().as_ticks(), plan.segment().gap().as_ticks(), &frames)
    }

    fn from_frames(cycle: u64, slack: u64, frames: &[(u64, u64)]) -> Self {
        let total = frames.iter().map(|(_, cost)| cost).sum();
        let mut windows = Vec::with_capacity(frames.len() * frames.len());
        for first in 0..frames.len() {
            let mut load = 0;
            for behind in 0..frames.len() {
                let at = first + behind;
                let turn = (at / frames.len()) as u64 * cycle;
                let (ready, cost) = frames[at % frames.len()];
                load += cost;
                windows.push((ready + turn - frames[first].0, load));
            }
        }
        windows.sort_unstable();
        let mut steps: Vec<(u64, u64)> = Vec::new();
        for (span, load) in windows {
            match steps.last_mut() {
                Some(last) if load <= last.1 => {}
                Some(last) if span == last.0 => last.1 = load,
                _ => steps.push((span, load)),
            }
        }
        Self { cycle, total, slack, steps }
    }

    /// The most transmission time that is loaded in a window of length `span`.
    pub fn within(&self, span: u64) -> u64 {
        if self.cycle == 0 || self.steps.is_empty() {
            return 0;
        }
        let span = span.saturating_add(self.slack);
        let rest = span % self.cycle;
        let step = self.steps.partition_point(|(length, _)| *length <= rest);
        let rest = step.checked_sub(1).map_or(0, |at| self.steps[at].1);
        (span / self.cycle).saturating_mul(self.total).saturating_add(rest)
    }

    /// As a node takes it that admits channels.
    pub(super) fn demand(&self) -> (u64, u64, u64, &[(u64, u64)]) {
        (self.cycle, self.total, self.slack, &self.steps)
    }

    /// The share of time that the frames take, without faults.
    pub fn utilisation(&self) -> f64 {
        if self.cycle == 0 { 0.0 } else { self.total as f64 / self.cycle as f64 }
    }

    /// The longest frame.
    pub fn longest(&self) -> u64 {
        self.steps.first().map_or(0, |(_, load)| *load)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_take_the_worst_alignment() {
        // Frames of 10 at 0, of 20 at 100, of 5 at 120, in a cycle of 1000.
        let load = CalendarLoad::from_frames(1000, 0, &[(0, 10), (100, 20), (120, 5)]);
        assert_eq!([0, 19, 20, 119, 120, 999].map(|t| load.within(t)), [20, 20, 25, 30, 35, 35]);
        // Around the end of the cycle: 120, 1000, 1100 lie within 980.
        assert_eq!(load.within(1000), 55);
        assert_eq!(load.within(3000), 3 * 35 + 20);
        let late = CalendarLoad::from_frames(1000, 5, &[(0, 10), (100, 20), (120, 5)]);
        assert_eq!(late.within(15), 25);
        assert_eq!(CalendarLoad::default().within(77), 0);
    }
}
