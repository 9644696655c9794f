//! Node status: a node is alive, and how it fares.

use super::{control_data, control_frame};
use crate::can::{Etag, Frame, TxNode};
use crate::time::Duration;

/// What a node does.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NodeState {
    /// It has started and is not ready: bindings or the clock are missing.
    Starting = 0,
    /// All it offers works.
    Operational = 1,
    /// It works, but its hard real-time channels are inhibited: the clock is out of bound, or its calendar
    /// is not the cluster's.
    HardInhibited = 2,
    /// It leaves, and this is its last word.
    Leaving = 3,
}

/// Why a node has started.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// It does not know, or does not say.
    #[default]
    Unknown = 0,
    /// It was switched on.
    PowerOn = 1,
    /// Its supply voltage was too low for a while.
    BrownOut = 2,
    /// Its reset pin, as by a debug probe or a button.
    Pin = 3,
    /// Its software asked for it.
    Software = 4,
    /// Its watchdog: a part of the node made no progress.
    Watchdog = 5,
    /// It was reset when it went to a mode of low power.
    LowPower = 6,
    /// Its crystal, or the clock from outside, failed while it ran.
    Crystal = 7,
}

impl ResetCause {
    /// All of them, by their numbers.
    pub const ALL: [Self; 8] = [
        Self::Unknown,
        Self::PowerOn,
        Self::BrownOut,
        Self::Pin,
        Self::Software,
        Self::Watchdog,
        Self::LowPower,
        Self::Crystal,
    ];

    /// What it is called.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::PowerOn => "power-on",
            Self::BrownOut => "brown-out",
            Self::Pin => "reset pin",
            Self::Software => "software",
            Self::Watchdog => "watchdog",
            Self::LowPower => "low power",
            Self::Crystal => "crystal",
        }
    }

    /// The cause of this number. One that is not known here, from a newer node, is as good as unknown.
    pub fn numbered(number: u8) -> Self {
        Self::ALL.get(usize::from(number)).copied().unwrap_or_default()
    }
}

/// How long a node has run, in whole seconds; stays at [`Uptime::MAX`] when it gets there.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Uptime(u16);

impl Uptime {
    /// Less than a second.
    pub const ZERO: Self = Self(0);
    /// 18.2 hours or more.
    pub const MAX: Self = Self(u16::MAX);

    /// `span`, rounded down to seconds.
    pub const fn new(span: Duration) -> Self {
        let seconds = span.as_secs();
        Self(if seconds > u16::MAX as u64 { u16::MAX } else { seconds as u16 })
    }

    /// The span; at least this long, if it is [`Uptime::MAX`].
    pub const fn duration(self) -> Duration {
        Duration::from_secs(self.0 as u64)
    }
}

/// `[reset cause (4 bits), state (4 bits), TEC, REC, sequence, exceptions (16 bits), uptime in seconds (16 bits)]`, the
/// sender in the identifier.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NodeStatus {
    /// The node.
    pub tx_node: TxNode,
    /// What it does.
    pub state: NodeState,
    /// Why it has started.
    pub reset_cause: ResetCause,
    /// Its transmit error counter (TEC), at most 255.
    pub transmit_errors: u8,
    /// Its receive error counter (REC), at most 255.
    pub receive_errors: u8,
    /// 0 in the first status after a start, then 1..=255 over and over: a 0 tells of a restart.
    pub sequence: u8,
    /// Exceptions raised and events dropped since the start; wraps.
    pub exceptions: u16,
    /// How long ago it started.
    pub uptime: Uptime,
}

impl NodeStatus {
    /// The first status of a node after its start, with all counters zero.
    pub const fn first(tx_node: TxNode, state: NodeState) -> Self {
        Self {
            tx_node,
            state,
            reset_cause: ResetCause::Unknown,
            transmit_errors: 0,
            receive_errors: 0,
            sequence: 0,
            exceptions: 0,
            uptime: Uptime::ZERO,
        }
    }

    /// The sequence number of the status that follows one with this sequence number.
    pub const fn sequence_after(sequence: u8) -> u8 {
        match sequence.checked_add(1) {
            Some(next) => next,
            None => 1,
        }
    }

    /// The frame of this message.
    pub fn encode(&self) -> Frame {
        let ([a, b], [c, d]) = (self.exceptions.to_be_bytes(), self.uptime.0.to_be_bytes());
        let first = (self.reset_cause as u8) << 4 | self.state as u8;
        let data = [first, self.transmit_errors, self.receive_errors, self.sequence, a, b, c, d];
        control_frame(self.tx_node, Etag::NODE_STATUS, data)
    }

    /// The message in `frame`, if it is one.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let [first, transmit_errors, receive_errors, sequence, a, b, c, d] =
            control_data(frame, Etag::NODE_STATUS)?;
        let state = match first & 0xF {
            0 => NodeState::Starting,
            1 => NodeState::Operational,
            2 => NodeState::HardInhibited,
            3 => NodeState::Leaving,
            _ => return None,
        };
        Some(Self {
            tx_node: frame.id.tx_node(),
            state,
            reset_cause: ResetCause::numbered(first >> 4),
            transmit_errors,
            receive_errors,
            sequence,
            exceptions: u16::from_be_bytes([a, b]),
            uptime: Uptime(u16::from_be_bytes([c, d])),
        })
    }
}
