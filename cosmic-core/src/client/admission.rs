//! Admission: a node asks for its soft real-time channels that the plan does not know, and holds what was admitted.

use crate::admission::{AdmissionTiming, Offer};
use crate::can::{Etag, Frame, Payload, TxNode};
use crate::jitter::{Jitter, times};
use crate::protocol::{
    AdmissionRefusal, AdmissionReply, AdmissionRequest, AdmissionVerdict, AskNumber, BrokerStatus,
    CoarseSpan, Lease, Output, Probe,
};
use crate::time::{Duration, Instant};
use crate::uid::{NodeUid, Subject};

/// Where a channel stands that the plan does not know.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AdmissionState {
    /// It is being asked for: nobody has answered yet.
    Waiting,
    /// It may be published, and until this instant without being confirmed.
    Admitted(Instant),
    /// It may not; it is asked for again later.
    Refused(AdmissionRefusal),
}

/// What the node is told.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AdmissionEvent {
    /// The channel may be published.
    Admitted(Subject),
    /// It may not be published, or not any more.
    Refused(Subject, AdmissionRefusal),
    /// It may not be published any more: the broker did not confirm it, or the node or the channel has another short
    /// name. It is asked for again.
    Lapsed(Subject),
}

/// Why a channel cannot be asked for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CannotAsk {
    /// It states no rate.
    NoRate,
    /// A burst or jitter of days, an event longer than a frame, or an interval or deadline below a microsecond.
    OutOfRange,
    /// As many channels are asked for as there is room for.
    Full,
}

/// What is asked for, as it stands in a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Terms {
    len: u8,
    interval: CoarseSpan,
    tolerance: CoarseSpan,
    deadline: CoarseSpan,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    subject: Subject,
    etag: Option<Etag>,
    terms: Terms,
    number: AskNumber,
    /// When to ask next.
    ask_at: Instant,
    /// When the question was sent first that has not been answered: from then on a lease counts.
    asked_at: Option<Instant>,
    /// It was admitted until then.
    held_until: Option<Instant>,
    refusal: Option<AdmissionRefusal>,
    untold: Option<AdmissionEvent>,
}

/// The admission client of one node, for up to `N` channels, of which there may be none; its contract is that of
/// [`crate::client`], and why it is safe stands at [`AdmissionTiming`].
///
/// Every call takes O(`N`).
#[derive(Clone, Debug)]
pub struct AdmissionClient<const N: usize> {
    entries: [Option<Entry>; N],
    tx_node: Option<TxNode>,
    timing: &'static AdmissionTiming,
    jitter: Jitter,
    first_number: AskNumber,
    /// Which entry's question is out, and until when its answer is awaited.
    out: Option<(usize, Instant)>,
    /// The entry whose turn is next.
    turn: usize,
    failures: u8,
    broker: Option<(TxNode, NodeUid)>,
    heard_at: Instant,
    /// Before this, no probe is answered.
    probe_at: Instant,
}

impl<const N: usize> AdmissionClient<N> {
    /// A client that asks for nothing. It is silent until it has a TxNode. `noise` as in
    /// [`Configuration::new`](super::Configuration::new).
    pub const fn new(noise: u64, timing: &'static AdmissionTiming) -> Self {
        Self {
            entries: [None; N],
            tx_node: None,
            timing,
            jitter: Jitter::new(noise),
            first_number: AskNumber::new(noise as u8),
            out: None,
            turn: 0,
            failures: 0,
            broker: None,
            heard_at: Instant::EPOCH,
            probe_at: Instant::EPOCH,
        }
    }

    /// Whether this can be asked for at all.
    ///
    /// # Errors
    /// [`CannotAsk`], but never that there is no room.
    pub fn can_ask(offer: &Offer) -> Result<(), CannotAsk> {
        Terms::of(offer).map(|_| ())
    }

