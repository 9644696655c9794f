//! Clocks seen from outside: the local time of each node, and the global time of the cluster.
//!
//! Only who watches the simulation knows true time. The local clock of a node is a straight line against
//! it. Global time is the time scale of the master: the sync frames on the bus say who that is, and each
//! follow-up says which global instant the master read at the end of its sync frame (Gergeleit and Streich).
//! So the judge needs no word from the nodes about their own estimate of global time.

use cosmic_bus::VirtualInstant;
use cosmic_core::can::TxNode;
use cosmic_core::protocol::{FollowUp, SyncMessage, SyncSequence};
use cosmic_core::time::{GlobalInstant, Instant};

use crate::bus_log::{Attempt, Ending};

/// A node's local time against true time: the straight line through two points.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NodeClock {
    local: Instant,
    at: VirtualInstant,
    local_span: i128,
    true_span: i128,
}

impl NodeClock {
    /// The line through two pairs of local and true time. `None` if they do not run the same way.
    pub fn through(first: (Instant, VirtualInstant), second: (Instant, VirtualInstant)) -> Option<Self> {
        let local_span = i128::from(second.0.signed_since(first.0));
        let true_span = i128::from(second.1.as_ticks()) - i128::from(first.1.as_ticks());
        if local_span == 0 || true_span == 0 || (local_span > 0) != (true_span > 0) {
            return None;
        }
        Some(Self { local: first.0, at: first.1, local_span, true_span })
    }

    /// When the clock shows `local`; not before the start of the simulation.
    pub fn instant(&self, local: Instant) -> VirtualInstant {
        let span = i128::from(local.signed_since(self.local)) * self.true_span;
        let at = i128::from(self.at.as_ticks()) + span.div_euclid(self.local_span);
        VirtualInstant::from_ticks(u64::try_from(at.max(0)).unwrap_or(u64::MAX))
    }

    /// What the clock shows at `at`.
    pub fn local(&self, at: VirtualInstant) -> Instant {
        let span = i128::from(at.as_ticks()) - i128::from(self.at.as_ticks());
        // Spans of a simulation are far below the 292 years that an i64 holds.
        self.local.offset_by((span * self.local_span).div_euclid(self.true_span) as i64)
    }
}

/// Global time of the cluster, from its sync frames.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct GlobalTimeline {
    terms: Vec<Term>,
}

/// The time of one master.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Term {
    /// The end of its first sync frame that had a follow-up.
    pub from: VirtualInstant,
    /// Who.
    pub master: TxNode,
    /// The digest of its calendar.
    pub calendar_digest: u32,
    clock: NodeClock,
    /// Global less local time of the master, in nanoseconds.
    offset: i64,
}

impl GlobalTimeline {
    /// Reads the sync frames that were sent. A node whose clock is not known is passed over.
    pub fn of(attempts: &[Attempt], clock_of: impl Fn(TxNode) -> Option<NodeClock>) -> Self {
        let mut terms: Vec<Term> = Vec::new();
        let mut pending: Option<(TxNode, SyncMessage, VirtualInstant)> = None;
        for attempt in attempts.iter().filter(|attempt| attempt.ending == Ending::Sent) {
            let Some(frame) = attempt.frame() else { continue };
            let sender = frame.id.tx_node();
            if let Some(message) = SyncMessage::decode(&frame) {
                pending = Some((sender, message, attempt.end));
            } else if let Some(follow_up) = FollowUp::decode(&frame) {
                let Some((master, message, end)) = pending.take() else { continue };
                if !belong_together((master, message.sequence), (sender, follow_up.sequence)) {
                    continue;
                }
                if let Some(clock) = clock_of(master) {
                    let offset = follow_up.sent_at.signed_since(as_global(clock.local(end)));
                    let calendar_digest = message.calendar_digest;
                    extend(&mut terms, Term { from: end, master, calendar_digest, clock, offset });
                }
            }
        }
        Self { terms }
    }

    /// The masters, in the order of their terms.
    pub fn terms(&self) -> &[Term] {
        &self.terms
    }

    /// Global time at `at`; `None` before the first sync frame.
    pub fn global(&self, at: VirtualInstant) -> Option<GlobalInstant> {
        let term = self.terms.iter().rev().find(|term| term.from <= at)?;
        Some(term.global(at))
    }

    /// The true instant of a global instant; `None` before the first sync frame.
    pub fn instant(&self, global: GlobalInstant) -> Option<VirtualInstant> {
        self.terms
            .iter()
            .rev()
            .map(|term| (term.from, term.instant(global)))
            .find_map(|(from, instant)| (instant >= from).then_some(instant))
    }
}

