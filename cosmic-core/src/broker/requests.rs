//! What the active broker answers to the nodes.

use super::session::Turn;
use super::{Broker, BrokerEvent, BrokerRole, BrokerTiming, count};
use crate::can::Frame;
use crate::can::TxNode;
use crate::jitter::times;
use crate::protocol::{Answer, ConfigurationRefusal, ConfigurationReply, ConfigurationRequest, SupplyEtag};
use crate::time::Instant;
use crate::uid::{NodeUid, Subject};

impl<const NODES: usize, const SUBJECTS: usize> Broker<NODES, SUBJECTS> {
    pub(super) fn on_configuration_request(&mut self, now: Instant, request: ConfigurationRequest) {
        if self.role() != BrokerRole::Active {
            self.expect_an_answer(now);
            return;
        }
        match self.session.on_request(now, request) {
            Turn::Ignored => {}
            Turn::Reply(frame) => self.reply([frame]),
            Turn::Whole(bits) => {
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
        let Some(tx_node) = self.free_id(uid, now) else {
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

    fn free_id(&mut self, uid: NodeUid, now: Instant) -> Option<TxNode> {
        // The host is not heard by itself.
        self.nodes.occupy(self.tx_node, now);
        let named = self.timing.named;
        if self.old_ids {
            self.nodes.assign_from_below(uid, now, named)
        } else {
            self.nodes.assign(uid, now, named)
        }
    }

    pub(super) fn on_get_etag(&mut self, now: Instant, requester: TxNode, subject: Subject) {
        if self.role() != BrokerRole::Active {
            self.expect_an_answer(now);
            return;
        }
        if subject == Subject::RESERVED {
            // Another broker asks who answers.
            self.hasten_status(now);
        } else {
            self.supply(now, requester, subject);
        }
    }

    pub(super) fn supply(&mut self, now: Instant, requester: TxNode, subject: Subject) {
        if self.replies.room() < 2 || !self.may_supply(now) {
            count(&mut self.counters.replies_dropped);
            return;
        }
        let known = self.subjects.etag_of(subject);
        let answer = match known.or_else(|| self.subjects.bind(subject, now, self.timing.named)) {
            Some(etag) => {
                self.subjects.occupy(etag, now);
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

    /// Returns whether it is time for another answer about an etag: so many at once, and so many a second, whoever asks.
    /// A clock that was set back does not keep the broker silent.
    fn may_supply(&mut self, now: Instant) -> bool {
        let between = self.timing.between_supplies;
        let at_once = times(between, BrokerTiming::SUPPLIES_AT_ONCE.into());
        let ahead = self.supply_at.saturating_since(now).min(at_once);
        let next = now + ahead + between;
        let due = next <= now + at_once;
        self.supply_at = if due { next } else { now + ahead };
        due
    }
}
