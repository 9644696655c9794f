//! What the bus reports to its stations.

use crate::confinement::ErrorState;
use crate::frame::WireFrame;
use crate::time::VirtualInstant;

/// A station on the bus, in the order of attachment.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct StationId(pub(crate) u32);

impl StationId {
    /// The number of stations attached before this one: an index into the caller's own table.
    #[inline]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Something that a station's controller learns.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Event {
    /// When.
    pub at: VirtualInstant,
    /// Whose controller.
    pub station: StationId,
    /// What.
    pub kind: EventKind,
}

/// What a station's controller learns.
///
/// Each loaded frame ends in exactly one `Sent` or `Withdrawn`, unless its station is reset.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EventKind {
    /// A frame was received and passed the filters. Reported at the end of the last but one bit of the
    /// end of frame, where receivers accept.
    Received(WireFrame),
    /// The frame in this mailbox was sent and acknowledged; the mailbox is empty. Reported at the end of
    /// the end of frame, one bit after the receivers had it.
    Sent {
        /// The number of the mailbox.
        mailbox: usize,
    },
    /// The frame in this mailbox was withdrawn, or failed after its withdrawal was requested; the mailbox
    /// is empty.
    Withdrawn {
        /// The number of the mailbox.
        mailbox: usize,
    },
    /// An attempt to send the frame in this mailbox failed. The controller tries again by itself, unless
    /// a `Withdrawn` follows at the same instant. Reported at the end of the error frame.
    Failed {
        /// The number of the mailbox.
        mailbox: usize,
        /// What the controller saw.
        cause: ErrorCause,
    },
    /// The station's error level changed: see [`ErrorState::level`].
    ErrorState(ErrorState),
}

/// How a station recognises an error (ISO 11898-1, error detection).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum ErrorCause {
    /// The bus is not at the level that the station sends.
    Bit,
    /// Six equal bits in a row.
    Stuff,
    /// A dominant bit where the format has a recessive one.
    Form,
    /// The CRC sequence does not fit the bits before it.
    Crc,
    /// Nobody acknowledged.
    Acknowledgement,
}
