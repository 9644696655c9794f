//! Sets of nodes.

use super::TxNode;

/// A set of TxNodes.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct TxNodes([u32; 4]);

impl TxNodes {
    /// Nobody.
    pub const NONE: Self = Self([0; 4]);

    /// These.
    #[allow(
        clippy::indexing_slicing,
        reason = "a TxNode has seven bits, and the list ends where its length says"
    )]
    #[expect(clippy::arithmetic_side_effects, reason = "at most the length of a list")]
    pub const fn of(tx_nodes: &[TxNode]) -> Self {
        let mut set = Self::NONE;
        let mut at = 0;
        while at < tx_nodes.len() {
            let tx_node = tx_nodes[at].get() as usize;
            set.0[(tx_node >> 5) & 3] |= 1 << (tx_node & 31);
            at += 1;
        }
        set
    }

    /// Returns whether this one is among them.
    #[inline]
    pub fn contains(&self, tx_node: TxNode) -> bool {
        let word = self.0.get(usize::from(tx_node.get() >> 5));
        word.is_some_and(|word| word >> (tx_node.get() & 31) & 1 == 1)
    }
}

impl core::fmt::Debug for TxNodes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let all = (0..=TxNode::BROKER.get()).filter_map(TxNode::new);
        f.debug_set().entries(all.filter(|tx_node| self.contains(*tx_node))).finish()
    }
}
