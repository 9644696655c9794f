//! The nodes of the segment, by TxNode.

use cosmic_core::NodeUid;
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::protocol::{NodeState, NodeStatus};
use cosmic_core::time::{Duration, Instant};

use crate::load::Rate;

/// All nodes that were heard. At most 128.
#[derive(Clone, Debug)]
pub(crate) struct Nodes {
    nodes: Vec<Option<Box<NodeSeen>>>,
}

/// A node.
#[derive(Clone, Debug)]
pub(crate) struct NodeSeen {
    pub(crate) heard_at: Instant,
    pub(crate) frames: u64,
    pub(crate) rate: Rate,
    pub(crate) status: Option<(NodeStatus, Instant)>,
    /// Who claims the TxNode, the latest first.
    claims: [Option<(NodeUid, Instant)>; 2],
    /// Claims within a second that nobody asked for: since when, and how many.
    claiming: (Instant, u8),
    /// It has claimed its TxNode again and again.
    insisted_at: Option<Instant>,
    pub(crate) exceptions: u64,
    pub(crate) restarts: u32,
    /// Statuses that one node would not have sent in a row; one that fits takes one away.
    disorder: u8,
    pub(crate) alive: bool,
    pub(crate) evidence: Evidence,
}

/// Exceptions that what was seen on the bus explains, since the last status.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub(crate) struct Evidence(u32);

impl Evidence {
    pub(crate) fn add(&mut self, kind: ExceptionKind) {
        self.0 |= 1 << kind as u32;
    }

    pub(crate) fn take(&mut self) -> Vec<ExceptionKind> {
        let bits = core::mem::take(&mut self.0);
        ExceptionKind::ALL.iter().copied().filter(|kind| bits & 1 << *kind as u32 != 0).collect()
    }
}

/// What a status told.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub(crate) struct StatusNews {
    pub(crate) restarted: bool,
    pub(crate) exceptions: u16,
    /// The state before, if it is another.
    pub(crate) state_before: Option<NodeState>,
    pub(crate) left: bool,
}

impl Nodes {
    pub(crate) fn new() -> Self {
        Self { nodes: vec![None; 128] }
    }

    pub(crate) fn get(&self, tx_node: TxNode) -> Option<&NodeSeen> {
        self.nodes.get(usize::from(tx_node.get()))?.as_deref()
    }

    pub(crate) fn get_mut(&mut self, tx_node: TxNode) -> Option<&mut NodeSeen> {
        self.nodes.get_mut(usize::from(tx_node.get()))?.as_deref_mut()
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (TxNode, &NodeSeen)> {
        self.nodes
            .iter()
            .enumerate()
            .filter_map(|(at, node)| Some((TxNode::new(at as u8)?, node.as_deref()?)))
    }

    /// The node was heard; returns whether it was not there before.
    pub(crate) fn hear(&mut self, tx_node: TxNode, at: Instant) -> bool {
        let Some(place) = self.nodes.get_mut(usize::from(tx_node.get())) else { return false };
        let node = place.get_or_insert_with(|| Box::new(NodeSeen::new(at)));
        let appeared = !node.alive;
        node.alive = true;
        node.heard_at = at;
        node.frames += 1;
        node.rate.add(at);
        appeared
    }

    /// The nodes that have fallen silent since the last call.
    pub(crate) fn advance(&mut self, now: Instant) -> Vec<TxNode> {
        let mut silent = Vec::new();
        for (at, place) in self.nodes.iter_mut().enumerate() {
            let Some(node) = place else { continue };
            if node.alive && now.saturating_since(node.heard_at) > node.patience() {
                node.alive = false;
                silent.extend(TxNode::new(at as u8));
            }
        }
        silent
    }

    /// The other TxNode under which a node with this UID lives.
    pub(crate) fn other_with(&self, uid: NodeUid, tx_node: TxNode, now: Instant) -> Option<TxNode> {
        let same = |(other, node): &(TxNode, &NodeSeen)| {
            *other != tx_node && node.uid() == Some(uid) && node.sends_status(now)
        };
        self.iter().find(same).map(|(other, _)| other)
    }
}

impl NodeSeen {
    fn new(at: Instant) -> Self {
        Self {
            heard_at: at,
            frames: 0,
            rate: Rate::default(),
            status: None,
            claims: [None; 2],
            claiming: (at, 0),
            insisted_at: None,
            exceptions: 0,
            restarts: 0,
            disorder: 0,
            alive: false,
            evidence: Evidence::default(),
        }
    }