    /// The node has this TxNode from now on, or none.
    pub fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        if self.tx_node != tx_node {
            self.tx_node = tx_node;
            self.out = None;
            self.entries.iter_mut().flatten().for_each(|entry| entry.begin_anew(now));
        }
    }

    /// Asks for this channel, once it is [bound](Self::bind); nothing changes if it was asked for like this already.
    ///
    /// # Errors
    /// [`CannotAsk`]; nothing has changed then.
    pub fn announce(&mut self, now: Instant, subject: Subject, offer: &Offer) -> Result<(), CannotAsk> {
        if N == 0 {
            return Err(CannotAsk::Full);
        }
        let terms = Terms::of(offer)?;
        let known = self.position(subject);
        let vacant = || self.entries.iter().position(Option::is_none);
        let at = known.or_else(vacant).ok_or(CannotAsk::Full)?;
        let place = self.entries.get_mut(at).ok_or(CannotAsk::Full)?;
        let entry = place.get_or_insert(Entry {
            subject,
            etag: None,
            terms,
            number: self.first_number,
            ask_at: now,
            asked_at: None,
            held_until: None,
            refusal: None,
            untold: None,
        });
        if known.is_none() {
            // Announced again, it is another question.
            self.first_number = self.first_number.next();
        } else if entry.terms != terms {
            entry.terms = terms;
            entry.begin_anew(now);
        }
        Ok(())
    }

    /// The channel has this etag from now on, or none. Nothing if it is not asked for.
    pub fn bind(&mut self, now: Instant, subject: Subject, etag: Option<Etag>) {
        let entry = self.entries.iter_mut().flatten().find(|entry| entry.subject == subject);
        if let Some(entry) = entry.filter(|entry| entry.etag != etag) {
            entry.etag = etag;
            entry.begin_anew(now);
        }
    }

    /// The node does not publish on the channel any more. That its interest has ended tells the broker.
    pub fn forget(&mut self, subject: Subject) {
        let Some(at) = self.position(subject) else { return };
        self.out.take_if(|(out, _)| *out == at);
        if let Some(place) = self.entries.get_mut(at) {
            *place = None;
        }
    }

    /// Where a channel stands; `None` if it is not asked for.
    pub fn state(&self, subject: Subject) -> Option<AdmissionState> {
        let entry = self.entries.iter().flatten().find(|entry| entry.subject == subject)?;
        Some(match (entry.held_until, entry.refusal) {
            (Some(until), _) => AdmissionState::Admitted(until),
            (None, Some(refusal)) => AdmissionState::Refused(refusal),
            (None, None) => AdmissionState::Waiting,
        })
    }

    /// Takes a received frame.
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) {
        if N == 0 {
            return;
        }
        match frame.id.etag() {
            Etag::ADMISSION_REPLY => {
                if let Some(reply) = AdmissionReply::decode(frame) {
                    self.on_reply(&reply, now);
                }
            }
            Etag::BROKER_STATUS => {
                if let Some(status) = BrokerStatus::decode(frame) {
                    self.on_broker_status(&status, now);
                }
            }
            Etag::PROBE if now >= self.probe_at && Probe::decode(frame).is_some() => {
                self.probe_at = now + BETWEEN_CONFIRMATIONS;
                self.confirm_all(now);
            }
            _ => {}
        }
    }

    /// An event of this channel was late, or came to nothing. If the channel was admitted, but nobody has confirmed that for
    /// a while, the bus has more to do than anybody has admitted, so much that control messages do not get through: the
    /// channel is given up, and asked for anew. That happens when parts of a bus come together again that were apart.
    /// Returns whether it is.
    pub fn on_late(&mut self, now: Instant, subject: Subject) -> bool {
        let silence = self.timing.silence;
        let entry = self.entries.iter_mut().flatten().find(|entry| entry.subject == subject);
        let unconfirmed = entry.filter(|entry| {
            entry.held_until.is_some() && entry.asked_at.is_some_and(|asked_at| now >= asked_at + silence)
        });
        unconfirmed.map(|entry| entry.begin_anew(now)).is_some()
    }

    /// What is to be done now; call until it returns `None`.
    pub fn poll(&mut self, now: Instant) -> Option<Output<AdmissionEvent>> {
        if N == 0 {
            return None;
        }
        if let Some((at, _)) = self.out.take_if(|(_, until)| now >= *until) {
            self.failures = self.failures.saturating_add(1);
            if let Some(Some(entry)) = self.entries.get_mut(at) {
                entry.ask_at = now;
            }
        }
        self.give_up_what_is_not_confirmed(now);
        let event = self.entries.iter_mut().flatten().find_map(|entry| entry.untold.take());
        if let Some(event) = event {
            return Some(Output::Event(event));
        }
        if self.out.is_some() {
            return None;
        }
        self.ask_next(now, self.tx_node?).map(Output::Send)
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Instant {
        if N == 0 {
            return Instant::FAR_FUTURE;
        }
        let entries = || self.entries.iter().flatten();
        if entries().any(|entry| entry.untold.is_some()) {
            return Instant::EPOCH;
        }
        let known_dead_at = self.heard_at + self.timing.silence;
        // Without a broker it goes on.
        let given_up = entries().filter_map(|entry| entry.held_until).filter(|until| *until < known_dead_at);
        let given_up = given_up.fold(Instant::FAR_FUTURE, Instant::min);
        let next = match self.out {
            _ if self.tx_node.is_none() => Instant::FAR_FUTURE,
            Some((_, until)) => until,
            None => {
                let bound = entries().filter(|entry| entry.etag.is_some());
                bound.map(|entry| entry.ask_at).fold(Instant::FAR_FUTURE, Instant::min)
            }
        };
        next.min(given_up)
    }

    fn on_reply(&mut self, reply: &AdmissionReply, now: Instant) {
        if Some(reply.requester) != self.tx_node {
            return;
        }
        let is_it = |place: &Option<Entry>| {
            place.is_some_and(|entry| (entry.etag, entry.number) == (Some(reply.etag), reply.number))
        };
        let Some(at) = self.entries.iter().position(is_it) else { return };
        if self.out.take_if(|(out, _)| *out == at).is_some() {
            self.failures = 0;
        }
        let Some(Some(entry)) = self.entries.get_mut(at) else { return };
        // The second answer to a question that was repeated says nothing new.
        let Some(asked_at) = entry.asked_at.take() else { return };
        match reply.verdict {
            AdmissionVerdict::Admitted(lease) => entry.hold(now, asked_at, lease),
            AdmissionVerdict::Refused(refusal) => {
                entry.refuse(refusal, now + self.jitter.around(self.timing.refused));
            }
        }
    }

    /// A broker that was not heard before, or not for a while, knows nothing of what is held.
    fn on_broker_status(&mut self, status: &BrokerStatus, now: Instant) {
        let broker = Some((status.tx_node, status.uid));
        let known = self.broker == broker && now.saturating_since(self.heard_at) < self.timing.silence;
        (self.broker, self.heard_at) = (broker, now);
        if known {
            return;
        }
        self.confirm_all(now);
        let claimed = now + self.timing.claim;
        for entry in self.entries.iter_mut().flatten() {
            // A lease of the one before says nothing: this one answers others when it has heard all that is held.
            entry.held_until = entry.held_until.map(|_| claimed);
        }
    }

    /// Everything is asked for again; not by all nodes at the same instant.
    fn confirm_all(&mut self, now: Instant) {
        (self.out, self.failures) = (None, 0);
        for entry in self.entries.iter_mut().flatten() {
            // A lease counts from a question that this broker has heard.
            entry.asked_at = None;
            entry.ask_at = now + self.jitter.below(SPREAD);
        }
    }

    fn give_up_what_is_not_confirmed(&mut self, now: Instant) {
        if now >= self.heard_at + self.timing.silence {
            return;
        }
        for entry in self.entries.iter_mut().flatten() {
            if entry.held_until.is_some_and(|until| now >= until) {
                entry.begin_anew(now);
            }
        }
    }

    #[expect(clippy::arithmetic_side_effects, reason = "positions below `N`, which is not zero here")]
    fn ask_next(&mut self, now: Instant, tx_node: TxNode) -> Option<Frame> {
        let due = |at: &usize| {
            let entry = self.entries.get(*at).and_then(Option::as_ref);
            entry.is_some_and(|entry| entry.etag.is_some() && now >= entry.ask_at)
        };
        let at = (0..N).map(|step| (self.turn + step) % N).find(due)?;
        self.turn = (at + 1) % N;
        let entry = self.entries.get_mut(at)?.as_mut()?;
        let etag = entry.etag?;
        entry.asked_at.get_or_insert(now);
        let patience = times(self.timing.reply, 1 << self.failures.min(5));
        // Of many nodes that got no answer not all ask again at once.
        let patience = if self.failures == 0 { patience } else { self.jitter.around(patience) };
        self.out = Some((at, now + patience));
        let Terms { len, interval, tolerance, deadline } = entry.terms;
        let held = entry.held_until.is_some();
        let number = entry.number;
        let request = AdmissionRequest { tx_node, etag, number, held, len, interval, tolerance, deadline };
        Some(request.encode())
    }

    fn position(&self, subject: Subject) -> Option<usize> {
        self.entries.iter().position(|place| place.is_some_and(|entry| entry.subject == subject))
    }
}

