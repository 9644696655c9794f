//! A record of everything that happens on the bus.
//!
//! While recording is on ([`Bus::record_trace`](crate::Bus::record_trace)), the bus keeps a list of
//! [`TraceEvent`]s, in the order of time, which the caller takes
//! ([`Bus::take_trace`](crate::Bus::take_trace)) and writes wherever it likes, for example as a log that
//! `can-utils` read ([`Candump`]).

mod candump;

pub use candump::Candump;

use crate::bits::Field;
use crate::confinement::ErrorState;
use crate::event::{ErrorCause, StationId};
use crate::fault::Transmitter;
use crate::frame::WireFrame;
use crate::time::VirtualInstant;

/// Something that happened.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TraceEvent {
    /// When.
    pub at: VirtualInstant,
    /// What.
    pub kind: TraceKind,
}

/// What happened.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum TraceKind {
    /// A frame was loaded into a mailbox.
    Load {
        /// Whose.
        station: StationId,
        /// Its number.
        mailbox: usize,
        /// The frame.
        frame: WireFrame,
    },
    /// A frame was to be withdrawn from a mailbox.
    Withdraw {
        /// Whose.
        station: StationId,
        /// Its number.
        mailbox: usize,
        /// The frame is on the wire, and is withdrawn only if it fails.
        on_the_wire: bool,
    },
    /// A frame won the bus. `at` is its start of frame.
    FrameStart {
        /// Counts all attempts on this bus, from 0.
        number: u64,
        /// Who sends; the first one, if several send the same frame.
        station: StationId,
        /// From which mailbox.
        mailbox: usize,
        /// The frame.
        frame: WireFrame,
        /// 1 for the first transmission, more for retransmissions.
        attempt: u32,
        /// Stations that started to send at this instant, the winner included.
        contenders: u32,
    },
    /// A frame is complete and was acknowledged. `at` is the end of its end of frame.
    FrameEnd {
        /// As in `FrameStart`.
        number: u64,
        /// As in `FrameStart`.
        station: StationId,
        /// The frame.
        frame: WireFrame,
        /// Its length from start of frame to end of frame.
        bits: u32,
    },
    /// A frame failed. `at` is the end of the bit in which the first station saw the error.
    Error(BusError),
    /// Some receivers rejected a frame in its last but one bit, others accepted it.
    Omission {
        /// As in `FrameStart`.
        number: u64,
        /// Who rejected it.
        victims: Vec<StationId>,
        /// What the transmitter made of it.
        transmitter: Transmitter,
    },
    /// The error level of a station changed.
    ErrorState {
        /// Whose.
        station: StationId,
        /// Its counters now.
        state: ErrorState,
    },
    /// A station was connected to the bus or disconnected from it.
    Connection {
        /// Which.
        station: StationId,
        /// Whether it is connected now.
        connected: bool,
    },
    /// A station's controller was reset.
    Reset {
        /// Which.
        station: StationId,
    },
}

/// An error on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BusError {
    /// The frame, as in [`TraceKind::FrameStart`].
    pub number: u64,
    /// Who sent it.
    pub station: StationId,
    /// The bit in which the first station saw the error; start of frame is 0.
    pub bit: u32,
    /// The field of that bit.
    pub field: Field,
    /// How it was recognised.
    pub cause: ErrorCause,
    /// Why it happened.
    pub origin: Origin,
}

/// Why an error happened.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Origin {
    /// The fault model inverted a bit.
    Fault,
    /// Stations sent the same identifier with different contents.
    Collision,
    /// No other station takes part in the traffic.
    NoReceiver,
    /// The sender was disconnected while it sent.
    SenderLost,
}
