//! What a master keeps: when the next sync frame is due, and which one waits for its time-stamp.

use crate::can::TxNode;
use crate::protocol::{FollowUp, SyncMessage, SyncSequence};
use crate::time::{Duration, GlobalClock, Instant};

#[derive(Clone, Debug)]
pub(super) struct Mastership {
    sync_at: Instant,
    sequence: SyncSequence,
    /// Given out for transmission at this instant, not confirmed.
    outstanding_since: Option<Instant>,
    /// The first one since the last that was confirmed was given out then.
    unheard_since: Option<Instant>,
    follow_up: Option<FollowUp>,
    predecessor: TxNode,
    handover_ends: Option<Instant>,
}

impl Mastership {
    /// The first sync frame is due now; its number is the one after `last`. Until `handover_ends` the time
    /// scale is that of `predecessor`.
    pub(super) const fn new(
        now: Instant,
        last: SyncSequence,
        predecessor: TxNode,
        handover_ends: Instant,
    ) -> Self {
        Self {
            sync_at: now,
            sequence: last,
            outstanding_since: None,
            unheard_since: None,
            follow_up: None,
            predecessor,
            handover_ends: Some(handover_ends),
        }
    }

    /// The number of the last sync frame.
    pub(super) const fn sequence(&self) -> SyncSequence {
        self.sequence
    }

    pub(super) const fn predecessor(&self) -> TxNode {
        self.predecessor
    }

    /// Returns whether it is time that the handover ends. Then the master is its own predecessor.
    pub(super) fn end_handover(&mut self, now: Instant, own: TxNode) -> bool {
        let ends = self.handover_ends.is_some_and(|at| now >= at);
        if ends {
            self.handover_ends = None;
            self.predecessor = own;
        }
        ends
    }

    /// Returns whether no sync frame has been sent for this long. Then nobody hears this node.
    pub(super) fn is_unheard(&self, now: Instant, time_out: Duration) -> bool {
        self.unheard_since.is_some_and(|since| now >= since + time_out)
    }

    pub(super) fn take_follow_up(&mut self) -> Option<FollowUp> {
        self.follow_up.take()
    }

    /// The sequence number of the sync frame that is due, and whether the one before was never confirmed.
    /// One that is not confirmed yet is given another two periods.
    pub(super) fn next_sync(&mut self, now: Instant, period: Duration) -> Option<(SyncSequence, bool)> {
        if now < self.sync_at {
            return None;
        }
        self.sync_at = self.sync_at + period;
        if self.sync_at <= now {
            // Late by more than a period: what was missed is not made up.
            self.sync_at = now + period;
        }
        if let Some(since) = self.outstanding_since
            && now < since + period + period
        {
            return None;
        }
        let unsent = self.outstanding_since.replace(now).is_some();
        self.unheard_since = self.unheard_since.or(Some(now));
        self.sequence = self.sequence.next();
        Some((self.sequence, unsent))
    }

    /// Was this the outstanding sync frame? Then its follow-up is due.
    pub(super) fn on_sent(&mut self, message: &SyncMessage, sent_at: Instant, clock: &GlobalClock) -> bool {
        if message.sequence != self.sequence || self.outstanding_since.take().is_none() {
            return false;
        }
        self.unheard_since = None;
        self.follow_up = Some(FollowUp { sequence: self.sequence, sent_at: clock.to_global(sent_at) });
        true
    }

    pub(super) fn next_wakeup(&self) -> Instant {
        if self.follow_up.is_some() {
            return Instant::EPOCH;
        }
        self.handover_ends.map_or(self.sync_at, |ends| ends.min(self.sync_at))
    }
}
