//! What crosses, by channel and publisher.

use std::collections::BTreeMap;

use cosmic_core::Subject;
use cosmic_gateway::ip::Heard;
use cosmic_monitor::SegmentPlan;

use super::words::Line;
use crate::distances::Distances;

/// All flows that were heard.
#[derive(Default)]
pub(super) struct Flows {
    all: BTreeMap<(Subject, String), Flow>,
    /// Events of flows that found no place.
    pub(super) overlooked: u64,
}

/// The events of one publisher on one channel.
#[derive(Default, Debug)]
pub(super) struct Flow {
    pub(super) distances: Distances,
    pub(super) missing: u64,
    /// Events that were late, and those of which that is known.
    pub(super) late: u64,
    pub(super) judged: u64,
    pub(super) least_left_ns: Option<i64>,
    /// The longest time that one may have taken from its sender to here.
    pub(super) oldest_ns: Option<u64>,
    pub(super) last: Line,
}

impl Flows {
    /// Another event. Logarithmic in the flows, of which [`MOST`] are kept.
    pub(super) fn add(&mut self, plan: Option<&SegmentPlan>, heard: &Heard, at_ns: u64) {
        let line = Line::of(plan, heard, at_ns);
        let key = (heard.subject, line.place());
        if self.all.len() >= MOST && !self.all.contains_key(&key) {
            self.overlooked += 1;
            return;
        }
        let age = heard.age.map(|age| age.as_ticks());
        let left = line.left_ns;
        let flow = self.all.entry(key).or_default();
        flow.distances.add(heard.received_at);
        flow.missing += heard.missing;
        flow.judged += u64::from(left.is_some());
        flow.late += u64::from(left.is_some_and(|left| left < 0));
        flow.least_left_ns = [flow.least_left_ns, left].into_iter().flatten().min();
        flow.oldest_ns = flow.oldest_ns.max(age);
        flow.last = line;
    }

    /// By subject and publisher.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Flow> {
        self.all.values()
    }

    /// Those of each channel.
    pub(super) fn by_channel(&self) -> Vec<Vec<&Flow>> {
        let mut channels: BTreeMap<Subject, Vec<&Flow>> = BTreeMap::new();
        for ((subject, _), flow) in &self.all {
            channels.entry(*subject).or_default().push(flow);
        }
        channels.into_values().collect()
    }
}

/// Flows that are kept.
const MOST: usize = 4096;
