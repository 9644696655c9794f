//! Clock synchronisation as a service of a node.

use super::{Declaration, NodeView, Request, Services, TooMany};
use crate::calendar::Calendar;
use crate::can::{Frame, TxNode};
use crate::time::sync::{ClockEvent, ClockSync, SyncConfig, SyncConfigError, SyncCounters};
use crate::time::{GlobalClock, Instant};

/// Clock synchronisation alone: for a cluster whose ids and etags are all fixed.
#[derive(Clone, Debug)]
pub struct ClockService {
    sync: ClockSync,
    /// What the time-triggered half was told last.
    told: Option<GlobalClock>,
    inhibited: bool,
    last_event: Option<ClockEvent>,
}

impl ClockService {
    /// Takes part with this TxNode and calendar; `config` says the rest.
    ///
    /// # Errors
    /// The first setting that is refused.
    pub fn new(
        config: SyncConfig,
        calendar: &Calendar,
        tx_node: Option<TxNode>,
        now: Instant,
    ) -> Result<Self, SyncConfigError> {
        let config = SyncConfig { calendar_digest: calendar.digest(), ..config };
        let mut sync = ClockSync::new(config, now)?;
        sync.set_tx_node(tx_node);
        Ok(Self { sync, told: None, inhibited: false, last_event: None })
    }

    /// The clock as of the last call.
    pub const fn clock(&self) -> GlobalClock {
        self.sync.clock()
    }

    /// Must the node keep silent, because its calendar is not that of the segment?
    pub const fn is_inhibited(&self) -> bool {
        self.inhibited
    }

    /// Is this node the master?
    pub const fn is_master(&self) -> bool {
        self.sync.is_master()
    }

    /// The node has been given its TxNode, or lost it.
    pub fn set_tx_node(&mut self, tx_node: Option<TxNode>) {
        self.sync.set_tx_node(tx_node);
    }

    /// The latest change of master, or what else happened to the clock; once.
    pub fn take_event(&mut self) -> Option<ClockEvent> {
        self.last_event.take()
    }

    /// What was sent, used, and dropped.
    pub const fn counters(&self) -> &SyncCounters {
        self.sync.counters()
    }
}

impl Services for ClockService {
    fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        self.sync.on_frame(frame, received_at);
    }

    fn on_sent(&mut self, frame: &Frame, sent_at: Instant) {
        self.sync.on_sent(frame, sent_at);
    }

    fn declare(&mut self, _: &Declaration) -> Result<(), TooMany> {
        Ok(())
    }

    fn poll(&mut self, now: Instant, _: &NodeView) -> Option<Request> {
        if let Some(frame) = self.sync.poll(now) {
            return Some(Request::SendUrgent(frame, now + self.sync.frame_lifetime()));
        }
        while let Some(event) = self.sync.poll_event() {
            self.last_event = Some(event);
        }
        let clock = self.sync.clock();
        if self.told != Some(clock) {
            self.told = Some(clock);
            return Some(Request::Clock(clock));
        }
        let mismatch = self.sync.has_calendar_mismatch();
        if self.inhibited != mismatch {
            self.inhibited = mismatch;
            return Some(Request::Inhibit(mismatch));
        }
        None
    }

    fn next_wakeup(&self) -> Instant {
        self.sync.next_wakeup()
    }

    fn poll_urgent(&mut self, now: Instant, view: &NodeView) -> Option<Request> {
        self.poll(now, view)
    }

    fn next_urgent_wakeup(&self) -> Instant {
        self.sync.next_wakeup()
    }
}
