//! What a broker is told at its start, and what it tells.

use crate::admission::Objection;
use crate::can::{Etag, TxNode};
use crate::time::Duration;
use crate::uid::{NodeUid, Subject};

/// The spans of the broker.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BrokerTiming {
    /// How long a broker listens before it becomes active.
    pub listen: Duration,
    /// Between two status frames of the active broker.
    pub status: Duration,
    /// After how long a silent broker is taken for dead. Several times `status`.
    pub silence: Duration,
    /// How much later the broker with the next TxNode takes over.
    pub rank_step: Duration,
    /// How long a search for a UID waits for the next request until it is given up.
    pub search: Duration,
    /// How long an id or an etag of which only the use was seen is not handed out, from the last use on. What a
    /// node states its interest in is kept for its lease.
    pub unnamed: Duration,
    /// After how long a name that was not seen in use may lose its id or etag, if none is left for another one. A node
    /// of ours shows its names all the time.
    pub named: Duration,
    /// Between two answers to other brokers, at least.
    pub between_answers: Duration,
    /// Between two answers about etags, on average; up to [`SUPPLIES_AT_ONCE`](Self::SUPPLIES_AT_ONCE) may follow each
    /// other.
    pub between_supplies: Duration,
}

impl BrokerTiming {
    /// Answers about etags that may follow each other, when none was given for a while.
    pub const SUPPLIES_AT_ONCE: u8 = 32;

    /// For a segment of 125 kbit/s and faster: a standby takes over within 1.3 s.
    pub const DEFAULT: Self = Self {
        listen: Duration::from_millis(300),
        status: Duration::from_millis(250),
        silence: Duration::from_secs(1),
        rank_step: Duration::from_millis(2),
        search: Duration::from_millis(250),
        unnamed: Duration::from_secs(60),
        named: Duration::from_secs(3600),
        between_answers: Duration::from_millis(50),
        between_supplies: Duration::from_millis(4),
    };
}

/// What a broker does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BrokerRole {
    /// Nothing: its node has no TxNode.
    Off,
    /// It gathers what the nodes know.
    Listening,
    /// It answers.
    Active,
    /// Another broker answers; this one mirrors its table.
    Standby,
}

/// What the node that hosts the broker is told.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum BrokerEvent {
    /// The role has changed.
    Became(BrokerRole),
    /// A node has got its id; the table is worth storing.
    Assigned {
        /// The node.
        uid: NodeUid,
        /// Its id.
        tx_node: TxNode,
    },
    /// A subject has got its etag; the table is worth storing.
    Bound {
        /// The subject.
        subject: Subject,
        /// Its etag.
        etag: Etag,
    },
    /// No id is left for this node.
    NoIdLeft(NodeUid),
    /// No etag is left for this subject.
    NoEtagLeft(Subject),
    /// No id is free any more. Told once, until one was free again.
    IdsUsedUp {
        /// Of how many only the use was seen; they are handed out when it ends.
        unnamed: usize,
    },
    /// No etag is free any more. Told once, until one was free again.
    EtagsUsedUp {
        /// Of how many only the use was seen; they are handed out when it ends.
        unnamed: usize,
    },
    /// The broker of the node with this TxNode has the UID of this one. The one with the lower TxNode stays; give each
    /// node a UID of its own. Told once in [`BrokerTiming::named`].
    Namesake(TxNode),
    /// A soft real-time channel that the plan does not know was admitted.
    Admitted {
        /// The node that publishes it.
        tx_node: TxNode,
        /// The channel.
        etag: Etag,
    },
    /// It was not admitted, or not any more.
    NotAdmitted {
        /// The node that asked.
        tx_node: TxNode,
        /// The channel.
        etag: Etag,
        /// Why.
        why: Objection,
    },
    /// Another broker answers, which does not say who it is: an old one. This broker stands by if it heard of
    /// it in time. Two that answer give ids and etags twice; switch one of them off.
    ForeignBroker,
}

/// What a broker could not do; each counter stays at its maximum.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BrokerCounters {
    /// Replies dropped because too many were waiting to be sent, or were given already; the nodes ask again.
    pub replies_dropped: u16,
    /// Events dropped because nobody polled.
    pub events_dropped: u16,
    /// Nodes refused.
    pub no_id_left: u16,
    /// Subjects refused.
    pub no_etag_left: u16,
    /// Searches for a UID given up because no node went on.
    pub searches_given_up: u16,
    /// Bindings of nodes that contradicted the table.
    pub contradictions: u16,
}

impl BrokerCounters {
    /// Nothing has happened.
    pub const ZERO: Self = Self {
        replies_dropped: 0,
        events_dropped: 0,
        no_id_left: 0,
        no_etag_left: 0,
        searches_given_up: 0,
        contradictions: 0,
    };
}
