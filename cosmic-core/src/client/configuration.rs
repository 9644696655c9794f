//! The configuration client: from the node's UID to a TxNode that no other node has.
//!
//! ```text
//!            +----------- no answer ------------+
//!            v                                  |
//!  start -> Idle --> Asking, stage 15..0 --> Claiming --> Configured
//!            ^          |        ^              |             |
//!            |     other prefix  | its end      |             |
//!            |          v        |              |             |
//!            |       Waiting ----+              |             |
//!            +------------- another node has the id ----------+
//! ```
//! *Asking*: see [`crate::protocol::ConfigurationRequest`]. *Claiming*: the broker has assigned an id;
//! before it is used the node says so on the bus, and listens whether some node uses it already. That
//! catches what a broker cannot know: nodes with a fixed id, two nodes with one UID, a broker that lost
//! its table. *Configured*: a frame of another sender with this TxNode means a conflict. The node defends
//! its id by stating its UID, which makes a claiming node go; if the other stays, the one with the higher
//! UID goes, and both if they have the same UID. That can only be between nodes that were configured
//! apart, on a bus that was cut in two. A node whose id the plan gives to it alone does not go: see
//! [`OnDuplicate`].
//!
//! A node answers probes and other senders with its id so many times a second, whatever comes: an answer
//! that would come too early is put off, and then serves for all.

use super::report::{ConfigurationEvent, ConfigurationTiming, OnDuplicate};
use crate::can::{Etag, Frame, TxNode};
use crate::jitter::{Jitter, doubled};
use crate::protocol::{
    ConfigurationRefusal, ConfigurationReply, ConfigurationRequest, NodeIdentity, Output, Prefix, Probe,
    Release, Stage, names_its_sender,
};
use crate::ring::Ring;
use crate::time::{Duration, Instant};
use crate::uid::NodeUid;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// Nothing is asked for a while.
    Idle,
    /// The request of this stage is out, so often.
    Asking { stage: Stage, tries: u8 },
    /// Another UID is being searched.
    Waiting,
    /// Whether the id is free: so many claims are still to be sent.
    Claiming { tx_node: TxNode, claims: u8 },
    /// The id is ours.
    Configured { tx_node: TxNode },
    /// The id was given back.
    Released,
}

/// The configuration client of one node; its contract is that of [`crate::client`].
///
/// Every call takes constant time.
#[derive(Clone, Debug)]
pub struct Configuration {
    uid: NodeUid,
    fixed: Option<TxNode>,
    on_duplicate: OnDuplicate,
    timing: &'static ConfigurationTiming,
    jitter: Jitter,
    state: State,
    /// Until then nothing is to be done in this state.
    until: Instant,
    /// The claim of the id that we claim or have ends then.
    claimed_until: Instant,
    failures: u8,
    /// Conflicts that the other's identity made, which count together until then.
    strikes: u8,
    strikes_until: Instant,
    /// The next answer is not due before then, so that there are not too many.
    no_answer_until: Instant,
    /// An answer is due then.
    answer_at: Instant,
    // What `poll` hands out: first the request that has become void, then events, then a frame. A newer
    // frame replaces an older one that nobody has fetched: it makes the older one void.
    request: Option<Stage>,
    void: Option<Stage>,
    events: Ring<ConfigurationEvent, 4>,
    events_dropped: u16,
    send: Option<Outgoing>,
}

/// A frame of this node, before it is put together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Outgoing {
    Request(Stage),
    Identity(TxNode),
    Release(TxNode),
}

impl Outgoing {
    #[inline(never)]
    fn encode(self, uid: NodeUid) -> Frame {
        match self {
            Self::Request(stage) => ConfigurationRequest::new(uid, stage).encode(),
            Self::Identity(tx_node) => NodeIdentity { tx_node, uid }.encode(),
            Self::Release(tx_node) => Release { tx_node, uid }.encode(),
        }
    }
}

impl Configuration {
    /// A node without a TxNode, which asks the broker for one.
    ///
    /// `noise` is anything that differs between nodes and starts, such as a unique id of the processor or
    /// the low bits of a timer; zero is allowed. With it two nodes that have one UID by mistake do not
    /// act in lockstep.
    pub fn new(now: Instant, uid: NodeUid, noise: u64, timing: &'static ConfigurationTiming) -> Self {
        let mut jitter = Jitter::new(uid.get() ^ noise.rotate_left(32));
        let until = now + jitter.below(timing.reply);
        Self {
            uid,
            fixed: None,
            on_duplicate: OnDuplicate::Yield,
            timing,
            jitter,
            state: State::Idle,
            until,
            claimed_until: Instant::EPOCH,
            failures: 0,
            strikes: 0,
            strikes_until: Instant::EPOCH,
            no_answer_until: Instant::EPOCH,
            answer_at: Instant::FAR_FUTURE,
            request: None,
            void: None,
            events: Ring::new(),
            events_dropped: 0,
            send: None,
        }
    }

