//! Who is broker: heartbeats, and answers that contradict each other.

use cosmic_core::can::{Etag, TxNode};
use cosmic_core::protocol::SupplyEtag;
use cosmic_core::time::{Duration, Instant};
use cosmic_core::{NodeUid, Subject};

/// What is known of brokers. Every call takes constant time.
#[derive(Clone, Debug)]
pub(crate) struct Brokers {
    /// The two that were heard last, the latest first.
    heard: [Option<Heartbeat>; 2],
    overlap: Option<Overlap>,
    contradiction: Option<(Subject, Etag, Etag, Instant)>,
    /// First halves that wait for their second, by sender.
    halves: Vec<Option<SupplyEtag>>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Heartbeat {
    tx_node: TxNode,
    uid: NodeUid,
    at: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Overlap {
    nodes: (TxNode, TxNode),
    last: Instant,
    turns: u32,
}

impl Brokers {
    pub(crate) fn new() -> Self {
        Self { heard: [None; 2], overlap: None, contradiction: None, halves: vec![None; 128] }
    }

    /// Takes a heartbeat; returns whether another broker than before is active.
    pub(crate) fn heartbeat(&mut self, tx_node: TxNode, uid: NodeUid, at: Instant) -> bool {
        let beat = Heartbeat { tx_node, uid, at };
        let [latest, _] = self.heard;
        let Some(latest) = latest else {
            self.heard = [Some(beat), None];
            return true;
        };
        if latest.uid == uid && latest.tx_node == tx_node {
            self.heard[0] = Some(beat);
            return at.saturating_since(latest.at) > FRESH;
        }
        let fresh = at.saturating_since(latest.at) <= FRESH;
        let turns = self.overlap.filter(|overlap| at.saturating_since(overlap.last) <= FRESH);
        self.heard = [Some(beat), Some(latest)];
        let nodes = (tx_node.min(latest.tx_node), tx_node.max(latest.tx_node));
        let turns = turns.map_or(0, |overlap| overlap.turns) + 1;
        self.overlap = fresh.then_some(Overlap { nodes, last: at, turns });
        turns == 1
    }

    /// Two brokers that beat in turns, again and again. One that takes over from another does so once.
    pub(crate) fn two(&self, now: Instant) -> Option<(TxNode, TxNode)> {
        let overlap = self.overlap?;
        (overlap.turns >= TURNS && now.saturating_since(overlap.last) <= 2 * FRESH).then_some(overlap.nodes)
    }

    /// Brokers that were heard lately.
    pub(crate) fn active(&self, now: Instant) -> impl Iterator<Item = TxNode> {
        let fresh = move |beat: &Heartbeat| now.saturating_since(beat.at) <= FRESH;
        self.heard.into_iter().flatten().filter(fresh).map(|beat| beat.tx_node)
    }

    /// Takes half of a binding; returns the subject, when it is the second half.
    pub(crate) fn supply(&mut self, half: SupplyEtag) -> Option<Subject> {
        let place = self.halves.get_mut(usize::from(half.sender().get()))?;
        match place.and_then(|first| first.joined(&half)) {
            Some(subject) => {
                *place = None;
                Some(subject)
            }
            None => {
                *place = Some(half);
                None
            }
        }
    }

    /// A subject was bound to another etag than before.
    pub(crate) fn contradict(&mut self, subject: Subject, one: Etag, other: Etag, at: Instant) {
        self.contradiction = Some((subject, one, other, at));
    }

    /// A subject that was lately bound to two etags.
    pub(crate) fn contradiction(&self, now: Instant) -> Option<(Subject, Etag, Etag)> {
        let (subject, one, other, at) = self.contradiction?;
        (now.saturating_since(at) <= REMEMBERED).then_some((subject, one, other))
    }
}

/// Four heartbeats: a broker that is silent for longer has gone.
const FRESH: Duration = Duration::from_secs(1);
/// So many changes from one broker to the other are no take-over.
const TURNS: u32 = 4;
/// A contradiction is shown for so long.
const REMEMBERED: Duration = Duration::from_secs(60);

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(ms))
    }

    fn node(number: u8) -> (TxNode, NodeUid) {
        (TxNode::new(number).unwrap(), NodeUid::new(number.into()).unwrap())
    }

    #[test]
    fn a_take_over_is_no_second_broker() {
        let mut brokers = Brokers::new();
        let [(one, one_uid), (other, other_uid)] = [node(1), node(2)];
        assert!(brokers.heartbeat(one, one_uid, at(0)));
        assert!(!brokers.heartbeat(one, one_uid, at(250)));
        assert!(brokers.heartbeat(other, other_uid, at(600)));
        assert!(!brokers.heartbeat(other, other_uid, at(850)));
        assert_eq!(brokers.two(at(900)), None);
        assert_eq!(brokers.active(at(1_400)).collect::<Vec<_>>(), [other]);
    }

    #[test]
    fn two_that_beat_in_turns_are_found() {
        let mut brokers = Brokers::new();
        for beat in 0..4 {
            brokers.heartbeat(node(2).0, node(2).1, at(beat * 250));
            brokers.heartbeat(node(1).0, node(1).1, at(beat * 250 + 10));
        }
        assert_eq!(brokers.two(at(1_000)), Some((node(1).0, node(2).0)));
        assert_eq!(brokers.two(at(9_000)), None, "one of them has gone");
    }
}