    /// A node that sends its status is missed sooner than one that only publishes now and then.
    fn patience(&self) -> Duration {
        if self.status.is_some() { STATUS_SILENCE } else { SILENCE }
    }

    pub(crate) fn uid(&self) -> Option<NodeUid> {
        self.claims[0].map(|(uid, _)| uid)
    }

    /// Returns whether its own status came lately.
    pub(crate) fn sends_status(&self, now: Instant) -> bool {
        self.status.is_some_and(|(_, at)| now.saturating_since(at) <= STATUS_SILENCE)
    }

    /// The node says that it has this UID, and nobody had asked for that. A node does so when it gets its TxNode, and
    /// whenever it hears another one with it.
    pub(crate) fn insist(&mut self, uid: NodeUid, at: Instant) {
        let (since, count) = self.claiming;
        let count = if at.saturating_since(since) <= INSISTING { count.saturating_add(1) } else { 1 };
        self.claiming = (if count == 1 { at } else { since }, count);
        if count >= CLAIMS {
            self.insisted_at = Some(at);
        }
        self.claim(uid, at);
    }

    /// The node says that it has this UID.
    pub(crate) fn claim(&mut self, uid: NodeUid, at: Instant) {
        match self.claims {
            [Some((latest, _)), _] if latest == uid => self.claims[0] = Some((uid, at)),
            [latest, _] => self.claims = [Some((uid, at)), latest],
        }
    }

    /// The broker says so; what was before has ended.
    pub(crate) fn assign(&mut self, uid: NodeUid, at: Instant) {
        if self.uid() != Some(uid) {
            self.claims = [Some((uid, at)), None];
        }
    }

    pub(crate) fn release(&mut self) {
        self.claims = [None; 2];
        self.alive = false;
        self.status = None;
    }

    /// The two UIDs that claim this TxNode, or none if only what one of them sends tells of two nodes.
    pub(crate) fn duplicate(&self, now: Instant) -> Option<Option<(NodeUid, NodeUid)>> {
        if let [Some((one, at)), Some((other, before))] = self.claims
            && at.saturating_since(before) <= CLAIM
            && now.saturating_since(at) <= CLAIM
        {
            return Some(Some((one.min(other), one.max(other))));
        }
        let insists = self.insisted_at.is_some_and(|at| now.saturating_since(at) <= CLAIM);
        (insists || self.disorder >= DISORDER && self.sends_status(now)).then_some(None)
    }

