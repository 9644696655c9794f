//! The nodes that are alive.

use crate::can::{Frame, TxNode};
use crate::protocol::{NodeState, NodeStatus};
use crate::time::{Duration, Instant};

/// A node has come or gone.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MemberEvent {
    /// A status of a node that was not known, or had left.
    Joined(TxNode),
    /// It said that it leaves.
    Left(TxNode),
    /// It was silent for too long.
    Silent(TxNode),
    /// It has started again, so fast that its silence was not noticed.
    Restarted(TxNode),
}

#[derive(Clone, Copy, Debug)]
struct Member {
    status: NodeStatus,
    heard_at: Instant,
}

/// Up to `N` other nodes; the contract is that of [`crate::membership`].
///
/// Every call takes O(`N`), but `poll` and `next_wakeup` O(1) while nobody is silent.
#[derive(Clone, Debug)]
pub struct Members<const N: usize> {
    members: [Option<Member>; N],
    silence: Duration,
    overflows: u16,
    /// Nobody is silent for too long before this.
    first_silence: Instant,
}

impl<const N: usize> Members<N> {
    /// Nobody is known. A node that sends no status for `silence` is taken for dead; that should be several
    /// periods of [`StatusReport`](super::StatusReport).
    pub const fn new(silence: Duration) -> Self {
        Self { members: [None; N], silence, overflows: 0, first_silence: Instant::FAR_FUTURE }
    }

    /// The last status of each node that is alive.
    pub fn iter(&self) -> impl Iterator<Item = &NodeStatus> {
        self.members.iter().flatten().map(|member| &member.status)
    }

    /// The last status of a node, if it is alive.
    pub fn status_of(&self, tx_node: TxNode) -> Option<&NodeStatus> {
        self.iter().find(|status| status.tx_node == tx_node)
    }

    /// Status frames of nodes for which there was no room.
    pub const fn overflows(&self) -> u16 {
        self.overflows
    }

    /// Takes a received frame.
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) -> Option<MemberEvent> {
        let status = NodeStatus::decode(frame)?;
        let tx_node = status.tx_node;
        let of_node = |place: &Option<Member>| place.is_some_and(|member| member.status.tx_node == tx_node);
        let known = self.members.iter().position(of_node);
        if status.state == NodeState::Leaving {
            return self.remove(known?).map(MemberEvent::Left);
        }
        let Some(at) = known.or_else(|| self.members.iter().position(Option::is_none)) else {
            self.overflows = self.overflows.saturating_add(1);
            return None;
        };
        let before = self.members.get_mut(at)?.replace(Member { status, heard_at: now });
        self.first_silence = self.first_silence.min(now + self.silence);
        match before {
            None => Some(MemberEvent::Joined(tx_node)),
            Some(before) => before.has_restarted(now, &status).then_some(MemberEvent::Restarted(tx_node)),
        }
    }

    /// A node that fell silent; call until it returns `None`.
    pub fn poll(&mut self, now: Instant) -> Option<MemberEvent> {
        if now < self.first_silence {
            return None;
        }
        let silence = self.silence;
        let silent = |place: &Option<Member>| place.is_some_and(|member| now >= member.heard_at + silence);
        let Some(at) = self.members.iter().position(silent) else {
            let silences = self.members.iter().flatten().map(|member| member.heard_at + silence);
            self.first_silence = silences.min().unwrap_or(Instant::FAR_FUTURE);
            return None;
        };
        self.remove(at).map(MemberEvent::Silent)
    }

    /// When `poll` must be called even if no frame arrives. A node that was heard since may have it called
    /// for nothing, once.
    pub const fn next_wakeup(&self) -> Instant {
        self.first_silence
    }

    fn remove(&mut self, at: usize) -> Option<TxNode> {
        Some(self.members.get_mut(at)?.take()?.status.tx_node)
    }
}

impl Member {
    /// A node's first status has sequence 0, and its uptime grows; the same frame may come twice.
    fn has_restarted(&self, now: Instant, status: &NodeStatus) -> bool {
        let repeated = self.status == *status && now < self.heard_at + REPETITION;
        (status.sequence == 0 && !repeated) || status.uptime < self.status.uptime
    }
}

/// A frame that CAN sends again comes within this span.
const REPETITION: Duration = Duration::from_millis(20);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Uptime;

    const NODE: TxNode = TxNode::new(5).unwrap();
    const FIRST: NodeStatus = NodeStatus::first(NODE, NodeState::Operational);

    fn at(milliseconds: u64) -> Instant {
        Instant::from_epoch(Duration::from_millis(milliseconds))
    }

    fn later(sequence: u8, seconds: u64) -> Frame {
        NodeStatus { sequence, uptime: Uptime::new(Duration::from_secs(seconds)), ..FIRST }.encode()
    }

    #[test]
    fn a_node_joins_falls_silent_and_joins_again() {
        let mut members = Members::<2>::new(Duration::from_secs(3));
        assert_eq!(members.on_frame(&FIRST.encode(), at(0)), Some(MemberEvent::Joined(NODE)));
        assert_eq!(members.on_frame(&later(1, 1), at(1000)), None);
        assert_eq!(members.next_wakeup(), at(3000), "for nothing");
        assert_eq!(members.poll(at(3000)), None);
        assert_eq!(members.next_wakeup(), at(4000));
        assert_eq!(members.poll(at(3999)), None);
        assert_eq!(members.poll(at(4000)), Some(MemberEvent::Silent(NODE)));
        assert_eq!(members.status_of(NODE), None);
        assert_eq!(members.on_frame(&later(5, 5), at(5000)), Some(MemberEvent::Joined(NODE)));
        let last = NodeStatus { state: NodeState::Leaving, ..FIRST };
        assert_eq!(members.on_frame(&last.encode(), at(6000)), Some(MemberEvent::Left(NODE)));
        assert_eq!(members.on_frame(&last.encode(), at(6001)), None);
    }

    #[test]
    fn a_restart_is_seen_by_its_sequence_or_by_its_uptime() {
        let mut members = Members::<2>::new(Duration::from_secs(3));
        let restarted = Some(MemberEvent::Restarted(NODE));
        let _ = members.on_frame(&FIRST.encode(), at(0));
        assert_eq!(members.on_frame(&FIRST.encode(), at(1)), None, "the same frame again");
        assert_eq!(members.on_frame(&later(1, 1), at(1000)), None);
        assert_eq!(members.on_frame(&FIRST.encode(), at(1500)), restarted);
        assert_eq!(members.on_frame(&later(1, 1), at(2500)), None);
        // The first status of the new life was lost.
        assert_eq!(members.on_frame(&later(1, 0), at(4000)), restarted);
        // It dies again and again before its second status.
        assert_eq!(members.on_frame(&FIRST.encode(), at(5000)), restarted);
        assert_eq!(members.on_frame(&FIRST.encode(), at(5100)), restarted);
    }

    #[test]
    fn what_does_not_fit_is_counted() {
        let mut members = Members::<1>::new(Duration::from_secs(3));
        let _ = members.on_frame(&FIRST.encode(), at(0));
        let other = NodeStatus { tx_node: TxNode::MIN, ..FIRST };
        assert_eq!(members.on_frame(&other.encode(), at(0)), None);
        assert_eq!((members.overflows(), members.iter().count()), (1, 1));
    }
}
