//! Global time as a listener knows it, from sync frames and follow-ups.
//!
//! A link stamps frames late, by a time that differs from frame to frame. So of the last pairs the one with the least
//! delay counts, which is the one that puts global time furthest ahead; how far they scatter is the uncertainty.

use std::collections::VecDeque;

use cosmic_core::can::{Frame, TxNode};
use cosmic_core::protocol::{FollowUp, SyncMessage};
use cosmic_core::time::{Duration, GlobalInstant, Instant};

/// The clock of the cluster, followed.
#[derive(Clone, Debug)]
pub(crate) struct ListenerClock {
    pending: Option<Sync>,
    /// Instants of pairs, and how far global time is ahead of local time.
    points: VecDeque<(Instant, i64)>,
    last: Option<Sync>,
    steps: u32,
}

/// A sync frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sync {
    pub(crate) from: TxNode,
    pub(crate) message: SyncMessage,
    pub(crate) at: Instant,
}

/// Something about the clock that deserves a notice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum ClockNews {
    /// Another node than before is master, or the first one.
    Master { from: TxNode, before: Option<TxNode> },
    /// Global time has jumped by so many nanoseconds.
    Step { from: TxNode, by: i64 },
}

impl ListenerClock {
    pub(crate) fn new() -> Self {
        Self { pending: None, points: VecDeque::new(), last: None, steps: 0 }
    }

    /// Takes any frame; those of the clock synchronisation count.
    pub(crate) fn on_frame(&mut self, frame: &Frame, at: Instant) -> Option<ClockNews> {
        let from = frame.id.tx_node();
        if let Some(message) = SyncMessage::decode(frame) {
            self.pending = Some(Sync { from, message, at });
            return None;
        }
        let follow_up = FollowUp::decode(frame)?;
        let sync = self.pending.take()?;
        let is_its = sync.from == from && sync.message.sequence == follow_up.sequence;
        if !is_its || follow_up.sent_at >= FollowUp::END {
            return None;
        }
        let before = self.last.replace(sync).map(|last| last.from);
        let ahead = follow_up.sent_at.since_epoch().as_ticks().wrapping_sub(sync.at.since_epoch().as_ticks());
        let step = self.observe(sync.at, ahead.cast_signed());
        if before != Some(from) {
            return Some(ClockNews::Master { from, before });
        }
        step.map(|by| ClockNews::Step { from, by })
    }

    fn observe(&mut self, at: Instant, ahead: i64) -> Option<i64> {
        let step = self.ahead().map(|before| ahead.wrapping_sub(before));
        let step = step.filter(|step| step.unsigned_abs() > STEP.as_ticks());
        if step.is_some() {
            self.points.clear();
            self.steps = self.steps.saturating_add(1);
        } else if self.points.len() == POINTS {
            self.points.pop_front();
        }
        self.points.push_back((at, ahead));
        step
    }

    fn ahead(&self) -> Option<i64> {
        self.points.iter().map(|(_, ahead)| *ahead).max()
    }

    /// Global time at a local instant; `None` if no pair was heard lately.
    pub(crate) fn global(&self, at: Instant) -> Option<GlobalInstant> {
        let (last, _) = self.points.back()?;
        if at.saturating_since(*last) > HOLDOVER {
            return None;
        }
        let ticks = at.since_epoch().as_ticks().wrapping_add_signed(self.ahead()?);
        Some(GlobalInstant::from_epoch(Duration::from_ticks(ticks)))
    }

    /// How far the stamps scatter.
    pub(crate) fn uncertainty(&self) -> Option<Duration> {
        let least = self.points.iter().map(|(_, ahead)| *ahead).min()?;
        Some(Duration::from_ticks(self.ahead()?.wrapping_sub(least).unsigned_abs()))
    }

    /// The last sync frame that had its follow-up.
    pub(crate) fn last(&self) -> Option<&Sync> {
        self.last.as_ref()
    }

    pub(crate) fn steps(&self) -> u32 {
        self.steps
    }
}

/// Pairs that are kept: some hundred milliseconds to some seconds, in which clocks drift apart by microseconds.
const POINTS: usize = 16;
/// Without a pair for so long nothing is known any more.
const HOLDOVER: Duration = Duration::from_secs(10);
/// Further apart than any link delays a frame.
const STEP: Duration = Duration::from_millis(250);

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::protocol::{Rank, SyncSequence};

    const MASTER: TxNode = TxNode::new(3).unwrap();

    fn at(us: u64) -> Instant {
        Instant::from_epoch(Duration::from_micros(us))
    }

    fn pair(clock: &mut ListenerClock, number: u8, received: u64, sent: u64) -> Option<ClockNews> {
        let sequence = SyncSequence::new(number);
        let accuracy = Duration::from_ticks(0);
        let sync =
            SyncMessage { sequence, rank: Rank::FIRST, predecessor: MASTER, accuracy, calendar_digest: 7 };
        let sent_at = GlobalInstant::from_epoch(Duration::from_micros(sent));
        assert_eq!(clock.on_frame(&sync.encode(MASTER), at(received)), None);
        clock.on_frame(&FollowUp { sequence, sent_at }.encode(MASTER), at(received + 200))
    }

    #[test]
    fn the_least_delayed_pair_counts() {
        let mut clock = ListenerClock::new();
        assert_eq!(clock.global(at(0)), None);
        let first = ClockNews::Master { from: MASTER, before: None };
        assert_eq!(pair(&mut clock, 0, 10_300, 1_010_000), Some(first));
        assert_eq!(pair(&mut clock, 1, 110_000, 1_110_000), None);
        assert_eq!(pair(&mut clock, 2, 210_900, 1_210_000), None);
        let global = |us| clock.global(at(us)).map(|it| it.since_epoch().as_micros());
        assert_eq!(global(300_000), Some(1_300_000));
        assert_eq!(clock.uncertainty(), Some(Duration::from_micros(900)));
        assert_eq!(global(20_000_000), None);
    }

    #[test]
    fn a_step_is_told_and_followed() {
        let mut clock = ListenerClock::new();
        pair(&mut clock, 0, 10_000, 1_010_000);
        let step = ClockNews::Step { from: MASTER, by: 5_000_000_000 };
        assert_eq!(pair(&mut clock, 1, 110_000, 6_110_000), Some(step));
        assert_eq!(clock.global(at(110_000)).unwrap().since_epoch().as_micros(), 6_110_000);
    }

    #[test]
    fn a_follow_up_of_somebody_else_is_no_pair() {
        let mut clock = ListenerClock::new();
        pair(&mut clock, 0, 10_000, 1_010_000);
        let (sequence, sent_at) = (SyncSequence::new(1), GlobalInstant::EPOCH);
        let other = FollowUp { sequence, sent_at }.encode(TxNode::MAX);
        assert_eq!(clock.on_frame(&other, at(20_000)), None);
        assert_eq!(clock.last().unwrap().from, MASTER);
    }
}
