//! What the configuration client is told at its start, and what it tells.

use crate::can::TxNode;
use crate::time::Duration;
use crate::uid::NodeUid;

/// The spans of the configuration client.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigurationTiming {
    /// How long an answer of the broker may take; longer after each failure, up to sixteen times.
    pub reply: Duration,
    /// The pause after the first failure; doubled by each further one.
    pub back_off: Duration,
    /// The longest pause, also after a refusal.
    pub longest_back_off: Duration,
    /// How long another node's search may be silent until we no longer wait for its end.
    pub search: Duration,
    /// How long a node listens whether its new id is in use.
    pub claim: Duration,
    /// Conflicts within this span count together.
    pub conflict: Duration,
}

impl ConfigurationTiming {
    /// For a segment of 125 kbit/s and faster.
    pub const DEFAULT: Self = Self {
        reply: Duration::from_millis(20),
        back_off: Duration::from_millis(50),
        longest_back_off: Duration::from_secs(2),
        search: Duration::from_millis(400),
        claim: Duration::from_millis(60),
        conflict: Duration::from_secs(1),
    };
}

/// What a node with a fixed TxNode does when another node uses it, too. It tells its application, whatever it
/// does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum OnDuplicate {
    /// It gives way to a node with a lower UID, so one of the two goes on working. Any node that states a low
    /// UID often enough silences it.
    Yield,
    /// Once it works it stays, whatever others say. While it claims its id it still gives way to a node that
    /// works with it already, as to one that was flashed with the same image; then it tries again.
    Hold,
    /// It stays, even if another node works with its id already. If that node is no mere nuisance, the two
    /// destroy each other's frames.
    Stay,
}

/// What the node is told.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ConfigurationEvent {
    /// The node may send with this id.
    Configured(TxNode),
    /// The node must no longer send with this id: another node uses it. It asks for a new one by itself,
    /// or claims the same again if its id is fixed.
    Lost(TxNode),
    /// Another node uses our id; at most one event in [`ConfigurationTiming::conflict`].
    Conflict {
        /// The id.
        tx_node: TxNode,
        /// The other's UID, if it told. Ours, if two nodes have one UID.
        other: Option<NodeUid>,
    },
    /// The broker has no id left. The node asks again after the longest pause.
    Refused,
}
