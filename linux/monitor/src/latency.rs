//! How near soft real-time events come to their deadlines. What can be told from a priority, and what not, stands at
//! [`LatencyView`].

use cosmic_core::can::Priority;
use cosmic_core::time::Duration;

use crate::snapshot::LatencyView;

/// Of one channel.
#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct Latency {
    view: Option<LatencyView>,
}

impl Latency {
    /// Takes a soft real-time frame that took `on_the_bus`. Constant time.
    pub(crate) fn add(
        &mut self,
        priority: Priority,
        step: Duration,
        on_the_bus: Duration,
        deadline: Option<Duration>,
    ) {
        let steps = i64::from(priority.get().saturating_sub(1));
        let step_ns = step.as_ticks();
        // A priority of one says nothing more than that there was less than one step left; by the end of the frame,
        // that may have passed.
        let left_ns = steps * i64_of(step_ns) - i64_of(on_the_bus.as_ticks());
        let age_ns = deadline.map(|deadline| (i64_of(deadline.as_ticks()) - left_ns).max(0).unsigned_abs());
        let before = self.view;
        self.view = Some(LatencyView {
            step_ns,
            frames: before.map_or(0, |view| view.frames) + 1,
            left_ns,
            least_left_ns: before.map_or(left_ns, |view| view.least_left_ns.min(left_ns)),
            age_ns,
            oldest_ns: before.and_then(|view| view.oldest_ns).max(age_ns),
            at_the_limit: before.map_or(0, |view| view.at_the_limit) + u64::from(steps == 0),
            least_urgent: before.map_or(0, |view| view.least_urgent)
                + u64::from(priority == Priority::SOFT_LEAST_URGENT),
        });
    }

    pub(crate) fn view(&self) -> Option<LatencyView> {
        self.view
    }
}

fn i64_of(ticks: u64) -> i64 {
    i64::try_from(ticks).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_priority_says_what_is_left_to_one_step() {
        let (step, frame) = (Duration::from_micros(160), Duration::from_micros(130));
        let deadline = Some(Duration::from_micros(4_000));
        let mut latency = Latency::default();
        latency.add(Priority::new(11), step, frame, deadline);
        let view = latency.view().unwrap();
        assert_eq!((view.left_ns, view.age_ns), (1_470_000, Some(2_530_000)));
        latency.add(Priority::SOFT_MOST_URGENT, step, frame, deadline);
        latency.add(Priority::SOFT_LEAST_URGENT, step, frame, deadline);
        let view = latency.view().unwrap();
        assert_eq!((view.frames, view.at_the_limit, view.least_urgent), (3, 1, 1));
        assert_eq!((view.least_left_ns, view.oldest_ns), (-130_000, Some(4_130_000)));
    }
}
