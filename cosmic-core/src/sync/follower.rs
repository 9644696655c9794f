//! What a node does with sync frames and follow-ups: it pairs them, decides whom to follow, and keeps an
//! estimate of the master's time scale.

use super::estimate::Estimate;
use super::event::count;
use super::{ClockEvent, ClockSync, Standing};
use crate::can::TxNode;
use crate::protocol::{FollowUp, Rank, SyncMessage, SyncSequence};
use crate::time::{Duration, GlobalInstant, Instant};

#[derive(Clone, Debug)]
pub(super) struct Following {
    pub(super) master: TxNode,
    pub(super) rank: Rank,
    /// The predecessor that the master named last.
    pub(super) predecessor: TxNode,
    /// When the last pair was heard, plausible or not.
    pub(super) heard_at: Instant,
    /// The sequence number of the last pair.
    pub(super) sequence: SyncSequence,
    /// From here on nobody is left on another time scale.
    pub(super) trusted_from: Instant,
    pub(super) estimate: Estimate,
    /// Implausible pairs since the last plausible one.
    pub(super) implausible: u8,
    /// The loss has been reported.
    pub(super) lost: bool,
}

/// A sync frame that waits for its follow-up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pending {
    pub(super) from: TxNode,
    pub(super) message: SyncMessage,
    pub(super) received_at: Instant,
}

/// A sync frame and its follow-up.
#[derive(Clone, Copy)]
pub(super) struct Pair {
    pub(super) from: TxNode,
    pub(super) message: SyncMessage,
    pub(super) received_at: Instant,
    pub(super) sent_at: GlobalInstant,
}

impl<const CANDIDATE: bool> ClockSync<CANDIDATE> {
    pub(super) fn on_sync(&mut self, sync: Pending) {
        let period = self.config.period;
        if let Some(pending) = &self.pending {
            let age = sync.received_at.saturating_since(pending.received_at);
            if pending.from == sync.from {
                // The later copy of a repeated frame is the one that the master has time-stamped.
                let repeated = pending.message.sequence == sync.message.sequence && age < period;
                let counters = &mut self.counters;
                count(if repeated { &mut counters.duplicates } else { &mut counters.follow_ups_missed });
            } else if precedes(pending, &sync) && age < Duration::from_ticks(period.as_ticks() / 4) {
                // Frames of two masters interleave: the better one's follow-up is awaited.
                count(&mut self.counters.foreign);
                return;
            } else {
                count(&mut self.counters.follow_ups_missed);
            }
        }
        self.pending = Some(sync);
    }

    pub(super) fn on_follow_up(&mut self, from: TxNode, message: FollowUp, received_at: Instant) {
        let matching = self.pending.filter(|pending| {
            pending.from == from
                && pending.message.sequence == message.sequence
                && received_at.saturating_since(pending.received_at) < self.config.period
        });
        let Some(Pending { message: sync, received_at, .. }) = matching else {
            count(&mut self.counters.syncs_missed);
            return;
        };
        self.pending = None;
        self.on_pair(Pair { from, message: sync, received_at, sent_at: message.sent_at });
        self.schedule_takeover();
    }

    fn on_pair(&mut self, pair: Pair) {
        if pair.sent_at >= FollowUp::END {
            return self.refuse(pair.from);
        }
        match &self.role {
            Standing::Listening { .. } => self.follow_anew(&pair),
            Standing::Following(following) if following.master == pair.from => self.on_own_master(&pair),
            Standing::Following(following) => {
                let in_office = (following.rank, following.master);
                // A master that sent a frame lately is in office, even if one of its frames was lost.
                let alive = pair.received_at.saturating_since(following.heard_at) < self.config.periods(2);
                if alive && in_office < (pair.message.rank, pair.from) {
                    count(&mut self.counters.foreign);
                } else {
                    self.change_master(&pair);
                }
            }
            Standing::Master(_) => self.on_other_master(&pair),
        }
    }

    /// This node is master, too.
    fn on_other_master(&mut self, pair: &Pair) {
        if !CANDIDATE {
            return;
        }
        if self.own_place().is_some_and(|own| own < (pair.message.rank, pair.from)) {
            count(&mut self.counters.foreign);
        } else {
            self.yield_to(pair);
        }
    }

    /// No time scale stands there: whoever sent this is no master.
    fn refuse(&mut self, master: TxNode) {
        count(&mut self.counters.out_of_range);
        if self.refused.replace(master) != Some(master) {
            self.tell(ClockEvent::OutOfRange { master });
        }
    }

    fn on_own_master(&mut self, pair: &Pair) {
        let Standing::Following(following) = &mut self.role else { return };
        let silent = pair.received_at.saturating_since(following.heard_at);
        if following.sequence == pair.message.sequence && silent < self.config.period {
            // A repeated sync frame and its repeated follow-up.
            count(&mut self.counters.duplicates);
            return;
        }
        // A master that was away may have followed another one in between, and continue that one's scale.
        let predecessor = pair.message.predecessor;
        let same_scale = predecessor == following.predecessor || predecessor == pair.from;
        if silent >= self.config.holdover() || !same_scale {
            return self.follow_anew(pair);
        }
        following.heard_at = pair.received_at;
        following.sequence = pair.message.sequence;
        following.predecessor = predecessor;
        following.lost = false;
        if following.estimate.observe(pair.received_at, pair.sent_at).is_ok() {
            following.implausible = 0;
            self.accept(pair);
        } else {
            self.reject(pair);
        }
    }