    pub(crate) fn on_status(&mut self, status: &NodeStatus, at: Instant) -> StatusNews {
        let before = self.status.replace((*status, at));
        let left = status.state == NodeState::Leaving;
        if left {
            self.alive = false;
            self.status = None;
        }
        let Some((before, heard_at)) = before else {
            return StatusNews { left, ..StatusNews::default() };
        };
        let since = at.saturating_since(heard_at);
        if before == *status && since < REPETITION {
            return StatusNews { left, ..StatusNews::default() };
        }
        let restarted = status.sequence == 0 || status.uptime < before.uptime;
        let leapt = status.uptime.duration() > before.uptime.duration() + since + TOLERANCE;
        let stood_still = status.sequence == before.sequence && status.sequence != 0;
        let disordered = leapt || stood_still || (restarted && status.sequence != 0);
        self.disorder = if disordered {
            self.disorder.saturating_add(2).min(20)
        } else {
            self.disorder.saturating_sub(1)
        };
        // Counters of a node that has started again begin at zero. Two nodes under one id make no sense of theirs.
        let exceptions = match (disordered, restarted) {
            (true, _) => 0,
            (false, true) => status.exceptions,
            (false, false) => status.exceptions.wrapping_sub(before.exceptions),
        };
        self.exceptions += u64::from(exceptions);
        let restarted = restarted && !disordered;
        self.restarts = self.restarts.saturating_add(restarted.into());
        if before.transmit_errors >= ERROR_PASSIVE && status.transmit_errors == 0 && !restarted {
            self.evidence.add(ExceptionKind::BusOff);
        }
        let state_before = (before.state != status.state && !restarted).then_some(before.state);
        StatusNews { restarted, exceptions, state_before, left }
    }
}

/// A node that sends its status every half second is dead after this.
const STATUS_SILENCE: Duration = Duration::from_secs(3);
/// Any other.
const SILENCE: Duration = Duration::from_secs(10);
/// Claims of one TxNode by two UIDs within this span contradict each other.
const CLAIM: Duration = Duration::from_secs(30);
/// So many claims within this span are no start.
const CLAIMS: u8 = 4;
const INSISTING: Duration = Duration::from_secs(1);
/// A status that CAN sends again comes within this span.
const REPETITION: Duration = Duration::from_millis(20);
/// Uptimes are told in seconds.
const TOLERANCE: Duration = Duration::from_secs(2);
/// So much disorder is no single node's: two statuses that do not fit.
const DISORDER: u8 = 4;
/// The error counter from which on a controller no longer disturbs others (ISO 11898-1, fault confinement).
const ERROR_PASSIVE: u8 = 128;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_core::protocol::Uptime;

    const NODE: TxNode = TxNode::new(5).unwrap();

    fn at(ms: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(ms))
    }

    fn status(sequence: u8, exceptions: u16, uptime_s: u64) -> NodeStatus {
        let uptime = Uptime::new(Duration::from_secs(uptime_s));
        NodeStatus { sequence, exceptions, uptime, ..NodeStatus::first(NODE, NodeState::Operational) }
    }

    #[test]
    fn increments_are_counted_across_wraps_and_restarts() {
        let mut node = NodeSeen::new(at(0));
        assert_eq!(node.on_status(&status(7, 65_534, 100), at(0)), StatusNews::default());
        assert_eq!(node.on_status(&status(8, 1, 100), at(500)).exceptions, 3);
        assert_eq!(node.on_status(&status(8, 1, 100), at(501)).exceptions, 0, "CAN sent it again");
        let news = node.on_status(&status(0, 2, 0), at(900));
        assert!(news.restarted && news.exceptions == 2);
        assert_eq!((node.exceptions, node.restarts), (5, 1));
        assert_eq!(node.duplicate(at(900)), None);
    }

    #[test]
    fn two_nodes_under_one_id_show_in_their_statuses() {
        let mut node = NodeSeen::new(at(0));
        for turn in 0..6 {
            node.on_status(&status(10 + turn, 0, 1_000), at(u64::from(turn) * 500));
            node.on_status(&status(3 + turn, 9, 20), at(u64::from(turn) * 500 + 200));
        }
        assert_eq!(node.duplicate(at(2_800)), Some(None));
        assert_eq!((node.exceptions, node.restarts), (0, 0));
    }

    #[test]
    fn two_claims_are_a_duplicate_and_an_assignment_is_none() {
        let uid = |number| NodeUid::new(number).unwrap();
        let mut node = NodeSeen::new(at(0));
        node.claim(uid(1), at(0));
        node.assign(uid(2), at(1_000));
        node.claim(uid(2), at(1_001));
        assert_eq!(node.duplicate(at(1_001)), None);
        node.claim(uid(1), at(1_100));
        assert_eq!(node.duplicate(at(1_100)), Some(Some((uid(1), uid(2)))));
        assert_eq!(node.duplicate(at(60_000)), None);
    }
}
