//! Whether a node may publish on a channel: what its services say.

/// Whether this node may publish on a channel that it has announced.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Gate {
    /// It may.
    Open,
    /// It may not, because the channel is not [admitted](crate::admission).
    Closed,
    /// It may, but its events are sent as non real-time ones of the least importance.
    NonRealTime,
}
