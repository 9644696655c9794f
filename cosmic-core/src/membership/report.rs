//! This node's own status.

use crate::can::{Frame, TxNode};
use crate::protocol::{NodeState, NodeStatus, ResetCause, Uptime};
use crate::time::{Duration, Instant};

/// How this node fares.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Health {
    /// What it does.
    pub state: NodeState,
    /// The controller's transmit error counter (TEC).
    pub transmit_errors: u8,
    /// The controller's receive error counter (REC).
    pub receive_errors: u8,
    /// Exceptions raised and events dropped since the start; wraps.
    pub exceptions: u16,
}

/// Sends this node's status once a period, and at once when its state changes. Every call takes constant
/// time.
#[derive(Clone, Debug)]
pub struct StatusReport {
    started_at: Instant,
    period: Duration,
    send_at: Instant,
    sequence: u8,
    told: Option<NodeState>,
    reset_cause: ResetCause,
}

impl StatusReport {
    /// A node that started at `now`; its first status is due at once.
    pub const fn new(now: Instant, period: Duration) -> Self {
        Self {
            started_at: now,
            period,
            send_at: now,
            sequence: 0,
            told: None,
            reset_cause: ResetCause::Unknown,
        }
    }

    /// Why the node has started, which each status from now on tells.
    pub const fn set_reset_cause(&mut self, cause: ResetCause) {
        self.reset_cause = cause;
    }

    /// The status, when it is due; non real-time.
    pub fn poll(&mut self, now: Instant, tx_node: TxNode, health: &Health) -> Option<Frame> {
        if now < self.send_at && self.told == Some(health.state) {
            return None;
        }
        let status = NodeStatus {
            tx_node,
            state: health.state,
            reset_cause: self.reset_cause,
            transmit_errors: health.transmit_errors,
            receive_errors: health.receive_errors,
            sequence: self.sequence,
            exceptions: health.exceptions,
            uptime: Uptime::new(now.saturating_since(self.started_at)),
        };
        self.sequence = NodeStatus::sequence_after(self.sequence);
        self.told = Some(health.state);
        self.send_at = now + self.period;
        Some(status.encode())
    }

    /// When `poll` must be called, unless the state changes earlier.
    pub const fn next_wakeup(&self) -> Instant {
        self.send_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn once_a_period_and_when_the_state_changes() {
        let at = |milliseconds| Instant::from_epoch(Duration::from_millis(milliseconds));
        let mut report = StatusReport::new(at(500), Duration::from_secs(1));
        let mut health =
            Health { state: NodeState::Starting, transmit_errors: 1, receive_errors: 2, exceptions: 3 };
        let mut sent = |now, health: &Health| {
            let frame = report.poll(at(now), TxNode::MIN, health)?;
            NodeStatus::decode(&frame).map(|status| (status.sequence, status.uptime.duration().as_secs()))
        };
        assert_eq!(sent(500, &health), Some((0, 0)));
        assert_eq!(sent(1499, &health), None);
        assert_eq!(sent(1500, &health), Some((1, 1)));
        health.state = NodeState::Operational;
        assert_eq!(sent(1600, &health), Some((2, 1)));
        for second in 3..=300 {
            sent(1600 + 1000 * second, &health).unwrap();
        }
        assert_eq!(sent(400_000, &health).map(|(sequence, _)| sequence), Some(46), "255 is followed by 1");
    }
}
