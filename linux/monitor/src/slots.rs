//! The slots of the calendar against the frames that were seen in them.

use cosmic_core::can::{Etag, Id, TxNode};
use cosmic_core::time::{Duration, GlobalInstant};
use cosmic_plan::plan::PlannedSlot;

use crate::plan::SegmentPlan;
use crate::snapshot::SlotView;

/// All slots of a plan.
#[derive(Clone, Debug)]
pub(crate) struct Slots {
    slots: Vec<SlotSeen>,
}

#[derive(Clone, Debug)]
struct SlotSeen {
    planned: PlannedSlot,
    frames: u64,
    missed: u64,
    outside: u64,
    /// The number of the occurrence up to which all is counted.
    counted: Option<u64>,
    last: Option<i64>,
    earliest: Option<i64>,
    latest: Option<i64>,
}

/// Where a hard real-time frame stood.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Standing {
    /// No slot of the plan is of this channel and this publisher.
    Unplanned,
    /// It has one, and nothing is known of global time.
    Unknown,
    /// In its window.
    Inside,
    /// Outside of its window.
    Outside,
}

impl Slots {
    pub(crate) fn new(plan: Option<&SegmentPlan>) -> Self {
        let seen = |planned: &PlannedSlot| SlotSeen {
            planned: *planned,
            frames: 0,
            missed: 0,
            outside: 0,
            counted: None,
            last: None,
            earliest: None,
            latest: None,
        };
        Self { slots: plan.map_or_else(Vec::new, |plan| plan.slots().iter().map(seen).collect()) }
    }

    /// Takes a frame of priority 0 that ended at `ended`, known to `tolerance`. Linear in the slots of its channel and
    /// publisher, of which there is one, or one for each occurrence in a cycle.
    pub(crate) fn on_frame(&mut self, id: Id, ended: Option<GlobalInstant>, tolerance: Duration) -> Standing {
        let is_its = |slot: &SlotSeen| slot.is_of(id.etag(), id.tx_node());
        let nearest = |slot: &SlotSeen| ended.map(|ended| slot.after_ready(ended).unsigned_abs());
        let ours = self.slots.iter_mut().filter(|slot| is_its(slot));
        let Some(slot) = ours.min_by_key(|slot| nearest(slot)) else { return Standing::Unplanned };
        let Some(ended) = ended else { return Standing::Unknown };
        slot.see(ended, tolerance)
    }

    /// Counts occurrences of periodic slots that have passed without a frame; returns them. Linear in the slots.
    pub(crate) fn advance(&mut self, now: GlobalInstant, tolerance: Duration) -> Vec<(Etag, TxNode, u64)> {
        let missed = |slot: &mut SlotSeen| {
            let missed = slot.advance(now, tolerance);
            (missed > 0).then_some((slot.planned.slot.etag, slot.planned.slot.publisher, missed))
        };
        self.slots.iter_mut().filter_map(missed).collect()
    }

    /// Global time is another: what was missed before is unknown.
    pub(crate) fn forget_occurrences(&mut self) {
        self.slots.iter_mut().for_each(|slot| slot.counted = None);
    }

    pub(crate) fn views(&self, plan: &SegmentPlan) -> Vec<SlotView> {
        self.slots.iter().map(|slot| slot.view(plan)).collect()
    }
}

impl SlotSeen {
    fn is_of(&self, etag: Etag, publisher: TxNode) -> bool {
        (self.planned.slot.etag, self.planned.slot.publisher) == (etag, publisher)
    }

    /// The number of the nearest occurrence, and how far behind its ready instant this is.
    fn nearest(&self, at: GlobalInstant) -> (u64, i64) {
        let (period, phase) =
            (self.planned.slot.period.as_ticks().max(1), self.planned.slot.phase.as_ticks());
        let since = at.since_epoch().as_ticks().saturating_sub(phase);
        let (number, behind) = (since / period, since % period);
        // A frame that ends shortly before ready belongs to the occurrence that comes.
        if behind > self.planned.times.delivery.as_ticks() && period - behind < period / 8 {
            (number + 1, -i64::try_from(period - behind).unwrap_or(i64::MAX))
        } else {
            (number, i64::try_from(behind).unwrap_or(i64::MAX))
        }
    }

    fn after_ready(&self, at: GlobalInstant) -> i64 {
        self.nearest(at).1
    }

