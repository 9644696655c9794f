//! Admission control: what the node with the active broker answers to those that ask.

use super::{Admission, AdmissionTiming, Ask, NotAdmitted, Objection, OtherChannel, Reservations, Trial};
use crate::broker::{BrokerEvent, BrokerRole};
use crate::can::{Etag, Frame, TxNode};
use crate::event_layer::EventRate;
use crate::protocol::{
    AdmissionRefusal, AdmissionReply, AdmissionRequest, AdmissionVerdict, CoarseSpan, ControlMessage,
    NodeState, Output, RefusalReason, Side,
};
use crate::ring::Ring;
use crate::time::Instant;
use crate::uid::Subject;

/// Answers the questions for up to `N` channels that the plan does not know, while its broker is active. Its contract is
/// that of [`crate::client`]; [`set_role`](Self::set_role) tells it what its broker does.
///
/// Work is bounded: a call looks at no more than one point of a question with all channels, or at as many as are 64
/// channels together; then it waits for [`AdmissionTiming::between_steps`]. One question of a node waits at a time, and
/// of eight nodes; whoever is not among them asks again. Answers have [`AdmissionTiming::between_replies`] between them.
///
/// It keeps nothing while another broker is active: the nodes tell a new one what they hold. See [`AdmissionTiming`].
#[derive(Clone, Debug)]
pub struct AdmissionControl<const N: usize> {
    table: Admission<'static, N>,
    timing: AdmissionTiming,
    role: BrokerRole,
    /// From when on new questions are answered.
    settled_at: Instant,
    /// In the order in which they are answered; one of a node.
    waiting: [Option<AdmissionRequest>; WAITING],
    trial: Option<(AdmissionRequest, Trial)>,
    step_at: Instant,
    reply: Option<AdmissionReply>,
    reply_at: Instant,
    events: Ring<BrokerEvent, EVENTS>,
    counters: AdmissionCounters,
}

/// What admission control did; each counter stays at its maximum.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AdmissionCounters {
    /// Channels admitted, those of a former broker included.
    pub admitted: u16,
    /// Questions refused.
    pub refused: u16,
    /// Channels that were published already and are not admitted by this broker: two brokers did not know each other.
    pub revoked: u16,
    /// Questions dropped because too many waited.
    pub dropped: u16,
    /// Events dropped because nobody polled.
    pub events_dropped: u16,
}

impl<const N: usize> AdmissionControl<N> {
    /// Control over a segment of which the plan reserves this. Its broker is off.
    pub const fn new(reservations: &'static Reservations<'static>, timing: AdmissionTiming) -> Self {
        Self {
            table: Admission::new(reservations),
            timing,
            role: BrokerRole::Off,
            settled_at: Instant::FAR_FUTURE,
            waiting: [None; WAITING],
            trial: None,
            step_at: Instant::EPOCH,
            reply: None,
            reply_at: Instant::EPOCH,
            events: Ring::new(),
            counters: AdmissionCounters {
                admitted: 0,
                refused: 0,
                revoked: 0,
                dropped: 0,
                events_dropped: 0,
            },
        }
    }

