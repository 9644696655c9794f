//! The event channel broker (ECB).
//!
//! # Roles
//! A broker starts *listening*: it probes the nodes for their ids and bindings, and hears whether there
//! is an active broker. If not it becomes *active* and answers; otherwise it stands by, mirrors its table
//! by listening to the replies of the active one, and takes over when that falls silent. Standby brokers
//! wait for the longer the higher their TxNode is, so the first one to take over is heard by the others.
//!
//! # A broker that lost its table
//! The nodes know their own ids and bindings, and tell them when they are probed. What the nodes that are
//! off had, only a stored table knows ([`Broker::nodes`], [`Broker::subjects`] and their `restore`). Ids
//! and etags of which only the use is seen are kept out of use.
//!
//! # Two active brokers
//! They hear each other's status: the one with the lower UID stays, the other stands by. The one that
//! stays probes the nodes. A binding of the other that contradicts its table gets a new etag, which all
//! nodes hear. Two nodes with one TxNode find each other, and one of them asks for a new id (see
//! [`super::Configuration`]).
//!
//! # Lost frames
//! Whatever was lost, all tables agree in the end: with each status the active broker repeats one binding
//! of its table. A node whose binding differs, or whose etag belongs to another subject, changes over or
//! asks anew, and a standby corrects its copy. That costs two frames in [`BrokerTiming::status`], and one
//! round takes as many of these spans as there are subjects.
//!
//! # FAMOUSO's broker
//! It sends no status. It is recognised by its replies, and taken for dead when a request remains
//! without an answer.

mod report;

pub use report::{BrokerCounters, BrokerEvent, BrokerTiming, Role};

use super::Output;
use super::halves::{Halves, Supply};
use super::jitter::times;
use super::session::{Session, Step};
use super::tables::{Nodes, Subjects};
use crate::can::{Etag, Frame, TxNode};
use crate::protocol::{
    Answer, BrokerStatus, ConfigurationRefusal, ConfigurationReply, ConfigurationRequest, Message, Probe,
    SupplyEtag, names_its_sender,
};
use crate::ring::Ring;
use crate::time::{Duration, Instant};
use crate::uid::{NodeUid, Subject};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Off,
    Listening { until: Instant, probe_at: Instant },
    Active { status_at: Instant },
    Standby { dead_at: Instant, old: bool },
}

/// An event channel broker for `NODES` nodes (at most 127) and `SUBJECTS` subjects (at most 15360); its
/// contract is that of [`crate::broker`].
///
/// A call takes O(`NODES` + `SUBJECTS`).
#[derive(Clone, Debug)]
pub struct Broker<const NODES: usize, const SUBJECTS: usize> {
    uid: NodeUid,
    tx_node: TxNode,
    timing: BrokerTiming,
    state: State,
    nodes: Nodes<NODES>,
    subjects: Subjects<SUBJECTS>,
    session: Session,
    halves: Halves,
    /// When to free those that wait for the end of a search that ended in a refusal.
    restart_at: Option<Instant>,
    /// When to probe again, to compare the table with the nodes, and how often.
    probe_at: Option<Instant>,
    probes: u8,
    /// The etag of the binding that was repeated last.
    repeated: Option<Etag>,
    replies: Ring<Frame, REPLIES>,
    events: Ring<BrokerEvent, EVENTS>,
    counters: BrokerCounters,
}

impl<const NODES: usize, const SUBJECTS: usize> Broker<NODES, SUBJECTS> {
    /// A broker with the tables of its last run, or empty ones. It is off until its node has a TxNode.
    pub const fn new(
        uid: NodeUid,
        timing: BrokerTiming,
        nodes: Nodes<NODES>,
        subjects: Subjects<SUBJECTS>,
    ) -> Self {
        Self {
            uid,
            tx_node: TxNode::BROKER,
            timing,
            state: State::Off,
            nodes,
            subjects,
            session: Session::new(),
            halves: Halves::new(),
            restart_at: None,
            probe_at: None,
            probes: 0,
            repeated: None,
            replies: Ring::new(),
            events: Ring::new(),
            counters: BrokerCounters::ZERO,
        }
    }

    /// The node that hosts this broker has this TxNode from now on, or none.
    ///
    /// The first broker of a cluster needs a node whose TxNode is fixed: there is nobody yet to give it
    /// one.
    pub fn set_tx_node(&mut self, now: Instant, tx_node: Option<TxNode>) {
        match tx_node {
            Some(tx_node) if self.state == State::Off => {
                self.tx_node = tx_node;
                self.nodes.learn(self.uid, tx_node);
                self.state = State::Listening { until: now + self.timing.listen, probe_at: now };
                self.tell(BrokerEvent::Became(Role::Listening));
            }
            Some(tx_node) => {
                self.tx_node = tx_node;
                self.nodes.learn(self.uid, tx_node);
            }
            None if self.state == State::Off => {}
            None => {
                self.retire(State::Off);
                self.tell(BrokerEvent::Became(Role::Off));
            }
        }
    }