impl Entry {
    /// Another question: what was admitted does not hold, and no answer that is under way is to it.
    fn begin_anew(&mut self, now: Instant) {
        if self.held_until.take().is_some() {
            self.untold = Some(AdmissionEvent::Lapsed(self.subject));
        }
        self.number = self.number.next();
        (self.ask_at, self.asked_at, self.refusal) = (now, None, None);
    }

    fn hold(&mut self, now: Instant, asked_at: Instant, lease: Lease) {
        let until = asked_at + lease.duration();
        if now >= until {
            // Too late to be of use.
            return self.begin_anew(now);
        }
        if self.held_until.is_none() {
            self.untold = Some(AdmissionEvent::Admitted(self.subject));
        }
        (self.held_until, self.refusal) = (Some(until), None);
        self.ask_at = asked_at + Duration::from_ticks(lease.duration().as_ticks() / 3);
    }

    fn refuse(&mut self, refusal: AdmissionRefusal, ask_at: Instant) {
        let held = self.held_until.take().is_some();
        if held || self.refusal != Some(refusal) {
            self.untold = Some(AdmissionEvent::Refused(self.subject, refusal));
        }
        self.refusal = Some(refusal);
        self.number = self.number.next();
        self.ask_at = ask_at;
    }
}

impl Terms {
    /// No less than what is offered.
    fn of(offer: &Offer) -> Result<Self, CannotAsk> {
        let rate = offer.rate.ok_or(CannotAsk::NoRate)?;
        let len = u8::try_from(offer.len).ok().filter(|len| usize::from(*len) <= Payload::MAX_LEN);
        let len = len.ok_or(CannotAsk::OutOfRange)?;
        let (interval, deadline) = (CoarseSpan::floor(rate.interval()), CoarseSpan::floor(offer.deadline));
        let tolerance = CoarseSpan::ceil(rate.tolerance()).ok_or(CannotAsk::OutOfRange)?;
        if interval.is_zero() || deadline.is_zero() {
            return Err(CannotAsk::OutOfRange);
        }
        Ok(Self { len, interval, tolerance, deadline })
    }
}

/// Between two answers to probes, at least.
const BETWEEN_CONFIRMATIONS: Duration = Duration::from_millis(200);

/// Within this span all nodes tell a new broker what they hold.
const SPREAD: Duration = Duration::from_millis(20);
