//! Which frames may concern a node: for the interrupt that receives them, which cannot look into the event half.

use crate::can::{Etag, Id, TxNode};

/// What the event half makes more of than a count of foreign frames, and perhaps some more: etags share bits.
///
/// ```
/// use cosmic_core::can::{Etag, Id, Priority, TxNode};
/// use cosmic_core::event_half::Interest;
///
/// let id = |etag| Id::new(Priority::LEAST, TxNode::MIN, Etag::new(etag).unwrap());
/// let interest = Interest::of(None, [5000].map(|etag| Etag::new(etag).unwrap()));
/// assert!(interest.covers(id(5000)) && interest.covers(id(Etag::SYNC.get())));
/// assert!(!interest.covers(id(5001)));
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Interest {
    /// One bit for each value of the low bits of an etag: of others' frames as many pass as the node has etags, in 128.
    pub etags: [u32; Self::WORDS],
    /// All frames with this TxNode, or [`Self::NO_TX_NODE`].
    pub tx_node: u8,
}

impl Interest {
    /// Words of 32 bits.
    pub const WORDS: usize = 4;
    /// No TxNode.
    pub const NO_TX_NODE: u8 = u8::MAX;
    /// Every frame.
    pub const ALL: Self = Self { etags: [u32::MAX; Self::WORDS], tx_node: Self::NO_TX_NODE };

    /// The frames with this TxNode, with these etags, and of the protocol.
    pub fn of(tx_node: Option<TxNode>, etags: impl IntoIterator<Item = Etag>) -> Self {
        let mut words = [0; Self::WORDS];
        for etag in etags {
            let (word, bit) = Self::place(etag);
            if let Some(word) = words.get_mut(word) {
                *word |= bit;
            }
        }
        Self { etags: words, tx_node: tx_node.map_or(Self::NO_TX_NODE, TxNode::get) }
    }

    /// Returns whether a frame of this identifier may concern the node.
    pub fn covers(&self, id: Id) -> bool {
        Self::is_covered(id, self.tx_node, |word| self.etags.get(word).copied().unwrap_or_default())
    }

    /// As [`covers`](Self::covers) where its parts are kept elsewhere: `etags` gives one of the words.
    #[inline]
    pub fn is_covered(id: Id, tx_node: u8, etags: impl FnOnce(usize) -> u32) -> bool {
        let (word, bit) = Self::place(id.etag());
        etags(word) & bit != 0 || id.tx_node().get() == tx_node || id.etag().is_reserved()
    }

    /// The word of an etag, which is less than [`Self::WORDS`], and its bit there.
    #[inline]
    const fn place(etag: Etag) -> (usize, u32) {
        let low = etag.get() as u32;
        ((low >> 5) as usize & (Self::WORDS - 1), 1 << (low & 31))
    }
}