    /// What the broker does.
    pub const fn role(&self) -> Role {
        match self.state {
            State::Off => Role::Off,
            State::Listening { .. } => Role::Listening,
            State::Active { .. } => Role::Active,
            State::Standby { .. } => Role::Standby,
        }
    }

    /// The ids of the nodes, to look at and to store.
    pub const fn nodes(&self) -> &Nodes<NODES> {
        &self.nodes
    }

    /// The etags of the subjects, to look at and to store.
    pub const fn subjects(&self) -> &Subjects<SUBJECTS> {
        &self.subjects
    }

    /// What could not be done.
    pub const fn counters(&self) -> &BrokerCounters {
        &self.counters
    }

    /// Frees the id of a node that will not come back. Returns whether it had one.
    pub fn release_node(&mut self, uid: NodeUid) -> bool {
        self.nodes.release(uid)
    }

    /// Frees the etag of a subject that nobody uses any more. Returns whether it had one.
    ///
    /// A node that still uses it would share the etag with another subject; it is the caller's to know
    /// that there is none (see [`crate::membership`]).
    pub fn release_subject(&mut self, subject: Subject) -> bool {
        self.subjects.release(subject)
    }

    /// Takes a received frame; control messages and all others, from which the broker learns which ids
    /// and etags are in use. It need not see all of the others.
    pub fn on_frame(&mut self, now: Instant, frame: &Frame) {
        if self.state == State::Off {
            return;
        }
        if names_its_sender(frame.id) {
            self.nodes.occupy(frame.id.tx_node());
        }
        if frame.id.etag() >= Etag::BOUND_FIRST {
            self.subjects.occupy(frame.id.etag());
            return;
        }
        match Message::decode(frame) {
            Some(Message::ConfigurationRequest(request)) => self.on_configuration_request(now, request),
            Some(Message::ConfigurationReply(reply)) => self.on_configuration_reply(now, reply),
            Some(Message::ConfigurationRefusal(_)) => self.on_other_broker(now),
            Some(Message::GetEtag(request)) => self.on_get_etag(now, request.requester, request.subject),
            Some(Message::SupplyEtag(half)) => {
                if let Some(supply) = self.halves.join(half) {
                    self.on_supply(now, supply);
                }
            }
            Some(Message::NodeIdentity(identity)) => self.nodes.learn(identity.uid, identity.tx_node),
            Some(Message::Release(release)) => {
                if self.nodes.uid_of(release.tx_node) == Some(release.uid) {
                    self.nodes.release(release.uid);
                }
            }
            Some(Message::BrokerStatus(status)) => self.on_broker_status(now, status),
            Some(Message::Interest(interest)) if interest.etag >= Etag::BOUND_FIRST => {
                self.subjects.occupy(interest.etag);
            }
            Some(Message::Interest(_) | Message::NodeStatus(_) | Message::Probe(_)) | None => {}
        }
    }