    /// A node whose TxNode is fixed, in a cluster with or without a broker. It claims the id like any
    /// other, and yields, unless [`on_duplicate`](Self::on_duplicate) says otherwise.
    pub fn fixed(
        now: Instant,
        uid: NodeUid,
        tx_node: TxNode,
        noise: u64,
        timing: &'static ConfigurationTiming,
    ) -> Self {
        let mut new = Self { fixed: Some(tx_node), ..Self::new(now, uid, noise, timing) };
        new.claim(now, tx_node);
        new
    }

    /// This node, whose TxNode is fixed, does this when another one uses it. Nothing changes for a node that
    /// asks the broker.
    #[must_use]
    pub const fn on_duplicate(mut self, on_duplicate: OnDuplicate) -> Self {
        if self.fixed.is_some() {
            self.on_duplicate = on_duplicate;
        }
        self
    }

    /// The id, while it is ours to use.
    pub const fn tx_node(&self) -> Option<TxNode> {
        match self.state {
            State::Configured { tx_node } => Some(tx_node),
            _ => None,
        }
    }

    /// The node's UID.
    pub const fn uid(&self) -> NodeUid {
        self.uid
    }

    /// Events that were lost because nobody polled.
    pub const fn events_dropped(&self) -> u16 {
        self.events_dropped
    }

    /// Gives the id back to the broker, for good: the node sends nothing behind the frame of this.
    pub fn release(&mut self) {
        if let State::Configured { tx_node } | State::Claiming { tx_node, .. } = self.state {
            self.send = Some(Outgoing::Release(tx_node));
        }
        self.withdraw_request();
        self.enter(State::Released, Instant::FAR_FUTURE);
    }