    fn see(&mut self, ended: GlobalInstant, tolerance: Duration) -> Standing {
        let (number, after) = self.nearest(ended);
        let early = i64::try_from(tolerance.as_ticks()).unwrap_or(i64::MAX);
        let late = i64::try_from((self.planned.times.deadline + tolerance).as_ticks()).unwrap_or(i64::MAX);
        if after < -early || after > late {
            self.outside += 1;
            return Standing::Outside;
        }
        self.frames += 1;
        self.last = Some(after);
        self.earliest = Some(self.earliest.map_or(after, |earliest| earliest.min(after)));
        self.latest = Some(self.latest.map_or(after, |latest| latest.max(after)));
        // A gap is counted here, the rest when time passes.
        if let Some(counted) = self.counted.filter(|counted| *counted < number) {
            self.missed += if self.planned.slot.periodic { number - counted - 1 } else { 0 };
        }
        self.counted = self.counted.max(Some(number));
        Standing::Inside
    }

    fn advance(&mut self, now: GlobalInstant, tolerance: Duration) -> u64 {
        let window = self.planned.times.delivery.as_ticks().saturating_add(tolerance.as_ticks());
        let period = self.planned.slot.period.as_ticks().max(1);
        let passed =
            now.since_epoch().as_ticks().saturating_sub(self.planned.slot.phase.as_ticks() + window) / period;
        // Before the first frame nothing is expected.
        let Some(counted) = self.counted else { return 0 };
        let missed = passed.saturating_sub(counted);
        self.counted = Some(counted.max(passed));
        if !self.planned.slot.periodic {
            return 0;
        }
        self.missed += missed;
        missed
    }

    fn view(&self, plan: &SegmentPlan) -> SlotView {
        let PlannedSlot { channel, slot, times, .. } = self.planned;
        SlotView {
            etag: slot.etag.get(),
            name: plan.channel(channel).name.clone(),
            publisher: slot.publisher.get(),
            period_ns: slot.period.as_ticks(),
            phase_ns: slot.phase.as_ticks(),
            deadline_ns: times.deadline.as_ticks(),
            delivery_ns: times.delivery.as_ticks(),
            frames: self.frames,
            missed: self.missed,
            outside: self.outside,
            last_ns: self.last,
            earliest_ns: self.earliest,
            latest_ns: self.latest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::can::Priority;
    use cosmic_plan::cluster::EXAMPLE;
    use cosmic_plan::document::Source;

    /// `wheel_speed` of the example: every 10 ms at 2 ms, deadline 522 us behind.
    fn slots() -> (Slots, Id) {
        let plan = SegmentPlan::parse(&Source::new("vehicle.toml", EXAMPLE)).unwrap();
        let planned = plan.slots()[0].slot;
        (Slots::new(Some(&plan)), Id::new(Priority::HARD, planned.publisher, planned.etag))
    }

    fn global(us: u64) -> Option<GlobalInstant> {
        Some(GlobalInstant::from_epoch(Duration::from_micros(us)))
    }

    #[test]
    fn frames_stand_in_their_window_or_outside() {
        let (mut slots, id) = slots();
        let tolerance = Duration::from_micros(50);
        for (us, standing) in [
            (1_002_130, Standing::Inside),
            (1_011_960, Standing::Inside),
            (1_022_560, Standing::Inside),
            (1_033_000, Standing::Outside),
            (1_041_900, Standing::Outside),
        ] {
            assert_eq!(slots.on_frame(id, global(us), tolerance), standing, "{us}");
        }
        let seen = &slots.slots[0];
        assert_eq!((seen.frames, seen.outside), (3, 2));
        assert_eq!((seen.earliest, seen.latest), (Some(-40_000), Some(560_000)));
        assert_eq!(slots.on_frame(id, None, tolerance), Standing::Unknown);
        let stranger = Id::new(Priority::HARD, TxNode::MAX, id.etag());
        assert_eq!(slots.on_frame(stranger, global(1), tolerance), Standing::Unplanned);
    }

    #[test]
    fn each_missed_occurrence_is_counted_once() {
        let (mut slots, id) = slots();
        let tolerance = Duration::from_micros(50);
        assert!(slots.advance(global(900_000).unwrap(), tolerance).is_empty(), "nothing was there yet");
        slots.on_frame(id, global(1_002_130), tolerance);
        assert!(slots.advance(global(1_009_000).unwrap(), tolerance).is_empty());
        // 1.012 and 1.022 are missed, and 1.032 has just begun.
        assert_eq!(slots.advance(global(1_032_100).unwrap(), tolerance), [(id.etag(), id.tx_node(), 2)]);
        slots.on_frame(id, global(1_032_130), tolerance);
        slots.on_frame(id, global(1_052_130), tolerance);
        assert_eq!(slots.slots[0].missed, 3);
        slots.forget_occurrences();
        assert!(slots.advance(global(9_000_000).unwrap(), tolerance).is_empty());
    }
}
