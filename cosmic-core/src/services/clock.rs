//! Clock synchronisation as a service of a node.

use super::{Declaration, NodeView, Request, Services, Timekeeper, TooMany};
use crate::admission::AdmissionPlan;
use crate::calendar::Calendar;
use crate::can::{Frame, TxNode, TxNodes};
use crate::event_layer::{AnnounceError, ExceptionKind, Gate};
use crate::seal::{Refusals, Seal, Warden};
use crate::sync::{ClockEvent, SyncConfig, SyncConfigError};
use crate::time::{Duration, GlobalClock, Instant};
use crate::uid::{NodeUid, Subject};

/// Clock synchronisation alone: for a cluster whose ids and etags are all fixed. `CANDIDATE` as in
/// [`ClockSync`](crate::sync::ClockSync).
#[derive(Clone, Debug)]
pub struct ClockService<const CANDIDATE: bool = true> {
    timekeeper: Timekeeper<CANDIDATE>,
    tx_node: Option<TxNode>,
    /// A frame with this node's own TxNode has arrived, and is to be told.
    duplicate: bool,
    /// The next one is told from then on.
    tells_again_at: Instant,
    warden: Option<Warden>,
    admission: Option<(&'static AdmissionPlan, NodeUid)>,
}

/// Between two exceptions because of frames that bear this node's own TxNode.
const DUPLICATES_TOLD_EVERY: Duration = Duration::from_millis(1_000);

impl<const CANDIDATE: bool> ClockService<CANDIDATE> {
    /// Takes part with this TxNode and calendar, which says how long a bit is; `config` says the rest.
    ///
    /// # Errors
    /// The first setting that is refused.
    pub fn new(
        config: SyncConfig,
        calendar: &Calendar,
        tx_node: Option<TxNode>,
        now: Instant,
    ) -> Result<Self, SyncConfigError> {
        let mut timekeeper = Timekeeper::new(config, calendar, now)?;
        timekeeper.set_tx_node(tx_node);
        Ok(Self {
            timekeeper,
            tx_node,
            duplicate: false,
            tells_again_at: Instant::EPOCH,
            warden: None,
            admission: None,
        })
    }

    /// The service of this node in a cluster with this plan for soft real-time channels that it does not know. There is no
    /// broker to ask, so such a channel is refused, or sent as non real-time; `None` lets any be published.
    #[must_use]
    pub fn admitting(mut self, plan: Option<&'static AdmissionPlan>, uid: NodeUid) -> Self {
        self.admission = plan.map(|plan| (plan, uid));
        self
    }

    /// The service of a node of a sealed cluster, which believes only what agrees with this; `None` leaves it open.
    #[must_use]
    pub fn sealed(mut self, seal: Option<&'static Seal>) -> Self {
        self.warden = seal.map(Warden::new);
        self
    }

    /// What a sealed node has refused; `None` in an open cluster.
    pub fn refusals(&self) -> Option<&Refusals> {
        self.warden.as_ref().map(Warden::refusals)
    }

    /// The clock as of the last call.
    pub const fn clock(&self) -> GlobalClock {
        self.timekeeper.clock()
    }

    /// Returns whether this node is the master.
    pub const fn is_master(&self) -> bool {
        self.timekeeper.is_master()
    }

    /// The latest change of master, or what else happened to the clock; once.
    pub const fn take_event(&mut self) -> Option<ClockEvent> {
        self.timekeeper.take_event()
    }
}

impl<const CANDIDATE: bool> Services for ClockService<CANDIDATE> {
    const SENDS_URGENT: bool = CANDIDATE;

    fn on_frame(&mut self, frame: &Frame, received_at: Instant) {
        let own = self.tx_node;
        if self.warden.as_mut().is_some_and(|warden| !warden.admits(frame, received_at, own)) {
            return;
        }
        // No node hears itself, so another one uses this TxNode.
        if self.tx_node == Some(frame.id.tx_node()) && received_at >= self.tells_again_at {
            self.duplicate = true;
            self.tells_again_at = received_at + DUPLICATES_TOLD_EVERY;
        }
        self.timekeeper.on_frame(frame, received_at);
    }

    fn on_sent(&mut self, frame: &Frame, sent_at: Instant) {
        self.timekeeper.on_sent(frame, sent_at);
    }

    fn permits(&self, declaration: &Declaration) -> Result<Gate, AnnounceError> {
        if let Some(warden) = &self.warden {
            warden.seal().permits(self.tx_node, declaration)?;
        }
        match self.admission.map_or(Ok(Gate::Open), |(plan, uid)| plan.permits(uid, declaration)) {
            Ok(Gate::Closed) | Err(_) => Err(AnnounceError::OutsidePlan),
            Ok(gate) => Ok(gate),
        }
    }

    fn publishers(&self, subject: Subject) -> Option<&'static TxNodes> {
        self.warden.as_ref().map(|warden| warden.seal().publishers(subject))
    }

    fn declare(&mut self, _: &Declaration) -> Result<(), TooMany> {
        Ok(())
    }

    fn poll(&mut self, now: Instant, _: &NodeView) -> Option<Request> {
        if let Some(kind) = self.warden.as_mut().and_then(Warden::take) {
            return Some(Request::Exception(None, kind));
        }
        if core::mem::take(&mut self.duplicate) {
            return Some(Request::Exception(None, ExceptionKind::DuplicateTxNode));
        }
        self.timekeeper.poll(now)
    }

    fn next_wakeup(&self) -> Instant {
        self.timekeeper.next_wakeup()
    }

    fn global_clock(&self) -> GlobalClock {
        self.timekeeper.clock()
    }

    fn poll_urgent(&mut self, now: Instant, view: &NodeView) -> Option<Request> {
        self.poll(now, view)
    }

    fn next_urgent_wakeup(&self) -> Instant {
        self.timekeeper.next_wakeup()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calendar::Segment;
    use crate::can::{BitRate, Etag, Id, Payload, Priority};

    const SEGMENT: Segment = Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(50),
        release_jitter: Duration::from_micros(20),
    };
    static CALENDAR: Calendar = Calendar::checked(SEGMENT, Duration::from_millis(10), &[]);

    fn told(service: &mut ClockService, now: Instant) -> bool {
        let view = NodeView::default();
        let requests = core::iter::from_fn(|| service.poll(now, &view));
        requests.into_iter().any(|it| it == Request::Exception(None, ExceptionKind::DuplicateTxNode))
    }

    /// A node whose ids are all fixed has no other service that would notice.
    #[test]
    fn a_second_node_with_this_tx_node_is_told_once_a_second() {
        let me = TxNode::new(5).unwrap();
        let now = Instant::EPOCH + Duration::from_millis(1);
        let mut service = ClockService::new(SyncConfig::DEFAULT, &CALENDAR, Some(me), now).unwrap();
        let frame = |tx_node| Frame::new(Id::new(Priority::LEAST, tx_node, Etag::BOUND_LAST), Payload::EMPTY);
        service.on_frame(&frame(TxNode::new(6).unwrap()), now);
        assert!(!told(&mut service, now));
        service.on_frame(&frame(me), now);
        assert!(told(&mut service, now));
        service.on_frame(&frame(me), now + Duration::from_millis(999));
        assert!(!told(&mut service, now + Duration::from_millis(999)));
        service.on_frame(&frame(me), now + Duration::from_millis(1_000));
        assert!(told(&mut service, now + Duration::from_millis(1_000)));
    }
}