    /// Takes a received frame.
    // Out of line, as `poll` is, a field is reached by its distance from here: instructions of two bytes, not four.
    #[inline(never)]
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) {
        match frame.id.etag() {
            Etag::CONFIGURATION_REPLY => {
                if let Some(reply) = ConfigurationReply::decode(frame) {
                    self.on_reply(now, reply);
                }
            }
            Etag::CONFIGURATION_REFUSAL => {
                if let Some(refusal) = ConfigurationRefusal::decode(frame) {
                    self.on_refusal(now, refusal.uid);
                }
            }
            _ if names_its_sender(frame.id) && Some(frame.id.tx_node()) == self.claimed() => {
                let uid = NodeIdentity::decode(frame).map(|identity| identity.uid);
                self.on_own_tx_node(now, frame.id.tx_node(), uid);
            }
            Etag::PROBE if Probe::decode(frame).is_some() => self.answer(now),
            _ => {}
        }
    }

    /// What is to be done now; call until it returns `None`.
    #[inline(never)]
    pub fn poll(&mut self, now: Instant) -> Option<Output<ConfigurationEvent>> {
        if now >= self.until {
            self.on_time_out(now);
        }
        if now >= self.answer_at {
            self.identify(now);
        }
        if let Some(stage) = self.void.take() {
            return Some(Output::Withdraw(Outgoing::Request(stage).encode(self.uid)));
        }
        if let Some(event) = self.events.pop() {
            return Some(Output::Event(event));
        }
        Some(Output::Send(self.send.take()?.encode(self.uid)))
    }

    /// When `poll` must be called even if no frame arrives.
    pub fn next_wakeup(&self) -> Instant {
        self.until.min(self.answer_at)
    }

    fn enter(&mut self, state: State, until: Instant) {
        self.state = state;
        self.until = until;
    }

    #[expect(clippy::arithmetic_side_effects, reason = "below the most tries; claims are at least one")]
    fn on_time_out(&mut self, now: Instant) {
        match self.state {
            State::Idle if let Some(tx_node) = self.fixed => self.claim(now, tx_node),
            State::Idle | State::Waiting => self.ask(now, Stage::FIRST, 1),
            State::Asking { stage, tries } if tries < MAX_TRIES => {
                self.withdraw_request();
                self.ask(now, stage, tries + 1);
            }
            State::Asking { .. } => self.back_off(now),
            // At no fixed time: the claims of two nodes with one UID would be one frame.
            State::Claiming { tx_node, claims: claims @ 1.. } => {
                self.identify(now);
                let third = self.third_of_claim();
                let again =
                    self.until + Duration::from_ticks(third.as_ticks() / 2) + self.jitter.below(third);
                let until = if claims > 1 { again } else { self.claimed_until };
                self.enter(State::Claiming { tx_node, claims: claims - 1 }, until);
            }
            State::Claiming { tx_node, .. } => {
                self.failures = 0;
                self.forget_strikes();
                self.claimed_until = now + self.timing.claim;
                self.enter(State::Configured { tx_node }, Instant::FAR_FUTURE);
                self.tell(ConfigurationEvent::Configured(tx_node));
            }
            State::Configured { .. } | State::Released => {}
        }
    }

    fn on_reply(&mut self, now: Instant, reply: ConfigurationReply) {
        match (self.state, reply) {
            (State::Released, _) => {}
            (State::Claiming { tx_node, .. }, ConfigurationReply::Assigned { uid, tx_node: assigned }) => {
                // The broker does not know us under this id, or a second broker gives it to another node.
                if uid != self.uid && assigned == tx_node {
                    self.answer(now);
                }
            }
            (State::Configured { tx_node }, ConfigurationReply::Assigned { uid, tx_node: assigned }) => {
                self.on_assigned_to_another(now, tx_node, uid, assigned);
            }
            (State::Claiming { .. } | State::Configured { .. }, _) => {}
            // A node that pauses takes no part: it failed, or was refused, and gives way to others.
            (State::Idle, _) => {}
            _ if self.fixed.is_some() => {}
            // Only the answer to the question for the last nibble: a forged one at another time could make
            // this node take the id of a node that is about to start.
            (State::Asking { stage: Stage::LAST, .. }, ConfigurationReply::Assigned { uid, tx_node })
                if uid == self.uid =>
            {
                self.claim(now, tx_node);
            }
            (_, ConfigurationReply::Prefix(prefix)) => self.on_prefix(now, prefix),
            (_, ConfigurationReply::Assigned { .. } | ConfigurationReply::Restart) => self.begin_again(now),
        }
    }

    /// A reply tells which stage comes next: a node with this prefix asks for it, even if it waited or has
    /// missed some replies; any other has lost.
    fn on_prefix(&mut self, now: Instant, prefix: Prefix) {
        self.failures = 0;
        let Some(next) = prefix.stage().next().filter(|_| prefix.begins(self.uid)) else {
            self.withdraw_request();
            self.enter(State::Waiting, now + self.timing.search);
            return;
        };
        // The same reply twice: the request is out already.
        if !matches!(self.state, State::Asking { stage, .. } if stage == next) {
            self.withdraw_request();
            self.ask(now, next, 1);
        }
    }

    fn on_refusal(&mut self, now: Instant, uid: NodeUid) {
        match self.state {
            State::Claiming { .. } | State::Configured { .. } | State::Released => {}
            _ if self.fixed.is_some() => {}
            _ if uid == self.uid => {
                self.withdraw_request();
                self.tell(ConfigurationEvent::Refused);
                self.pause(now, self.timing.longest_back_off);
            }
            State::Idle => {}
            _ => self.begin_again(now),
        }
    }

    /// The broker assigns our id to another node, or some id to another node with our UID.
    fn on_assigned_to_another(&mut self, now: Instant, tx_node: TxNode, uid: NodeUid, assigned: TxNode) {
        // The reply that made us what we are may come twice.
        let settled = now >= self.claimed_until;
        if (uid != self.uid && assigned == tx_node) || (uid == self.uid && settled) {
            self.report_conflict(now, tx_node, Some(uid));
            self.answer(now);
        }
    }

    /// Another node sent with the id that we have or claim.
    fn on_own_tx_node(&mut self, now: Instant, tx_node: TxNode, other: Option<NodeUid>) {
        let strikes = self.report_conflict(now, tx_node, other);
        match self.state {
            State::Claiming { .. } if self.on_duplicate != OnDuplicate::Stay => self.give_way(now, other),
            State::Claiming { .. } => {}
            _ if self.yields_to(other) && strikes >= MAX_STRIKES => {
                self.forget_strikes();
                self.tell(ConfigurationEvent::Lost(tx_node));
                self.send = None;
                self.pause(now, self.timing.longest_back_off);
            }
            // A node that has heard so many answers knows, and would answer each of them.
            _ if other.is_some() && strikes > MAX_STRIKES => {}
            _ => self.answer(now),
        }
    }

    fn yields_to(&self, other: Option<NodeUid>) -> bool {
        self.on_duplicate == OnDuplicate::Yield && other.is_some_and(|other| other <= self.uid)
    }

    /// Ends a claim: whoever has the id keeps it. It has heard our claim, and states its UID, so the broker
    /// learns.
    fn give_way(&mut self, now: Instant, other: Option<NodeUid>) {
        if other.is_some() {
            self.send = None;
        }
        self.forget_strikes();
        self.failures = self.failures.saturating_add(1);
        let pause = if self.fixed.is_some() || other == Some(self.uid) {
            self.timing.longest_back_off
        } else {
            self.timing.back_off
        };
        self.pause(now, pause);
    }

    /// Counts a conflict, and tells of the first in its span. Returns how many the other's identity made.
    fn report_conflict(&mut self, now: Instant, tx_node: TxNode, other: Option<NodeUid>) -> u8 {
        if now >= self.strikes_until {
            self.tell(ConfigurationEvent::Conflict { tx_node, other });
            self.strikes = 0;
            self.strikes_until = now + self.timing.conflict;
        }
        self.strikes = self.strikes.saturating_add(u8::from(other.is_some()));
        self.strikes
    }

    fn forget_strikes(&mut self) {
        self.strikes_until = Instant::EPOCH;
    }

    fn ask(&mut self, now: Instant, stage: Stage, tries: u8) {
        self.request = Some(stage);
        self.send = Some(Outgoing::Request(stage));
        let patience = doubled(self.timing.reply, self.failures.min(4));
        self.enter(State::Asking { stage, tries }, now + patience);
    }

    fn begin_again(&mut self, now: Instant) {
        self.withdraw_request();
        self.ask(now, Stage::FIRST, 1);
    }

    fn back_off(&mut self, now: Instant) {
        self.withdraw_request();
        let pause = doubled(self.timing.back_off, self.failures.min(8));
        let pause = if pause < self.timing.longest_back_off { pause } else { self.timing.longest_back_off };
        self.failures = self.failures.saturating_add(1);
        self.pause(now, pause);
    }

    /// Asks nothing for about so long.
    fn pause(&mut self, now: Instant, mean: Duration) {
        let until = now + self.jitter.around(mean);
        self.enter(State::Idle, until);
    }

    fn claim(&mut self, now: Instant, tx_node: TxNode) {
        self.withdraw_request();
        self.claimed_until = now + self.timing.claim;
        let claim_at = now + self.jitter.below(self.third_of_claim());
        self.enter(State::Claiming { tx_node, claims: CLAIMS }, claim_at);
    }

    fn third_of_claim(&self) -> Duration {
        Duration::from_ticks(self.timing.claim.as_ticks() / 3)
    }

    /// The id that we have or claim.
    pub(crate) fn claimed(&self) -> Option<TxNode> {
        match self.state {
            State::Claiming { tx_node, .. } | State::Configured { tx_node } => Some(tx_node),
            _ => None,
        }
    }

    /// States who has the id; not more often than a claiming node can wait for.
    fn answer(&mut self, now: Instant) {
        if self.claimed().is_some() {
            self.answer_at = self.answer_at.min(now.max(self.no_answer_until));
        }
    }

    fn identify(&mut self, now: Instant) {
        self.answer_at = Instant::FAR_FUTURE;
        if let Some(tx_node) = self.claimed() {
            self.no_answer_until = now + self.third_of_claim();
            self.send = Some(Outgoing::Identity(tx_node));
        }
    }

    fn withdraw_request(&mut self) {
        let Some(stage) = self.request.take() else { return };
        if self.send == Some(Outgoing::Request(stage)) {
            self.send = None; // nobody has fetched it
        } else {
            self.void = Some(stage);
        }
    }

    fn tell(&mut self, event: ConfigurationEvent) {
        if !self.events.push(event) {
            self.events_dropped = self.events_dropped.saturating_add(1);
        }
    }
}

/// How often a stage is asked until the node starts over.
const MAX_TRIES: u8 = 3;

/// How often a node states its identity before it uses its id: one of them may be lost.
const CLAIMS: u8 = 2;

/// How many identities of another node with our id we answer until one of the two has to go.
const MAX_STRIKES: u8 = 3;