    fn reject(&mut self, pair: &Pair) {
        let Standing::Following(following) = &mut self.role else { return };
        following.implausible = following.implausible.saturating_add(1);
        let persistent = following.implausible >= IMPLAUSIBLE_LIMIT;
        count(&mut self.counters.implausible);
        if persistent {
            self.restart(pair);
            self.tell(ClockEvent::Restarted { master: pair.from });
        } else {
            self.tell(ClockEvent::Implausible { master: pair.from });
        }
    }

    fn change_master(&mut self, pair: &Pair) {
        let Standing::Following(following) = &self.role else { return };
        let estimate = if pair.message.predecessor == following.master {
            self.continuation(&following.estimate, pair)
        } else {
            None
        };
        let trusted_from = following.trusted_from;
        match estimate {
            Some(estimate) => self.follow(pair, estimate, trusted_from, true),
            None => self.follow_anew(pair),
        }
    }

    fn yield_to(&mut self, pair: &Pair) {
        self.tell(ClockEvent::Yielded { to: pair.from });
        if let Standing::Master(mastership) = &self.role {
            self.last_sequence = mastership.sequence();
        }
        self.given_up_until = pair.received_at + self.config.given_up();
        let own = Estimate::exact(&self.config, pair.received_at, &self.clock);
        let estimate =
            if Some(pair.message.predecessor) == self.tx_node { self.continuation(&own, pair) } else { None };
        match estimate {
            Some(estimate) => self.follow(pair, estimate, pair.received_at, true),
            None => self.follow_anew(pair),
        }
    }

    /// What is known of the new master's time scale, which continues that of `old`. `None` if it does not.
    fn continuation(&self, old: &Estimate, pair: &Pair) -> Option<Estimate> {
        let rate_error = self.config.takeover_rate_error();
        let mut estimate = old.continued(pair.received_at, pair.message.accuracy, rate_error)?;
        estimate.observe(pair.received_at, pair.sent_at).ok()?;
        Some(estimate)
    }

    fn follow_anew(&mut self, pair: &Pair) {
        self.restart(pair);
        self.tell(ClockEvent::MasterChanged { master: pair.from, continued: false });
    }

    fn restart(&mut self, pair: &Pair) {
        let estimate = Estimate::new(&self.config, pair.received_at, pair.sent_at);
        self.set_following(pair, estimate, pair.received_at + self.config.holdover());
    }

    fn follow(&mut self, pair: &Pair, estimate: Estimate, trusted_from: Instant, continued: bool) {
        self.set_following(pair, estimate, trusted_from);
        self.tell(ClockEvent::MasterChanged { master: pair.from, continued });
    }

    fn set_following(&mut self, pair: &Pair, estimate: Estimate, trusted_from: Instant) {
        self.role = Standing::Following(Following {
            master: pair.from,
            rank: pair.message.rank,
            predecessor: pair.message.predecessor,
            heard_at: pair.received_at,
            sequence: pair.message.sequence,
            trusted_from,
            estimate,
            implausible: 0,
            lost: false,
        });
        self.accept(pair);
    }

    /// Makes the clock after a pair that is part of the estimate.
    fn accept(&mut self, pair: &Pair) {
        let Standing::Following(following) = &self.role else { return };
        count(&mut self.counters.used);
        let trusted = pair.received_at >= following.trusted_from;
        let valid_until = if trusted { pair.received_at + self.config.holdover() } else { Instant::EPOCH };
        let distance = pair.message.accuracy;
        let in_handover = !distance.is_zero();
        let more_rate = if in_handover { self.config.takeover_rate_error() } else { 0 };
        let clock = following.estimate.clock(distance, more_rate, valid_until);
        self.set_clock(clock);
        self.compare_calendars(pair);
    }

    fn compare_calendars(&mut self, pair: &Pair) {
        let (own, other) = (self.config.calendar_digest, pair.message.calendar_digest);
        let mismatch = own != 0 && other != 0 && own != other;
        if mismatch != self.calendar_mismatch {
            self.calendar_mismatch = mismatch;
            let master = pair.from;
            self.tell(if mismatch {
                ClockEvent::CalendarMismatch { master }
            } else {
                ClockEvent::CalendarMatch { master }
            });
        }
    }
}

/// Returns whether the sender of the first comes before that of the second in the succession.
fn precedes(first: &Pending, second: &Pending) -> bool {
    (first.message.rank, first.from) < (second.message.rank, second.from)
}

/// So many implausible pairs in a row are believed.
const IMPLAUSIBLE_LIMIT: u8 = 3;
