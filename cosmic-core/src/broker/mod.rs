//! The event channel broker (ECB), which hands out TxNodes and etags.
//!
//! Any node whose TxNode is known can host one; several may, of which one is active and the others stand by. It
//! is a state machine as its [clients](crate::client) are, with the same contract.
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
//! and etags of which only the use is seen are kept out of use, as long as they are used
//! ([`BrokerTiming::unnamed`]).
//!
//! # Two active brokers
//! They hear each other's status: the one with the lower UID stays, the other stands by. The one that
//! stays probes the nodes. A binding of the other that contradicts its table gets a new etag, which all
//! nodes hear. Two nodes with one TxNode find each other, and one of them asks for a new id (see
//! [`Configuration`](crate::client::Configuration)).
//!
//! # Lost frames
//! Whatever was lost, all tables agree in the end: with each status the active broker repeats one binding
//! of its table. A node whose binding differs, or whose etag belongs to another subject, changes over or
//! asks anew, and a standby corrects its copy. That costs two frames in [`BrokerTiming::status`], and one
//! round takes as many of these spans as there are subjects.
//!
//! # FAMOUSO's broker
//! It sends nothing unasked. So a broker that listens asks for the etag of a subject that is reserved for
//! this ([`Subject::RESERVED`]), and stands by when it is answered. The old broker hands ids and etags out
//! from the top down, as this one does: all that are not below one of its answers are taken. How many ids it
//! has handed out is not known, so from then on this one begins at the bottom of its table. The old broker is
//! taken for dead when a request remains without an answer.
//!
//! # Frames that should not be
//! Whatever another node sends: it is answered so many times a second at most
//! ([`BrokerTiming::between_answers`], [`BrokerTiming::between_supplies`]), the host's own id is never given away,
//! and what a node said without a name is forgotten some time after it was said last. A name that was told keeps its
//! id or etag; but when none is left, one that nobody was seen to use for an hour goes ([`BrokerTiming::named`]), so
//! that false names do not fill the table for good.

mod others;
mod report;
mod requests;
mod session;
mod table;
mod tables;

pub use report::{BrokerCounters, BrokerEvent, BrokerRole, BrokerTiming};
pub use table::Conflict;
pub use tables::{Nodes, Subjects};

