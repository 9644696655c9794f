//! Binding: from a subject to the etag of its channel.
//!
//! The reply needs ten bytes (etag and subject), so it comes in two frames; each carries one half of the
//! subject, so that a node can tell whether the answer is its own. Whoever hears both halves of a subject
//! it waits for may use the etag, no matter who asked.
//!
//! The same frames, with a node's own TxNode in place of the broker's, are *claims*: a node tells a broker
//! that has lost its table which bindings it uses. Their halves have numbers of their own: an old client
//! looks at the halves 0 and 1 whoever sent them, and a claim between the two halves of its answer would
//! make it wait for ever, or take the claimed etag.

use super::{control_data, control_frame, etag_of, tx_node_of};
use crate::can::{Etag, Frame, TxNode};
use crate::uid::Subject;

/// A node asks for the etag of a subject.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GetEtag {
    /// The node that asks.
    pub requester: TxNode,
    /// The subject.
    pub subject: Subject,
}

impl GetEtag {
    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        control_frame(self.requester, Etag::GET_ETAG, self.subject.to_bytes())
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let subject = Subject::from_bytes(control_data(frame, Etag::GET_ETAG)?)?;
        Some(Self { requester: frame.id.tx_node(), subject })
    }
}

/// Which half of the subject a frame carries.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Half {
    /// Bytes 0..=3.
    First = 0,
    /// Bytes 4..=7.
    Second = 1,
}

/// The etag of a subject, or that there is none.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Answer {
    /// The channel has this etag, one of 1024..=16383.
    Bound(Etag),
    /// No etag is left.
    Refused,
}

impl Answer {
    /// The answer with this etag; an etag that no broker may bind means that none was left (the old
    /// broker sends 0).
    fn of(etag: Etag) -> Self {
        if etag >= Etag::BOUND_FIRST { Self::Bound(etag) } else { Self::Refused }
    }
}

/// One half of a binding: `[requester, half, etag high, etag low, 4 bytes of the subject]`.
///
/// A refusal has 2 or 3 in place of the half and no etag, and a claim has 4 or 5; old clients know the halves
/// 0 and 1 only, and ignore them.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SupplyEtag {
    sender: TxNode,
    requester: TxNode,
    half: Half,
    answer: Answer,
    subject_half: [u8; 4],
}

impl SupplyEtag {
    /// Both halves of an answer, to be sent in this order.
    ///
    /// `sender` is [`TxNode::BROKER`] for a reply, or the node's own TxNode for a claim. An answer with an
    /// etag below 1024 counts as a refusal.
    pub fn pair(sender: TxNode, requester: TxNode, subject: Subject, answer: Answer) -> [Self; 2] {
        let answer = match answer {
            Answer::Bound(etag) => Answer::of(etag),
            Answer::Refused => Answer::Refused,
        };
        let half = |half| Self { sender, requester, half, answer, subject_half: half_of(subject, half) };
        [half(Half::First), half(Half::Second)]
    }

    /// Who sent it: [`TxNode::BROKER`], or the node that claims.
    pub const fn sender(&self) -> TxNode {
        self.sender
    }

    /// Who asked.
    pub const fn requester(&self) -> TxNode {
        self.requester
    }

    /// Returns whether a node claims a binding that it uses; otherwise the broker answers.
    pub fn is_claim(&self) -> bool {
        self.sender != TxNode::BROKER
    }

    /// Which half of the subject it carries.
    pub const fn half(&self) -> Half {
        self.half
    }

    /// The etag, or the refusal.
    pub const fn answer(&self) -> Answer {
        self.answer
    }

    /// Returns whether this is one half of an answer about `subject`.
    pub fn is_about(&self, subject: Subject) -> bool {
        self.subject_half == half_of(subject, self.half)
    }

    /// The subject of two frames, if they are the first and the second half of one answer.
    pub fn joined(&self, second: &Self) -> Option<Subject> {
        let same = self.sender == second.sender
            && self.requester == second.requester
            && self.answer == second.answer
            && self.half == Half::First
            && second.half == Half::Second;
        let ([a, b, c, d], [e, f, g, h]) = (self.subject_half, second.subject_half);
        if same { Subject::from_bytes([a, b, c, d, e, f, g, h]) } else { None }
    }

    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        let (code, [high, low]) = match self.answer {
            Answer::Bound(etag) => (0, etag.get().to_be_bytes()),
            Answer::Refused => (REFUSED, [0, 0]),
        };
        let code = self.half as u8 | if self.is_claim() { CLAIMED } else { code };
        let [a, b, c, d] = self.subject_half;
        control_frame(self.sender, Etag::SUPPLY_ETAG, [self.requester.get(), code, high, low, a, b, c, d])
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let [requester, code, high, low, a, b, c, d] = control_data(frame, Etag::SUPPLY_ETAG)?;
        let sender = frame.id.tx_node();
        let half = if code & 1 == 0 { Half::First } else { Half::Second };
        let refused = match code & !1 {
            0 if sender == TxNode::BROKER => false,
            REFUSED if sender == TxNode::BROKER => true,
            CLAIMED if sender != TxNode::BROKER => false,
            _ => return None,
        };
        let etag = u16::from_be_bytes([high, low]);
        if requester > TxNode::BROKER.get() || etag > Etag::BOUND_LAST.get() {
            return None;
        }
        let answer = if refused { Answer::Refused } else { Answer::of(etag_of(etag)) };
        let requester = tx_node_of(requester);
        Some(Self { sender, requester, half, answer, subject_half: [a, b, c, d] })
    }
}

fn half_of(subject: Subject, half: Half) -> [u8; 4] {
    let half = match half {
        Half::First => subject.get() >> 32,
        Half::Second => subject.get(),
    };
    (half as u32).to_be_bytes()
}

/// Added to the half in a refusal.
const REFUSED: u8 = 2;

/// Added to the half in a claim.
const CLAIMED: u8 = 4;

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: TxNode = TxNode::new(5).unwrap();
    const SUBJECT: Subject = Subject::new(0x0102_0304_0506_0708).unwrap();

    #[test]
    fn halves_join_in_their_order_only() {
        let [first, second] =
            SupplyEtag::pair(TxNode::BROKER, NODE, SUBJECT, Answer::Bound(Etag::BOUND_LAST));
        assert_eq!(first.joined(&second), Some(SUBJECT));
        assert_eq!(second.joined(&first), None);
        let [_, other] = SupplyEtag::pair(TxNode::BROKER, NODE, SUBJECT, Answer::Bound(Etag::BOUND_FIRST));
        assert_eq!(first.joined(&other), None, "the etags differ");
        assert!(first.is_about(SUBJECT) && second.is_about(SUBJECT));
    }

    #[test]
    fn an_etag_that_no_broker_binds_is_a_refusal() {
        for etag in [Etag::CONFIGURATION_REPLY, Etag::HARD_LAST] {
            let [first, _] = SupplyEtag::pair(TxNode::BROKER, NODE, SUBJECT, Answer::Bound(etag));
            assert_eq!(first.answer(), Answer::Refused);
        }
        let old = control_frame(TxNode::BROKER, Etag::SUPPLY_ETAG, [5, 0, 0, 0, 1, 2, 3, 4]);
        assert_eq!(SupplyEtag::decode(&old).map(|old| old.answer()), Some(Answer::Refused));
    }
}
