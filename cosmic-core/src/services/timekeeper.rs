//! What the services of a node do for its clock.

use super::Request;
use crate::calendar::Calendar;
use crate::can::{Frame, TxNode};
use crate::sync::{ClockEvent, ClockSync, SyncConfig, SyncConfigError, SyncCounters};
use crate::time::{GlobalClock, Instant};

/// The clock of a node, kept in time with that of the segment. `CANDIDATE` as in [`ClockSync`].
#[derive(Clone, Debug)]
pub struct Timekeeper<const CANDIDATE: bool = true> {
    sync: ClockSync<CANDIDATE>,
    inhibited: bool,
    last_event: Option<ClockEvent>,
}

impl<const CANDIDATE: bool> Timekeeper<CANDIDATE> {
    /// With this calendar, which says how long a bit is; `config` says the rest.
    ///
    /// # Errors
    /// The first setting that is refused.
    pub(super) fn new(
        config: SyncConfig,
        calendar: &Calendar,
        now: Instant,
    ) -> Result<Self, SyncConfigError> {
        let bit_time = calendar.segment().bit_rate.bit_time();
        let config = SyncConfig { calendar_digest: calendar.digest(), bit_time, ..config };
        Ok(Self { sync: ClockSync::new(config, now)?, inhibited: false, last_event: None })
    }

    /// The clock as of the last call.
    pub const fn clock(&self) -> GlobalClock {
        self.sync.clock()
    }

    /// Returns whether the node must keep silent, because its calendar is not that of the segment.
    pub const fn is_inhibited(&self) -> bool {
        self.inhibited
    }

    /// Returns whether this node is the master.
    pub const fn is_master(&self) -> bool {
        self.sync.is_master()
    }

    /// What was sent, used, and dropped.
    pub const fn counters(&self) -> &SyncCounters {
        self.sync.counters()
    }

    /// The node has been given its TxNode, or lost it.
    pub(super) fn set_tx_node(&mut self, tx_node: Option<TxNode>) {
        self.sync.set_tx_node(tx_node);
    }

    /// A frame of the clock synchronisation has arrived.
    pub(super) fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        self.sync.on_frame(frame, received_at);
    }

    pub(super) fn on_sent(&mut self, frame: &Frame, sent_at: Instant) {
        self.sync.on_sent(frame, sent_at);
    }

    /// The clock's part of [`Services::poll`](super::Services::poll).
    pub(super) fn poll(&mut self, now: Instant) -> Option<Request> {
        if let Some(frame) = self.sync.poll(now) {
            return Some(Request::SendUrgent(frame, now + self.sync.frame_lifetime()));
        }
        while let Some(event) = self.sync.poll_event() {
            self.last_event = Some(event);
        }
        if self.sync.take_change() {
            return Some(Request::Clock);
        }
        let mismatch = self.sync.has_calendar_mismatch();
        if self.inhibited != mismatch {
            self.inhibited = mismatch;
            return Some(Request::Inhibit(mismatch));
        }
        None
    }

    pub(super) fn next_wakeup(&self) -> Instant {
        self.sync.next_wakeup()
    }

    /// The latest change of master, or what else happened to the clock; once.
    pub(super) const fn take_event(&mut self) -> Option<ClockEvent> {
        self.last_event.take()
    }
}