impl Term {
    fn global(&self, at: VirtualInstant) -> GlobalInstant {
        as_global(self.clock.local(at)).offset_by(self.offset)
    }

    fn instant(&self, global: GlobalInstant) -> VirtualInstant {
        let local = global.offset_by(self.offset.wrapping_neg());
        self.clock.instant(Instant::from_epoch(local.since_epoch()))
    }
}

/// The master reads its clock late, by its interrupt's latency. The least late reading is the best.
fn extend(terms: &mut Vec<Term>, term: Term) {
    match terms.last_mut() {
        Some(last) if last.master == term.master => last.offset = last.offset.min(term.offset),
        _ => terms.push(term),
    }
}

fn belong_together(sync: (TxNode, SyncSequence), follow_up: (TxNode, SyncSequence)) -> bool {
    sync == follow_up
}

fn as_global(local: Instant) -> GlobalInstant {
    GlobalInstant::from_epoch(local.since_epoch())
}

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_bus::{Bus, FaultModel, StationId, WireFrame};
    use cosmic_core::can::{BitRate, Frame};
    use cosmic_core::protocol::Rank;
    use cosmic_core::time::Duration;

    const MASTER: TxNode = TxNode::new(1).unwrap();

    fn local(nanoseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_ticks(nanoseconds))
    }

    fn true_at(nanoseconds: u64) -> VirtualInstant {
        VirtualInstant::from_ticks(nanoseconds)
    }

    /// Switched on at 5 ms, 100 ppm fast.
    fn clock() -> NodeClock {
        NodeClock::through((local(0), true_at(5_000_000)), (local(1_000_100_000), true_at(1_005_000_000)))
            .unwrap()
    }

    #[test]
    fn a_clock_is_a_straight_line_both_ways() {
        let clock = clock();
        assert_eq!(clock.local(true_at(105_000_000)), local(100_010_000));
        assert_eq!(clock.instant(local(100_010_000)), true_at(105_000_000));
        assert_eq!(clock.instant(local(0)), true_at(5_000_000));
        assert_eq!(NodeClock::through((local(5), true_at(1)), (local(5), true_at(9))), None);
        assert_eq!(NodeClock::through((local(5), true_at(1)), (local(4), true_at(9))), None);
    }

    fn station() -> StationId {
        Bus::new(BitRate::MAX, FaultModel::none()).attach("master")
    }

    fn sent(number: u64, frame: Frame, end: u64) -> Attempt {
        Attempt {
            number,
            station: station(),
            wire_frame: WireFrame::from(frame),
            attempt: 1,
            start: true_at(end - 130_000),
            end: true_at(end),
            ending: Ending::Sent,
            load: None,
        }
    }

    /// A sync frame that ends at `end`, and a follow-up that says that the master's clock was read `late`.
    fn pair(number: u64, end: u64, late: u64) -> [Attempt; 2] {
        let sequence = SyncSequence::new(number as u8);
        let (accuracy, calendar_digest) = (Duration::from_ticks(0), 7);
        let message =
            SyncMessage { sequence, rank: Rank::FIRST, predecessor: MASTER, accuracy, calendar_digest };
        let sent_at = as_global(clock().local(true_at(end))) + Duration::from_ticks(late);
        let follow_up = FollowUp { sequence, sent_at };
        [sent(number, message.encode(MASTER), end), sent(number + 1, follow_up.encode(MASTER), end + 300_000)]
    }

    #[test]
    fn global_time_is_the_masters_as_it_was_read_at_best() {
        let attempts = [pair(0, 50_000_000, 3_000), pair(2, 75_000_000, 1_200)].concat();
        let timeline = GlobalTimeline::of(&attempts, |node| (node == MASTER).then(clock));
        let [term] = timeline.terms() else { panic!("{timeline:?}") };
        assert_eq!((term.master, term.calendar_digest, term.from), (MASTER, 7, true_at(50_000_000)));
        assert_eq!(timeline.global(true_at(49_999_999)), None);
        let global = timeline.global(true_at(105_000_000)).unwrap();
        assert_eq!(global.since_epoch().as_ticks(), 100_010_000 + 1_200);
        let back = timeline.instant(global).unwrap();
        assert!(back.as_ticks().abs_diff(105_000_000) <= 1, "{back}");
    }

    #[test]
    fn a_follow_up_of_another_sync_frame_says_nothing() {
        let [sync, _] = pair(0, 50_000_000, 0);
        let [_, other] = pair(2, 75_000_000, 0);
        let timeline = GlobalTimeline::of(&[sync, other], |_| Some(clock()));
        assert_eq!(timeline.terms(), []);
    }
}
