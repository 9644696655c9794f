//! The structured 29-bit identifier (COSMIC fig. 3): priority (8), TxNode (7), etag (14).

/// The priority field, bits 28..21 of the identifier. A *lower* number wins arbitration.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Priority(u8);

impl Priority {
    /// Hard real-time: used inside the sender's calendar slot only.
    pub const HARD: Self = Self(0);
    /// The most urgent soft real-time priority.
    pub const SOFT_MOST_URGENT: Self = Self(1);
    /// The least urgent soft real-time priority.
    pub const SOFT_LEAST_URGENT: Self = Self(249);
    /// Configuration and binding; the most important non real-time priority.
    pub const CONFIGURATION: Self = Self(250);
    /// The least important non real-time priority.
    pub const LEAST: Self = Self(255);

    /// Every value of the field is a priority.
    #[inline]
    pub const fn new(value: u8) -> Self {
        Self(value)
    }

    /// The value of the field.
    #[inline]
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// The short id of a node, bits 20..14 of the identifier: 0..=127.
///
/// It makes identifiers unique: two nodes never send the same identifier with different data.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TxNode(u8);

impl TxNode {
    /// The smallest id.
    pub const MIN: Self = Self(0);
    /// The largest id of an ordinary node.
    pub const MAX: Self = Self(0x7E);
    /// The event channel broker.
    pub const BROKER: Self = Self(0x7F);

    /// `None` above 0x7F.
    #[inline]
    pub const fn new(value: u8) -> Option<Self> {
        if value <= Self::BROKER.0 { Some(Self(value)) } else { None }
    }

    /// The value of the field, 0..=127.
    #[inline]
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// The event tag: an event channel's name on this segment, bits 13..0 of the identifier.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Etag(u16);

impl Etag {
    /// Configuration reply: the broker confirms a prefix of a node UID.
    pub const CONFIGURATION_REPLY: Self = Self(0);
    /// Configuration request: a node asks for a TxNode, four bits of its UID at a time.
    pub const CONFIGURATION_REQUEST: Self = Self(1);
    /// Binding request: a node asks for the etag of a subject.
    pub const GET_ETAG: Self = Self(2);
    /// Binding reply.
    pub const SUPPLY_ETAG: Self = Self(4);
    /// The broker has no TxNode left for a node UID.
    pub const CONFIGURATION_REFUSAL: Self = Self(5);
    /// A node gives its TxNode back.
    pub const RELEASE: Self = Self(6);
    /// A node claims or defends its TxNode by its UID.
    pub const NODE_IDENTITY: Self = Self(7);
    /// Asks every node for its identity, its bindings and its interest.
    pub const PROBE: Self = Self(8);
    /// Heartbeat of the active broker.
    pub const BROKER_STATUS: Self = Self(9);
    /// Clock synchronisation.
    pub const SYNC: Self = Self(16);
    /// The master's own send time of the preceding sync frame.
    pub const FOLLOW_UP: Self = Self(17);
    /// Who subscribes or announces what.
    pub const INTEREST: Self = Self(18);
    /// Liveness, error counters, exceptions counted.
    pub const NODE_STATUS: Self = Self(19);
    /// A node asks for a soft real-time channel that the plan does not know.
    pub const ADMISSION_REQUEST: Self = Self(20);
    /// The broker's node answers that.
    pub const ADMISSION_REPLY: Self = Self(21);

    /// The first etag of the hard real-time channels, which the calendar fixes.
    pub const HARD_FIRST: Self = Self(100);
    /// The last etag of the hard real-time channels.
    pub const HARD_LAST: Self = Self(1023);
    /// The first etag that the broker binds at run time.
    pub const BOUND_FIRST: Self = Self(1024);
    /// The last etag that the broker binds at run time; they are handed out from here down.
    pub const BOUND_LAST: Self = Self(0x3FFF);

    /// `None` above 14 bits.
    #[inline]
    pub const fn new(value: u16) -> Option<Self> {
        if value <= Self::BOUND_LAST.0 { Some(Self(value)) } else { None }
    }

    /// The value of the field, 0..=16383.
    #[inline]
    pub const fn get(self) -> u16 {
        self.0
    }

    /// Returns whether this is one of the etags that the protocol keeps for itself (0..=99).
    #[inline]
    pub const fn is_reserved(self) -> bool {
        self.0 < Self::HARD_FIRST.0
    }

    /// Returns whether this is an etag of a hard real-time channel.
    #[inline]
    pub const fn is_hard(self) -> bool {
        self.0 >= Self::HARD_FIRST.0 && self.0 <= Self::HARD_LAST.0
    }
}

/// A structured identifier. Its order is that of arbitration: the smaller one wins.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Id(u32);

impl Id {
    const PRIORITY_SHIFT: u32 = 21;
    const TX_NODE_SHIFT: u32 = 14;

    /// Puts the three fields together.
    #[inline]
    pub const fn new(priority: Priority, tx_node: TxNode, etag: Etag) -> Self {
        Self(
            (priority.0 as u32) << Self::PRIORITY_SHIFT
                | (tx_node.0 as u32) << Self::TX_NODE_SHIFT
                | etag.0 as u32,
        )
    }

    /// The identifier of 29 raw bits; `None` above them.
    #[inline]
    pub const fn from_raw(raw: u32) -> Option<Self> {
        if raw < 1 << 29 { Some(Self(raw)) } else { None }
    }

    /// The identifier of the low 29 bits, as a controller's registers give them.
    #[inline]
    pub const fn masked(raw: u32) -> Self {
        Self(raw & ((1 << 29) - 1))
    }

    /// The 29 bits as they stand on the wire.
    #[inline]
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// The priority field.
    #[inline]
    pub const fn priority(self) -> Priority {
        Priority((self.0 >> Self::PRIORITY_SHIFT) as u8)
    }

    /// This identifier with another priority.
    #[inline]
    pub const fn with_priority(self, priority: Priority) -> Self {
        let rest = self.0 & ((1 << Self::PRIORITY_SHIFT) - 1);
        Self((priority.0 as u32) << Self::PRIORITY_SHIFT | rest)
    }

    /// The sender.
    #[inline]
    pub const fn tx_node(self) -> TxNode {
        TxNode((self.0 >> Self::TX_NODE_SHIFT) as u8 & TxNode::BROKER.0)
    }

    /// The event tag.
    #[inline]
    pub const fn etag(self) -> Etag {
        Etag(self.0 as u16 & Etag::BOUND_LAST.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_stand_where_the_paper_puts_them() {
        let id = Id::new(Priority::new(0xFA), TxNode::BROKER, Etag::SUPPLY_ETAG);
        assert_eq!(id.raw(), 0x1F5F_C004);
        assert_eq!(id.priority(), Priority::CONFIGURATION);
        assert_eq!(id.tx_node(), TxNode::BROKER);
        assert_eq!(id.etag(), Etag::SUPPLY_ETAG);
        assert_eq!(id.with_priority(Priority::HARD).raw(), 0x001F_C004);
    }

    #[test]
    fn values_outside_their_field_are_refused() {
        assert_eq!(TxNode::new(128), None);
        assert_eq!(Etag::new(0x4000), None);
        assert_eq!(Id::from_raw(1 << 29), None);
        assert_eq!(Id::from_raw(0x1FFF_FFFF).map(Id::etag), Some(Etag::BOUND_LAST));
    }
}
