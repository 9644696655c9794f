//! A calendar that was found. Below planner and analysis, both of which speak of it.

use super::request::ticks;
use super::spread::longest_stretch;
use cosmic_core::calendar::{Calendar, CalendarError, Segment, Slot, SlotTimes};
use cosmic_core::time::Duration;

/// How a calendar was found.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Method {
    /// There was nothing to place.
    Empty,
    /// By quick placement.
    Placement,
    /// By the complete search.
    Search,
    /// By the complete search over single occurrences, within the jitter that channels allow.
    Occurrences,
}

/// A slot with what it is for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PlannedSlot {
    /// Position of its channel in [`Cluster::channels`](crate::cluster::Cluster::channels).
    pub channel: usize,
    /// Position of its publisher in [`Cluster::nodes`](crate::cluster::Cluster::nodes).
    pub node: usize,
    /// The slot as it stands in the calendar.
    pub slot: Slot,
    /// Its instants.
    pub times: SlotTimes,
    /// The pool whose window it shares: position in [`Cluster::pools`](crate::cluster::Cluster::pools).
    pub pool: Option<usize>,
}

/// A calendar for a cluster.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Plan {
    pub(super) segment: Segment,
    pub(super) cycle: Duration,
    pub(super) slots: Vec<PlannedSlot>,
    pub(super) method: Method,
}

impl Plan {
    /// What holds for all slots.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// After this span everything repeats.
    pub fn cycle(&self) -> Duration {
        self.cycle
    }

    /// The slots, by phase.
    pub fn slots(&self) -> &[PlannedSlot] {
        &self.slots
    }

    /// How the calendar was found.
    pub fn method(&self) -> Method {
        self.method
    }

    /// The windows in one cycle, in order of time: ready instant and slot. One of each shared window.
    pub fn occurrences(&self) -> Vec<(Duration, &PlannedSlot)> {
        let mut all = Vec::new();
        for planned in &self.slots {
            let period = planned.slot.period.as_ticks();
            for turn in 0..self.cycle.as_ticks() / period.max(1) {
                all.push((Duration::from_ticks(planned.slot.phase.as_ticks() + turn * period), planned));
            }
        }
        all.sort_by_key(|(ready, planned)| (*ready, planned.slot.etag));
        all
    }

    /// The share of time that windows reserve.
    pub fn reserved(&self) -> f64 {
        let mut shared = Vec::new();
        let mut share = 0.0;
        for planned in &self.slots {
            if let Some(pool) = planned.pool {
                if shared.contains(&(pool, planned.slot.phase)) {
                    continue;
                }
                shared.push((pool, planned.slot.phase));
            }
            share += planned.times.delivery.as_ticks() as f64 / planned.slot.period.as_ticks() as f64;
        }
        share
    }

    /// The smallest gap between two windows that follow each other; the whole cycle if there is none.
    pub fn narrowest_gap(&self) -> Duration {
        let mut windows: Vec<(u64, u64)> = Vec::new();
        for (ready, planned) in self.occurrences() {
            let window = (ready.as_ticks(), ready.as_ticks() + planned.times.delivery.as_ticks());
            // Slots of a pool share their window.
            if windows.last() != Some(&window) {
                windows.push(window);
            }
        }
        let cycle = self.cycle.as_ticks();
        let next =
            windows.iter().skip(1).map(|window| window.0).chain(windows.first().map(|first| first.0 + cycle));
        let gaps = windows.iter().zip(next).map(|(window, next)| next.saturating_sub(window.1));
        Duration::from_ticks(gaps.min().unwrap_or(cycle))
    }

    /// How long windows follow each other without a gap, at most.
    pub fn longest_stretch(&self) -> Duration {
        let windows: Vec<(i64, i64)> = self
            .occurrences()
            .iter()
            .map(|(ready, planned)| (ticks(*ready), ticks(planned.times.delivery)))
            .collect();
        let longest = longest_stretch(&windows, ticks(self.cycle).max(1));
        Duration::from_ticks(longest.unsigned_abs())
    }

    /// The calendar as the firmware will have it.
    ///
    /// # Errors
    /// The calendar's own check finds something wrong, which would be a fault of the planner.
    pub fn calendar(&self) -> Result<Calendar, CalendarError> {
        let slots: Vec<Slot> = self.slots.iter().map(|planned| planned.slot).collect();
        // A calendar refers to constants in the image; here it lives as long as the program.
        Calendar::new(self.segment, self.cycle, slots.leak())
    }
}