use self::session::Session;
use crate::can::{Etag, Frame, Id, TxNode};
use crate::jitter::times;
use crate::protocol::{
    Answer, BrokerStatus, ConfigurationReply, ControlMessage, GetEtag, Halves, Interest, Output, Probe,
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
/// contract is that of [`crate::client`].
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
    status_sent_at: Instant,
    /// Another broker has answered, and has not sent its status since. When to tell.
    foreign_at: Option<Instant>,
    /// Before this, another broker with the same UID is not told again.
    namesake_at: Instant,
    /// The nominal instant of the next answer about an etag.
    supply_at: Instant,
    /// An old broker has handed out ids, or still does.
    old_ids: bool,
    /// The owner was told that no id, or no etag, is free.
    ids_used_up: bool,
    etags_used_up: bool,
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
            status_sent_at: Instant::EPOCH,
            foreign_at: None,
            namesake_at: Instant::EPOCH,
            supply_at: Instant::EPOCH,
            old_ids: false,
            ids_used_up: false,
            etags_used_up: false,
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
                self.tell(BrokerEvent::Became(BrokerRole::Listening));
            }
            Some(tx_node) => {
                self.tx_node = tx_node;
                self.nodes.learn(self.uid, tx_node);
            }
            None if self.state == State::Off => {}
            None => {
                self.retire(State::Off);
                self.tell(BrokerEvent::Became(BrokerRole::Off));
            }
        }
    }

    /// What the broker does.
    pub const fn role(&self) -> BrokerRole {
        match self.state {
            State::Off => BrokerRole::Off,
            State::Listening { .. } => BrokerRole::Listening,
            State::Active { .. } => BrokerRole::Active,
            State::Standby { .. } => BrokerRole::Standby,
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

    /// An event has been received: the broker learns which id and which etag are in use. Returns whether
    /// [`poll`](Self::poll) has to be called. Constant time, unless the last that was free is in use now.
    pub fn on_event(&mut self, now: Instant, id: Id) -> bool {
        if self.state == State::Off {
            return false;
        }
        let until = now + self.timing.unnamed;
        let node = names_its_sender(id) && self.nodes.occupy(id.tx_node(), until);
        let channel = id.etag() >= Etag::BOUND_FIRST && self.subjects.occupy(id.etag(), until);
        (node || channel) && self.look_for_room()
    }

    /// Takes a received frame; control messages and all others, which are [events](Self::on_event).
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) {
        if self.state == State::Off {
            return;
        }
        self.on_event(now, frame.id);
        if frame.id.etag().is_reserved() {
            self.on_message(now, frame);
            self.look_for_room();
        }
    }

    fn on_message(&mut self, now: Instant, frame: &Frame) {
        match ControlMessage::decode(frame) {
            Some(ControlMessage::ConfigurationRequest(request)) => {
                self.on_configuration_request(now, request)
            }
            Some(ControlMessage::ConfigurationReply(reply)) => self.on_configuration_reply(now, reply),
            Some(ControlMessage::ConfigurationRefusal(_)) => self.on_other_broker(now),
            Some(ControlMessage::GetEtag(request)) => {
                self.on_get_etag(now, request.requester, request.subject)
            }
            Some(ControlMessage::SupplyEtag(half)) => {
                if let Some(supply) = self.halves.join(half) {
                    self.on_supply(now, supply);
                }
            }
            Some(ControlMessage::NodeIdentity(identity)) => self.learn(identity.uid, identity.tx_node),
            Some(ControlMessage::Release(release)) => {
                let known = self.nodes.uid_of(release.tx_node) == Some(release.uid);
                if known && !self.is_host(release.uid, release.tx_node) {
                    self.nodes.release(release.uid);
                }
            }
            Some(ControlMessage::BrokerStatus(status)) => self.on_broker_status(now, status),
            // What nobody wants any more is no use.
            Some(ControlMessage::Interest(Interest { etag, lease, .. }))
                if etag >= Etag::BOUND_FIRST && !lease.is_withdrawn() =>
            {
                self.subjects.occupy(etag, now + lease.duration());
            }
            // Admission is answered by another part of the node.
            Some(
                ControlMessage::Interest(_)
                | ControlMessage::NodeStatus(_)
                | ControlMessage::Probe(_)
                | ControlMessage::AdmissionRequest(_)
                | ControlMessage::AdmissionReply(_),
            )
            | None => {}
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
                let tx_node = self.tx_node;
                let question = GetEtag { requester: tx_node, subject: Subject::RESERVED };
                self.reply([Probe { tx_node }.encode(), question.encode()]);
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
        if self.state != State::Off && self.foreign_at.is_some_and(|at| now >= at) {
            self.foreign_at = Some(Instant::FAR_FUTURE);
            self.old_ids = true;
            self.tell(BrokerEvent::ForeignBroker);
        }
        match self.events.pop() {
            Some(event) => Some(Output::Event(event)),
            None => self.replies.pop().map(Output::Send),
        }
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Instant {
        self.due_at().unwrap_or(Instant::FAR_FUTURE)
    }

    fn due_at(&self) -> Option<Instant> {
        let of_state = match self.state {
            State::Off => return None,
            State::Listening { until, probe_at } => Some(probe_at.min(until + self.rank_delay())),
            State::Active { status_at } => Some(status_at),
            State::Standby { dead_at, .. } => Some(dead_at),
        };
        let search = self.session.expires_at(self.timing.search);
        [of_state, search, self.restart_at, self.probe_at, self.foreign_at].into_iter().flatten().min()
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

    fn activate(&mut self, now: Instant) {
        // A standby has mirrored only what it has heard.
        if self.role() == BrokerRole::Standby {
            self.compare_from(now);
        }
        (self.restart_at, self.foreign_at) = (None, None);
        self.session = Session::new();
        self.send_status(now);
        self.tell(BrokerEvent::Became(BrokerRole::Active));
        // Searches that the last broker has begun start over.
        self.reply([ConfigurationReply::Restart.encode()]);
    }

    fn stand_by(&mut self, now: Instant, old: bool) {
        let dead_at = if old { Instant::FAR_FUTURE } else { self.dead_at(now) };
        self.retire(State::Standby { dead_at, old });
        // The active broker's table is unknown here; the nodes' answers are the best copy.
        self.compare_from(now);
        self.tell(BrokerEvent::Became(BrokerRole::Standby));
    }

    /// Probes from then on, often enough that a lost frame does not matter.
    fn compare_from(&mut self, at: Instant) {
        (self.probe_at, self.probes) = (Some(at), PROBES);
    }

    fn retire(&mut self, state: State) {
        self.state = state;
        self.session = Session::new();
        self.replies.clear();
        (self.restart_at, self.probe_at, self.foreign_at) = (None, None, None);
    }

    /// Another broker is to hear of this one, which answers; at once, unless that was just done.
    fn hasten_status(&mut self, now: Instant) {
        if let State::Active { status_at } = self.state {
            let soonest = now.max(self.status_sent_at + self.timing.between_answers);
            self.state = State::Active { status_at: status_at.min(soonest) };
        }
    }

    /// A node states its name. One that takes the host's id, or its UID, finds the host itself.
    fn learn(&mut self, uid: NodeUid, tx_node: TxNode) {
        if tx_node != TxNode::BROKER && !self.is_host(uid, tx_node) {
            self.nodes.learn(uid, tx_node);
        }
    }

    fn is_host(&self, uid: NodeUid, tx_node: TxNode) -> bool {
        uid == self.uid || tx_node == self.tx_node
    }

    /// Tells when nothing is free any more: once, until something was free again. Returns whether it told.
    fn look_for_room(&mut self) -> bool {
        let ids_used_up = self.nodes.free() == 0;
        let etags_used_up = self.subjects.free() == 0;
        let (ids, etags) = (ids_used_up && !self.ids_used_up, etags_used_up && !self.etags_used_up);
        (self.ids_used_up, self.etags_used_up) = (ids_used_up, etags_used_up);
        if ids {
            self.tell(BrokerEvent::IdsUsedUp { unnamed: self.nodes.unnamed() });
        }
        if etags {
            self.tell(BrokerEvent::EtagsUsedUp { unnamed: self.subjects.unnamed() });
        }
        ids || etags
    }

    fn send_status(&mut self, now: Instant) {
        self.state = State::Active { status_at: now + self.timing.status };
        self.status_sent_at = now;
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
