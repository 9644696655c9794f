//! What the monitor learns from control frames.

use cosmic_core::NodeUid;
use cosmic_core::can::{Frame, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::protocol::{
    Answer, ConfigurationReply, ControlMessage, Interest, NodeState, NodeStatus, ResetCause, SupplyEtag,
    SyncMessage,
};
use cosmic_core::time::{Duration, Instant};

use crate::clock::ClockNews;
use crate::decode;
use crate::feed::{News, NoticeKind};
use crate::monitor::Monitor;

impl Monitor {
    pub(crate) fn on_control(&mut self, frame: &Frame, at: Instant) {
        if let Some(sync) = SyncMessage::decode(frame) {
            self.suspects.calendar(frame.id.tx_node(), sync.calendar_digest, at);
        }
        if let Some(news) = self.clock.on_frame(frame, at) {
            self.on_clock(news, at);
        }
        match ControlMessage::decode(frame) {
            Some(ControlMessage::NodeStatus(status)) => self.on_status(&status, at),
            Some(ControlMessage::Interest(interest)) => self.on_interest(&interest, at),
            Some(ControlMessage::SupplyEtag(half)) => self.on_supply(half, at),
            Some(ControlMessage::NodeIdentity(identity)) => self.on_claim(identity.tx_node, identity.uid, at),
            Some(ControlMessage::BrokerStatus(status)) => self.on_heartbeat(status.tx_node, status.uid, at),
            Some(ControlMessage::ConfigurationReply(ConfigurationReply::Assigned { uid, tx_node })) => {
                if let Some(node) = self.nodes.get_mut(tx_node) {
                    node.assign(uid, at);
                }
            }
            Some(ControlMessage::ConfigurationRefusal(refusal)) => {
                let text = format!("the broker has no TxNode left for the node with UID {}", refusal.uid);
                let news = News::new(NoticeKind::Refused, text);
                self.feed.add(news.because([ExceptionKind::ConfigurationRefused]), at);
            }
            Some(ControlMessage::Probe(_)) => self.probed_at = Some(at),
            Some(ControlMessage::Release(release)) => self.leave(release.tx_node, at),
            _ => {}
        }
    }

    fn on_clock(&mut self, news: ClockNews, at: Instant) {
        self.slots.forget_occurrences();
        let news = match news {
            ClockNews::Master { from, before: None } => {
                News::new(NoticeKind::Master, "the node is time master").of(from)
            }
            ClockNews::Master { from, before: Some(before) } => {
                let text = format!("the node is time master, after node {before}");
                News::new(NoticeKind::Master, text).of(from)
            }
            ClockNews::Step { from, by } => {
                let text = format!("global time jumped by {:.6} s", by as f64 / 1e9);
                self.suspects.clock_step(from, by, at);
                News::new(NoticeKind::ClockStep, text).of(from).because([ExceptionKind::ClockOutOfBound])
            }
        };
        self.feed.add(news, at);
    }

    fn on_status(&mut self, status: &NodeStatus, at: Instant) {
        let tx_node = status.tx_node;
        if status.state == NodeState::HardInhibited {
            let mismatch = self.suspects.two_calendars(self.plan.as_ref(), at).is_some();
            self.explain(
                tx_node,
                if mismatch { ExceptionKind::CalendarMismatch } else { ExceptionKind::ClockOutOfBound },
            );
        }
        // What the node has counted by now may be slots that passed since they were looked at last.
        self.pass_slots(at);
        let Some(node) = self.nodes.get_mut(tx_node) else { return };
        let told = node.on_status(status, at);
        let evidence = node.evidence.take();
        if told.left {
            self.leave(tx_node, at);
            return;
        }
        if told.restarted {
            let text = match status.reset_cause {
                ResetCause::Unknown => "the node has started again".to_owned(),
                cause => format!("the node has started again: {}", cause.name()),
            };
            self.feed.add(News::new(NoticeKind::NodeRestarted, text).of(tx_node), at);
        }
        if let Some(before) = told.state_before {
            let text =
                format!("the node is {}, after {}", decode::state(status.state), decode::state(before));
            self.feed.add(News::new(NoticeKind::NodeState, text).of(tx_node), at);
        }
        if told.exceptions > 0 {
            let text = match evidence.is_empty() {
                true => "the node counted exceptions; nothing on the bus says which",
                false => "the node counted exceptions; what was seen on the bus meanwhile may be why",
            };
            let news = News::new(NoticeKind::Exceptions, text).of(tx_node).times(told.exceptions.into());
            self.feed.add(news.because(evidence), at);
        }
    }

    fn leave(&mut self, tx_node: TxNode, at: Instant) {
        if let Some(node) = self.nodes.get_mut(tx_node) {
            node.release();
        }
        self.channels.forget_node(tx_node);
        self.feed.add(News::new(NoticeKind::NodeLeft, "the node has left").of(tx_node), at);
    }

    fn on_interest(&mut self, interest: &Interest, at: Instant) {
        let others = self.channels.on_interest(interest, at);
        if others.is_empty() {
            return;
        }
        others
            .iter()
            .chain([&interest.tx_node])
            .for_each(|node| self.explain(*node, ExceptionKind::LayoutMismatch));
        let names: Vec<String> = others.iter().map(ToString::to_string).collect();
        let text = format!(
            "the node lays out the content of this channel differently from node {}",
            names.join(", ")
        );
        let news = News::new(NoticeKind::LayoutMismatch, text).of(interest.tx_node).on(interest.etag);
        self.feed.add(news.because([ExceptionKind::LayoutMismatch]), at);
    }

    fn on_supply(&mut self, half: SupplyEtag, at: Instant) {
        let Some(subject) = self.brokers.supply(half) else { return };
        match half.answer() {
            Answer::Bound(etag) => {
                if let Some(before) = self.channels.bind(subject, etag, at) {
                    self.brokers.contradict(subject, before, etag, at);
                }
            }
            Answer::Refused => {
                self.explain(half.requester(), ExceptionKind::BindingRefused);
                let news =
                    News::new(NoticeKind::Refused, format!("the broker has no etag for subject {subject}"));
                self.feed.add(news.of(half.requester()).because([ExceptionKind::BindingRefused]), at);
            }
        }
    }

    fn on_claim(&mut self, tx_node: TxNode, uid: NodeUid, at: Instant) {
        let Some(node) = self.nodes.get_mut(tx_node) else { return };
        match self.probed_at {
            Some(probed) if at.saturating_since(probed) <= PROBE => node.claim(uid, at),
            _ => node.insist(uid, at),
        }
        if node.duplicate(at).is_some() {
            self.explain(tx_node, ExceptionKind::DuplicateTxNode);
            let news = News::new(NoticeKind::Duplicate, "two nodes use this TxNode").of(tx_node);
            self.feed.add(news.because([ExceptionKind::DuplicateTxNode]), at);
        }
    }

    fn on_heartbeat(&mut self, tx_node: TxNode, uid: NodeUid, at: Instant) {
        if let Some(node) = self.nodes.get_mut(tx_node)
            && node.uid().is_none()
        {
            node.claim(uid, at);
        }
        if self.brokers.heartbeat(tx_node, uid, at) {
            self.feed.add(News::new(NoticeKind::Broker, "the node is the active broker").of(tx_node), at);
        }
    }
}

/// Who is asked who it is answers within this span.
const PROBE: Duration = Duration::from_secs(1);