    /// What is admitted.
    pub const fn table(&self) -> &Admission<'static, N> {
        &self.table
    }

    /// What it did.
    pub const fn counters(&self) -> &AdmissionCounters {
        &self.counters
    }

    /// The broker of this node does this now. Call it after each of the broker's events.
    pub fn set_role(&mut self, now: Instant, role: BrokerRole) {
        if self.role == role {
            return;
        }
        self.role = role;
        match role {
            BrokerRole::Off | BrokerRole::Standby => {
                self.table.clear();
                (self.waiting, self.trial, self.reply) = ([None; WAITING], None, None);
                self.settled_at = Instant::FAR_FUTURE;
            }
            BrokerRole::Active => self.settled_at = now + self.timing.settle,
            BrokerRole::Listening => {}
        }
    }

    /// Takes a received frame. O(`N`).
    pub fn on_frame(&mut self, frame: &Frame) {
        if !self.hears() {
            return;
        }
        match ControlMessage::decode(frame) {
            Some(ControlMessage::AdmissionRequest(request)) => self.wait(request),
            Some(ControlMessage::Interest(interest))
                if interest.side == Side::Publisher && interest.lease.is_withdrawn() =>
            {
                self.table.withdraw(interest.tx_node, interest.etag);
                self.forget(|request| (request.tx_node, request.etag) == (interest.tx_node, interest.etag));
            }
            Some(ControlMessage::NodeStatus(status)) if status.state == NodeState::Leaving => {
                self.leave(status.tx_node);
            }
            Some(ControlMessage::Release(release)) => self.leave(release.tx_node),
            _ => {}
        }
    }

    /// What is to be done now; call until it returns `None`. `etag_of` says which etag a planned channel has, if that is
    /// known. O(`N` · planned channels).
    pub fn poll(
        &mut self,
        now: Instant,
        etag_of: impl Fn(Subject) -> Option<Etag>,
    ) -> Option<Output<BrokerEvent>> {
        if self.hears() {
            self.table.expire(now);
            if self.reply.is_none() {
                self.work(now, etag_of);
            }
        }
        if let Some(event) = self.events.pop() {
            return Some(Output::Event(event));
        }
        if now < self.reply_at {
            return None;
        }
        let reply = self.reply.take()?;
        self.reply_at = now + self.timing.between_replies;
        Some(Output::Send(reply.encode()))
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Instant {
        if !self.hears() {
            return Instant::FAR_FUTURE;
        }
        let expiry = self.table.next_wakeup();
        let work = if self.reply.is_some() {
            self.reply_at
        } else if self.trial.is_some() {
            self.step_at
        } else if self.waiting.iter().flatten().any(|request| request.held) {
            Instant::EPOCH
        } else if self.waiting.iter().any(Option::is_some) {
            self.settled_at
        } else {
            Instant::FAR_FUTURE
        };
        expiry.min(work)
    }

    fn hears(&self) -> bool {
        matches!(self.role, BrokerRole::Listening | BrokerRole::Active)
    }

    /// A question is to be answered. A node has one at a time: a later one takes its place.
    fn wait(&mut self, request: AdmissionRequest) {
        if self.trial.is_some_and(|(asked, _)| asked == request) {
            return;
        }
        let same_node = |place: &&mut Option<AdmissionRequest>| {
            place.is_some_and(|waiting| waiting.tx_node == request.tx_node)
        };
        if let Some(place) = self.waiting.iter_mut().find(same_node) {
            *place = Some(request);
        } else if let Some(place) = self.waiting.iter_mut().find(|place| place.is_none()) {
            *place = Some(request);
        } else {
            count(&mut self.counters.dropped);
        }
    }

    fn forget(&mut self, of: impl Fn(&AdmissionRequest) -> bool) {
        for place in &mut self.waiting {
            place.take_if(|request| of(request));
        }
        self.trial.take_if(|(request, _)| of(request));
    }

    fn leave(&mut self, tx_node: TxNode) {
        self.table.withdraw_all(tx_node);
        self.forget(|request| request.tx_node == tx_node);
    }

    /// Goes on with a question, or begins with the next. While another broker answers, all that wait and are renewals are
    /// done in one call: at most as many as wait.
    fn work(&mut self, now: Instant, etag_of: impl Fn(Subject) -> Option<Etag>) {
        let kept = self.timing.lease.duration() + self.timing.grace;
        while self.trial.is_none() && self.reply.is_none() {
            let Some(request) = self.next_waiting(now) else { return };
            let ask = asked(&request);
            if self.table.renew(now, &ask, kept) {
                self.answer(&request, Ok(()), &etag_of);
            } else {
                self.trial = Some((request, self.table.begin(&ask)));
                self.step_at = now;
            }
        }
        let Some((request, trial)) = &mut self.trial else { return };
        if now < self.step_at {
            return;
        }
        let points = CHANNELS_AT_ONCE.checked_div(self.table.channels()).unwrap_or(1).max(1);
        self.step_at = now + self.timing.between_steps;
        let Some(decided) = self.table.step(trial, now, kept, u16::try_from(points).unwrap_or(1)) else {
            return;
        };
        let request = *request;
        self.trial = None;
        self.tell(&request, &decided);
        self.answer(&request, decided, etag_of);
    }

    /// The one that has waited longest, of those that may be answered now.
    fn next_waiting(&mut self, now: Instant) -> Option<AdmissionRequest> {
        let settled = now >= self.settled_at;
        let may = |place: &Option<AdmissionRequest>| place.is_some_and(|request| request.held || settled);
        let at = self.waiting.iter().position(may)?;
        let request = self.waiting.get_mut(at)?.take();
        // Those behind it move up.
        if let Some(behind) = self.waiting.get_mut(at..) {
            behind.rotate_left(1);
        }
        request
    }

    fn tell(&mut self, request: &AdmissionRequest, decided: &Result<(), NotAdmitted>) {
        let &AdmissionRequest { tx_node, etag, held, .. } = request;
        let event = match decided {
            Ok(()) => {
                count(&mut self.counters.admitted);
                BrokerEvent::Admitted { tx_node, etag }
            }
            Err(NotAdmitted { why, .. }) => {
                count(&mut self.counters.refused);
                if held {
                    count(&mut self.counters.revoked);
                }
                BrokerEvent::NotAdmitted { tx_node, etag, why: *why }
            }
        };
        if !self.events.push(event) {
            count(&mut self.counters.events_dropped);
        }
    }

    /// While it listens, another broker may be the one that answers.
    fn answer(
        &mut self,
        request: &AdmissionRequest,
        decided: Result<(), NotAdmitted>,
        etag_of: impl Fn(Subject) -> Option<Etag>,
    ) {
        if self.role != BrokerRole::Active {
            return;
        }
        let verdict = match decided {
            Ok(()) => AdmissionVerdict::Admitted(self.timing.lease),
            Err(NotAdmitted { why, fits_at }) => {
                let (reason, suffers) = reason(why, etag_of);
                let fits_at = fits_at.and_then(CoarseSpan::ceil);
                AdmissionVerdict::Refused(AdmissionRefusal { reason, fits_at, suffers })
            }
        };
        let &AdmissionRequest { tx_node: requester, etag, number, .. } = request;
        self.reply = Some(AdmissionReply { requester, etag, number, verdict });
    }
}