    /// What is to be done now; call until it returns `None`.
    pub fn poll(&mut self, now: Instant) -> Option<Output<BrokerEvent>> {
        match self.state {
            State::Off => {}
            State::Listening { until, .. } if now >= until + self.rank_delay() => self.activate(now),
            State::Listening { until, probe_at } if now >= probe_at => {
                // Three probes, so that a lost one does not cost the table.
                let third = Duration::from_ticks(self.timing.listen.as_ticks() / 3);
                self.state = State::Listening { until, probe_at: next_probe(probe_at + third, until) };
                self.reply([Probe { tx_node: self.tx_node }.encode()]);
            }
            State::Listening { .. } => {}
            State::Active { status_at } => self.poll_active(now, status_at),
            State::Standby { dead_at, .. } if now >= dead_at => self.activate(now),
            State::Standby { .. } => {}
        }
        if self.state != State::Off && self.probe_at.is_some_and(|at| now >= at) {
            self.probes = self.probes.saturating_sub(1);
            self.probe_at = (self.probes > 0).then_some(now + self.timing.listen);
            self.reply([Probe { tx_node: self.tx_node }.encode()]);
        }
        match self.events.pop() {
            Some(event) => Some(Output::Event(event)),
            None => self.replies.pop().map(Output::Send),
        }
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Option<Instant> {
        let of_state = match self.state {
            State::Off => return None,
            State::Listening { until, probe_at } => Some(probe_at.min(until + self.rank_delay())),
            State::Active { status_at } => Some(status_at),
            State::Standby { dead_at, .. } => Some(dead_at),
        };
        let search = self.session.expires_at(self.timing.search);
        [of_state, search, self.restart_at, self.probe_at].into_iter().flatten().min()
    }

    fn poll_active(&mut self, now: Instant, status_at: Instant) {
        if now >= status_at {
            self.send_status(now);
            self.repeat_a_binding();
        }
        if self.session.has_expired(now, self.timing.search) {
            count(&mut self.counters.searches_given_up);
            self.reply([ConfigurationReply::Restart.encode()]);
        }
        if self.restart_at.is_some_and(|at| now >= at) {
            self.restart_at = None;
            // A search that goes on frees them at its end.
            if self.session.is_idle() {
                self.reply([ConfigurationReply::Restart.encode()]);
            }
        }
    }

    fn on_configuration_request(&mut self, now: Instant, request: ConfigurationRequest) {
        if self.role() != Role::Active {
            self.expect_an_answer(now);
            return;
        }
        match self.session.on_request(now, request) {
            Step::Ignored => {}
            Step::Reply(frame) => self.reply([frame]),
            Step::Whole(bits) => {
                let reply = self.assign(now, NodeUid::new(bits));
                self.session.conclude(request, reply);
            }
        }
    }

    /// Answers the last request of a search. Zero is no UID: it is noise, or two searches mixed up.
    fn assign(&mut self, now: Instant, uid: Option<NodeUid>) -> Option<Frame> {
        let Some(uid) = uid else {
            self.reply([ConfigurationReply::Restart.encode()]);
            return None;
        };
        let Some(tx_node) = self.nodes.assign(uid) else {
            count(&mut self.counters.no_id_left);
            self.tell(BrokerEvent::NoIdLeft(uid));
            self.reply([ConfigurationRefusal { uid }.encode()]);
            // Old clients do not know a refusal, and wait for the end of the search. The one that was
            // refused among them asks again then, which the pause keeps from filling the bus.
            self.restart_at = Some(now + self.timing.silence);
            return None;
        };
        let reply = ConfigurationReply::Assigned { uid, tx_node }.encode();
        self.reply([reply]);
        self.tell(BrokerEvent::Assigned { uid, tx_node });
        Some(reply)
    }

    fn on_get_etag(&mut self, now: Instant, requester: TxNode, subject: Subject) {
        if self.role() != Role::Active {
            self.expect_an_answer(now);
            return;
        }
        self.supply(requester, subject);
    }

    fn supply(&mut self, requester: TxNode, subject: Subject) {
        if self.replies.room() < 2 {
            count(&mut self.counters.replies_dropped);
            return;
        }
        let known = self.subjects.etag_of(subject);
        let answer = match known.or_else(|| self.subjects.bind(subject)) {
            Some(etag) => {
                if known.is_none() {
                    self.tell(BrokerEvent::Bound { subject, etag });
                }
                Answer::Bound(etag)
            }
            None => {
                count(&mut self.counters.no_etag_left);
                self.tell(BrokerEvent::NoEtagLeft(subject));
                Answer::Refused
            }
        };
        let halves = SupplyEtag::pair(TxNode::BROKER, requester, subject, answer);
        self.reply(halves.map(|half| half.encode()));
    }

    fn on_supply(&mut self, now: Instant, supply: Supply) {
        if supply.sender == TxNode::BROKER {
            self.on_other_broker(now);
            if let (Answer::Bound(etag), true) = (supply.answer, self.role() != Role::Active) {
                self.subjects.mirror(supply.subject, etag);
            }
            return;
        }
        let Answer::Bound(etag) = supply.answer else {
            return;
        };
        match self.state {
            State::Off => {}
            State::Active { .. } => self.check_claim(now, supply, etag),
            State::Standby { .. } => self.subjects.mirror(supply.subject, etag),
            // What a node uses now counts more than a stored table.
            State::Listening { until, .. } => {
                if self.contradicts(supply.subject, etag) {
                    count(&mut self.counters.contradictions);
                    self.compare_from(until + self.rank_delay());
                }
                self.subjects.mirror(supply.subject, etag);
            }
        }
    }

    /// A node uses `etag` for the subject of `supply`. If that contradicts the table, all nodes are told
    /// what is right.
    fn check_claim(&mut self, now: Instant, supply: Supply, etag: Etag) {
        if self.contradicts(supply.subject, etag) || self.subjects.restore(supply.subject, etag).is_err() {
            count(&mut self.counters.contradictions);
            self.supply(supply.requester, supply.subject);
            // See whether it was heard.
            if self.probe_at.is_none() {
                (self.probe_at, self.probes) = (Some(now + self.timing.silence), 1);
            }
        }
    }

    fn contradicts(&self, subject: Subject, etag: Etag) -> bool {
        self.subjects.etag_of(subject).is_some_and(|known| known != etag)
            || self.subjects.subject_of(etag).is_some_and(|known| known != subject)
    }

    fn on_configuration_reply(&mut self, now: Instant, reply: ConfigurationReply) {
        self.on_other_broker(now);
        if let (ConfigurationReply::Assigned { uid, tx_node }, true) = (reply, self.role() != Role::Active) {
            self.nodes.mirror(uid, tx_node);
        }
    }

    /// A frame that only an active broker sends.
    fn on_other_broker(&mut self, now: Instant) {
        match self.state {
            State::Off => {}
            State::Listening { .. } => self.stand_by(now, true),
            // Tell it that we are there; the one with the higher UID goes when it hears the other. The old
            // broker hears nothing, so there the user has two brokers.
            State::Active { .. } => self.state = State::Active { status_at: now },
            State::Standby { old: true, .. } => {
                self.state = State::Standby { dead_at: Instant::FAR_FUTURE, old: true };
            }
            State::Standby { old: false, .. } => {
                self.state = State::Standby { dead_at: self.dead_at(now), old: false };
            }
        }
    }

    fn on_broker_status(&mut self, now: Instant, status: BrokerStatus) {
        self.nodes.learn(status.uid, status.tx_node);
        match self.state {
            State::Off => {}
            State::Active { .. } if status.uid > self.uid => {
                self.state = State::Active { status_at: now };
                // When the other has gone, compare our table with what its nodes use.
                self.compare_from(now + self.timing.listen);
            }
            State::Listening { .. } | State::Active { .. } => self.stand_by(now, false),
            State::Standby { .. } => {
                self.state = State::Standby { dead_at: self.dead_at(now), old: false };
            }
        }
    }

    /// A node asks, and this broker is not the one to answer. If it is the old broker's turn, which shows
    /// no other sign of life, an answer must come soon.
    fn expect_an_answer(&mut self, now: Instant) {
        if let State::Standby { dead_at: Instant::FAR_FUTURE, old: true } = self.state {
            self.state = State::Standby { dead_at: self.dead_at(now), old: true };
        }
    }

    fn activate(&mut self, now: Instant) {
        // A standby has mirrored only what it has heard.
        if self.role() == Role::Standby {
            self.compare_from(now);
        }
        self.restart_at = None;
        self.session = Session::new();
        self.send_status(now);
        self.tell(BrokerEvent::Became(Role::Active));
        // Searches that the last broker has begun start over.
        self.reply([ConfigurationReply::Restart.encode()]);
    }

    fn stand_by(&mut self, now: Instant, old: bool) {
        let dead_at = if old { Instant::FAR_FUTURE } else { self.dead_at(now) };
        self.retire(State::Standby { dead_at, old });
        // The active broker's table is unknown here; the nodes' answers are the best copy.
        self.compare_from(now);
        self.tell(BrokerEvent::Became(Role::Standby));
    }

    /// Probes from then on, often enough that a lost frame does not matter.
    fn compare_from(&mut self, at: Instant) {
        (self.probe_at, self.probes) = (Some(at), PROBES);
    }

    fn retire(&mut self, state: State) {
        self.state = state;
        self.session = Session::new();
        self.replies.clear();
        (self.restart_at, self.probe_at) = (None, None);
    }

    fn send_status(&mut self, now: Instant) {
        self.state = State::Active { status_at: now + self.timing.status };
        self.reply([BrokerStatus { tx_node: self.tx_node, uid: self.uid }.encode()]);
    }

    fn dead_at(&self, now: Instant) -> Instant {
        now + self.timing.silence + self.rank_delay()
    }

    fn rank_delay(&self) -> Duration {
        times(self.timing.rank_step, self.tx_node.get().into())
    }

    fn repeat_a_binding(&mut self) {
        let Some((subject, etag)) = self.subjects.after(self.repeated) else { return };
        self.repeated = Some(etag);
        let halves = SupplyEtag::pair(TxNode::BROKER, self.tx_node, subject, Answer::Bound(etag));
        self.reply(halves.map(|half| half.encode()));
    }

    /// Queues all frames, or none of them.
    fn reply<const N: usize>(&mut self, frames: [Frame; N]) {
        if self.replies.room() < N {
            count(&mut self.counters.replies_dropped);
            return;
        }
        for frame in frames {
            let _fits = self.replies.push(frame);
        }
    }

    fn tell(&mut self, event: BrokerEvent) {
        if !self.events.push(event) {
            count(&mut self.counters.events_dropped);
        }
    }
}

/// The time of the next probe while listening: none behind `until`.
fn next_probe(at: Instant, until: Instant) -> Instant {
    if at < until { at } else { Instant::FAR_FUTURE }
}

fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

/// How often the nodes are probed when the table has to be compared with them.
const PROBES: u8 = 3;

/// Replies that wait to be sent. Each node has at most one request under way.
const REPLIES: usize = 32;

/// Events that wait to be fetched.
const EVENTS: usize = 16;
