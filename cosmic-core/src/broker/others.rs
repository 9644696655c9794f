//! Other brokers, and nodes whose bindings are those of another broker.

use super::{Broker, BrokerEvent, BrokerRole, State, count};
use crate::can::{Etag, TxNode};
use crate::protocol::{Answer, BrokerStatus, ConfigurationReply, Supply};
use crate::time::Instant;
use crate::uid::Subject;

impl<const NODES: usize, const SUBJECTS: usize> Broker<NODES, SUBJECTS> {
    pub(super) fn on_supply(&mut self, now: Instant, supply: Supply) {
        if supply.sender == TxNode::BROKER {
            self.on_other_broker(now);
            let Answer::Bound(etag) = supply.answer else { return };
            if self.role() != BrokerRole::Active && supply.subject != Subject::RESERVED {
                self.subjects.mirror(supply.subject, etag);
            }
            if self.is_beside_the_old_broker() {
                self.subjects.occupy_down_to(etag, self.presumed_until(now));
            }
            return;
        }
        let Answer::Bound(etag) = supply.answer else { return };
        if supply.subject == Subject::RESERVED {
            return;
        }
        if self.subjects.subject_of(etag) == Some(supply.subject) {
            self.subjects.occupy(etag, now + self.timing.unnamed);
        }
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
            self.supply(now, supply.requester, supply.subject);
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

    pub(super) fn on_configuration_reply(&mut self, now: Instant, reply: ConfigurationReply) {
        self.on_other_broker(now);
        let ConfigurationReply::Assigned { uid, tx_node } = reply else { return };
        if self.role() != BrokerRole::Active && !self.is_host(uid, tx_node) {
            self.nodes.mirror(uid, tx_node);
        }
        if self.is_beside_the_old_broker() {
            self.nodes.occupy_down_to(tx_node, self.presumed_until(now));
        }
    }

    /// A frame that only an active broker sends.
    pub(super) fn on_other_broker(&mut self, now: Instant) {
        match self.state {
            State::Off => return,
            State::Listening { .. } => self.stand_by(now, true),
            // Tell it that we are there; the one with the higher UID goes when it hears the other. The old
            // broker hears nothing, so there the user has two brokers, and is told.
            State::Active { .. } => self.hasten_status(now),
            State::Standby { old: true, .. } => {
                self.state = State::Standby { dead_at: Instant::FAR_FUTURE, old: true };
            }
            State::Standby { old: false, .. } => {
                self.state = State::Standby { dead_at: self.dead_at(now), old: false };
                return;
            }
        }
        self.foreign_at = self.foreign_at.or(Some(now + self.timing.silence));
        // The id that it hands out first.
        self.nodes.occupy_down_to(TxNode::MAX, self.presumed_until(now));
    }

    /// How long names are kept back of which another broker's frame says that it has handed them out, though
    /// nobody was seen to use them. An active broker gives them rather than refuse a node: the frame may be
    /// anybody's, and one of them must not stop the service.
    fn presumed_until(&self, now: Instant) -> Instant {
        if self.role() == BrokerRole::Active { now } else { now + self.timing.unnamed }
    }

    /// Returns whether another broker answers of which no status was heard.
    fn is_beside_the_old_broker(&self) -> bool {
        self.foreign_at.is_some()
    }

    pub(super) fn on_broker_status(&mut self, now: Instant, status: BrokerStatus) {
        self.learn(status.uid, status.tx_node);
        self.foreign_at = None;
        if status.uid == self.uid && self.state != State::Off {
            self.tell_of_namesake(now, status.tx_node);
        }
        match self.state {
            State::Off => {}
            // Two of one UID by mistake must not both go: then nobody would answer, again and again.
            State::Active { .. } if (status.uid, status.tx_node) >= (self.uid, self.tx_node) => {
                self.hasten_status(now);
                // When the other has gone, compare our table with what its nodes use.
                self.compare_from(now + self.timing.listen);
            }
            State::Listening { .. } | State::Active { .. } => self.stand_by(now, false),
            State::Standby { .. } => {
                self.state = State::Standby { dead_at: self.dead_at(now), old: false };
            }
        }
    }

    /// Another broker has the UID of this one: once in a while, for it says so with each status.
    fn tell_of_namesake(&mut self, now: Instant, tx_node: TxNode) {
        if now >= self.namesake_at {
            self.namesake_at = now + self.timing.named;
            self.tell(BrokerEvent::Namesake(tx_node));
        }
    }

    /// A node asks, and this broker is not the one to answer. If it is the old broker's turn, which shows
    /// no other sign of life, an answer must come soon.
    pub(super) fn expect_an_answer(&mut self, now: Instant) {
        if let State::Standby { dead_at: Instant::FAR_FUTURE, old: true } = self.state {
            self.state = State::Standby { dead_at: self.dead_at(now), old: true };
        }
    }
}
