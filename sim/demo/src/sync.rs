//! Whether a node had reason to lose the time of the cluster: sync frames that were destroyed or not sent, or its
//! own absence from the bus.

use std::collections::BTreeSet;

use cosmic_bus::VirtualInstant;
use cosmic_core::can::TxNode;
use cosmic_core::protocol::{FollowUp, SyncMessage};
use cosmic_core::time::Duration;

use crate::bus_log::Ending;
use crate::clock::GlobalTimeline;
use crate::journal::Journal;
use crate::span::Span;

/// The frames of the clock synchronisation in a run.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Syncs {
    /// Ends of the follow-ups that were sent.
    sent: Vec<VirtualInstant>,
    /// Ends of the sync and follow-up frames that were destroyed.
    destroyed: Vec<VirtualInstant>,
    /// Who tried to send a sync frame, whatever became of it, and when the attempt ended.
    tried: Vec<(VirtualInstant, TxNode)>,
}

impl Syncs {
    /// Those on the bus of a run.
    pub fn of(journal: &Journal) -> Self {
        let mut syncs = Self::default();
        for attempt in journal.bus.attempts() {
            let Some(frame) = attempt.frame() else { continue };
            let is_follow_up = FollowUp::decode(&frame).is_some();
            let is_sync = SyncMessage::decode(&frame).is_some();
            if is_sync {
                syncs.tried.push((attempt.end, frame.id.tx_node()));
            }
            match attempt.ending {
                Ending::Sent if is_follow_up => syncs.sent.push(attempt.end),
                Ending::Failed(_) if is_follow_up || is_sync => syncs.destroyed.push(attempt.end),
                Ending::Sent | Ending::Failed(_) | Ending::Open => {}
            }
        }
        syncs
    }

    /// Returns whether the nodes can agree on the time at `at`: in the [`MEMORY`] before, the time master was heard,
    /// did not follow another one, and no other node took itself for the master. Several do when none hears the
    /// others: each goes by its own time then, and what it tries to send tells of it even where all is destroyed.
    pub fn give_common_time(&self, timeline: &GlobalTimeline, at: VirtualInstant) -> bool {
        let from = (-Span::from(MEMORY)).after(at);
        let mut before = timeline.terms().iter().rev().skip_while(|term| term.from > at);
        let has_changed = before.next().is_some_and(|term| term.from > from) && before.next().is_some();
        !has_changed && count(&self.sent, from, at) > 0 && self.masters(from, at) <= 1
    }

    /// How many nodes took themselves for the time master in a span.
    fn masters(&self, from: VirtualInstant, until: VirtualInstant) -> usize {
        let first = self.tried.partition_point(|(at, _)| *at < from);
        let within = self.tried[first..].iter().take_while(|(at, _)| *at <= until);
        within.map(|(_, node)| *node).collect::<BTreeSet<_>>().len()
    }

    /// Returns whether a node may have lost the time of the cluster by `at`: in the [`MEMORY`] before, a frame was
    /// destroyed, or fewer were sent than the plan says, or the node was off the bus.
    pub fn were_disturbed(&self, journal: &Journal, node: TxNode, at: VirtualInstant) -> bool {
        let from = (-Span::from(MEMORY)).after(at);
        let span = Span::between(from, at).as_nanos();
        // One may be under way at each end.
        let planned = span.checked_div(Span::from(journal.cluster.sync_period).as_nanos()).unwrap_or(0) - 2;
        let sent = i64::try_from(count(&self.sent, from, at)).unwrap_or(i64::MAX);
        count(&self.destroyed, from, at) > 0 || sent < planned || journal.was_off(node, from, at)
    }
}

/// How many of these, which are in order, lie in a span.
fn count(instants: &[VirtualInstant], from: VirtualInstant, until: VirtualInstant) -> usize {
    instants.partition_point(|it| *it <= until) - instants.partition_point(|it| *it < from)
}

/// For so long a node feels a disturbance: it takes some sync frames in a row until its clock is as good as before.
const MEMORY: Duration = Duration::from_secs(1);
