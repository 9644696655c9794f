//! Which control frames a sealed node believes.

use super::{Contradiction, Seal};
use crate::can::{Etag, Frame, TxNode};
use crate::protocol::{
    Answer, ControlMessage, Interest, NodeState, Side, SupplyEtag, SyncMessage, names_its_sender,
};
use crate::uid::Subject;

/// What a sealed node makes of a control frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    /// It agrees with the plan.
    Believed,
    /// It may be true, but a false one would do harm, and nothing is lost without it: leases and silence tell the same,
    /// a little later.
    Ignored,
    Refused(Contradiction),
}

use Contradiction as C;
use Verdict::{Believed, Ignored, Refused};

impl Seal {
    /// O(nodes + channels).
    pub(super) fn judge(&self, frame: &Frame, own: Option<TxNode>) -> Verdict {
        let sender = frame.id.tx_node();
        if names_its_sender(frame.id) && own == Some(sender) {
            return Refused(C::OwnTxNode);
        }
        match frame.id.etag() {
            Etag::SYNC | Etag::FOLLOW_UP => self.judge_sync(frame),
            _ => match ControlMessage::decode(frame) {
                Some(message) => self.judge_message(sender, &message),
                None => Refused(C::Node),
            },
        }
    }

    fn judge_sync(&self, frame: &Frame) -> Verdict {
        let rank = self.node(frame.id.tx_node()).and_then(|node| node.rank);
        let stated = SyncMessage::decode(frame).map(|message| message.rank);
        unless(rank.is_some() && (stated.is_none() || stated == rank), C::Master)
    }

    fn judge_message(&self, sender: TxNode, message: &ControlMessage) -> Verdict {
        match message {
            // All nodes have their ids.
            ControlMessage::ConfigurationRequest(_) => Refused(C::Node),
            ControlMessage::ConfigurationReply(_) | ControlMessage::ConfigurationRefusal(_) => {
                Refused(C::Broker)
            }
            // A node that gives its id back has it in the plan all the same.
            ControlMessage::Release(release) => {
                if self.is_node(sender, release.uid) {
                    Ignored
                } else {
                    Refused(C::Node)
                }
            }
            ControlMessage::NodeIdentity(identity) => unless(self.is_node(sender, identity.uid), C::Node),
            ControlMessage::Probe(_) => unless(self.is_broker(sender), C::Broker),
            ControlMessage::BrokerStatus(status) => {
                unless(self.is_broker(sender) && self.is_node(sender, status.uid), C::Broker)
            }
            ControlMessage::GetEtag(request) if request.subject == Subject::RESERVED => {
                unless(self.is_broker(sender), C::Broker)
            }
            ControlMessage::GetEtag(request) => {
                let known = self.channels.iter().any(|channel| channel.subject == request.subject);
                self.of_a_node(sender, unless(known, C::Binding))
            }
            ControlMessage::SupplyEtag(half) => self.judge_supply(sender, half),
            ControlMessage::Interest(interest) => self.of_a_node(sender, self.judge_interest(interest)),
            ControlMessage::NodeStatus(status) => {
                let leaves = status.state == NodeState::Leaving;
                self.of_a_node(sender, if leaves { Ignored } else { Believed })
            }
            // What is not in the plan is not admitted here.
            ControlMessage::AdmissionRequest(_) => self.of_a_node(sender, Refused(C::Publisher)),
            ControlMessage::AdmissionReply(_) => Refused(C::Broker),
        }
    }

    fn judge_supply(&self, sender: TxNode, half: &SupplyEtag) -> Verdict {
        if !half.is_claim() && self.brokers.is_empty() {
            return Refused(C::Broker);
        }
        let agrees = match half.answer() {
            Answer::Bound(etag) => self.channel(etag).is_some_and(|channel| half.is_about(channel.subject)),
            Answer::Refused => false,
        };
        let verdict = unless(agrees, C::Binding);
        if half.is_claim() { self.of_a_node(sender, verdict) } else { verdict }
    }

    fn judge_interest(&self, interest: &Interest) -> Verdict {
        let Some(channel) = self.channel(interest.etag).filter(|channel| channel.class == interest.class)
        else {
            return Refused(C::Binding);
        };
        if interest.side == Side::Publisher && !channel.publishers.contains(interest.tx_node) {
            Refused(C::Publisher)
        } else if interest.lease.is_withdrawn() {
            Ignored
        } else {
            Believed
        }
    }

    fn of_a_node(&self, sender: TxNode, verdict: Verdict) -> Verdict {
        if self.node(sender).is_some() { verdict } else { Refused(C::Node) }
    }

    fn is_node(&self, tx_node: TxNode, uid: crate::NodeUid) -> bool {
        self.node(tx_node).is_some_and(|node| node.uid == uid)
    }

    fn is_broker(&self, tx_node: TxNode) -> bool {
        self.node(tx_node).is_some_and(|node| self.may_be_broker(node.uid))
    }
}

fn unless(agrees: bool, contradiction: C) -> Verdict {
    if agrees { Believed } else { Refused(contradiction) }
}