fn asked(request: &AdmissionRequest) -> Ask {
    let rate = EventRate::sporadic(request.interval.duration()).with_jitter(request.tolerance.duration());
    let &AdmissionRequest { tx_node, etag, len, .. } = request;
    Ask { tx_node, etag, rate, deadline: request.deadline.duration(), len }
}

fn reason(why: Objection, etag_of: impl Fn(Subject) -> Option<Etag>) -> (RefusalReason, Option<Etag>) {
    match why {
        Objection::Utilisation => (RefusalReason::Utilisation, None),
        Objection::Blocking => (RefusalReason::Blocking, None),
        Objection::Late => (RefusalReason::Late, None),
        Objection::Suffers(OtherChannel::Planned(subject)) => (RefusalReason::OtherLate, etag_of(subject)),
        Objection::Suffers(OtherChannel::Admitted(etag)) => (RefusalReason::OtherLate, Some(etag)),
        Objection::LessUrgent(_) => (RefusalReason::LessUrgentLate, None),
        Objection::Full => (RefusalReason::Full, None),
    }
}

fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

/// Nodes whose questions wait.
const WAITING: usize = 8;

/// Events that wait to be fetched.
const EVENTS: usize = 8;

/// How many channels a call looks at together, at one point of each.
const CHANNELS_AT_ONCE: usize = 64;
