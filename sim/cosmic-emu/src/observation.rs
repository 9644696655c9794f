//! What is seen of a cluster from outside: measuring points, logs, records, and what goes wrong.

use cosmic_bus::VirtualInstant;

use crate::cpu::{AccessKind, CpuFault};
use crate::log::LogLine;

/// A node of a cluster, in the order in which they were added.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct NodeId(pub(crate) usize);

impl NodeId {
    /// The number of nodes that were added before this one.
    pub const fn index(self) -> usize {
        self.0
    }
}

/// Something that was seen.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Observation {
    /// When: true time, exact to the instruction, except for logs and records, which are seen when they
    /// are read out of the node's memory. Their order within a channel is that of writing.
    pub at: VirtualInstant,
    /// In which node.
    pub node: NodeId,
    /// What.
    pub kind: ObservationKind,
}

/// A pin of a port.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Pin {
    /// `A` to `I`.
    pub port: char,
    /// 0 to 15.
    pub number: u8,
}

impl core::fmt::Display for Pin {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "P{}{}", self.port, self.number)
    }
}

/// An address in the program.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Place {
    /// The address.
    pub pc: u32,
    /// The function that it lies in, and how far behind its start; `None` if the image has no symbol there.
    pub symbol: Option<String>,
}

impl core::fmt::Display for Place {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:#010x}", self.pc)?;
        self.symbol.iter().try_for_each(|symbol| write!(f, " ({symbol})"))
    }
}

/// For how long a place in the program held back interrupts.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Masked {
    /// The instruction that masked them.
    pub place: Place,
    /// The exception that it ran in; 0 is the thread.
    pub exception: u16,
    /// The longest time, in cycles of the core.
    pub cycles: u64,
}

/// What was seen.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum ObservationKind {
    /// The level of an output pin changed.
    Pin {
        /// Which pin.
        pin: Pin,
        /// Whether it is high.
        level: bool,
        /// Instructions that the node had executed, the writing one included.
        instructions: u64,
    },
    /// A line of the defmt log (RTT up-channel `defmt`).
    Log(LogLine),
    /// Bytes of another RTT up-channel, as the firmware wrote them. A record may be split.
    Record {
        /// The name of the channel.
        channel: String,
        /// What was written.
        bytes: Vec<u8>,
    },
    /// A watched instruction is about to execute.
    Reached {
        /// Where.
        place: Place,
        /// Instructions that the node had executed before.
        instructions: u64,
    },
    /// A handler of a watched node began or ended to run; in between others may have pre-empted it.
    Handler {
        /// The number of its exception.
        exception: u16,
        /// Its priority, as NVIC has it: the smaller, the more urgent.
        priority: u8,
        /// Whether it began.
        begins: bool,
    },
    /// The firmware accessed a register that is not modelled, or a setting that is not, or wrote to an acceptance filter that
    /// was in use. The access read 0, or had no effect. Reported once for each place in the program.
    NotModelled {
        /// Read or write.
        access: AccessKind,
        /// The register.
        address: u32,
        /// The instruction.
        place: Place,
    },
    /// The firmware accessed a peripheral whose clock is off in RCC. The access read 0, or had no effect.
    NotClocked {
        /// Read or write.
        access: AccessKind,
        /// The register.
        address: u32,
        /// The instruction.
        place: Place,
    },
    /// The firmware joined the bus with another bit rate than that of the bus. The node stays off the bus.
    WrongBitRate {
        /// What the firmware set, in bits per second.
        bits_per_second: u32,
    },
    /// The node was reset, and starts again. What lies in RAM stays.
    Reset(ResetCause),
    /// The node has stopped.
    Stopped {
        /// Why.
        reason: StopReason,
        /// Where.
        place: Place,
    },
}

/// What resets a node whose power stays on.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum ResetCause {
    /// The firmware asked for it (AIRCR.SYSRESETREQ).
    #[error("the software")]
    Software,
    /// Somebody pulled the reset pin: a button, a debug probe.
    #[error("the reset pin")]
    Pin,
    /// The independent watchdog was not fed in time.
    #[error("the independent watchdog")]
    Watchdog,
}

/// Why a node stopped. Only the watchdog, if it runs, brings it back.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum StopReason {
    /// A fault. On hardware HardFault would be next; nothing useful ever follows it.
    #[error("{0}")]
    Fault(CpuFault),
    /// A breakpoint instruction, at which hardware without a debugger faults.
    #[error("breakpoint {0}")]
    Breakpoint(u8),
    /// The program returned from an exception in a way that the core refuses.
    #[error("exception return with EXC_RETURN {0:#010x}")]
    BadExceptionReturn(u32),
    /// An SVC in a handler that does not yield to it.
    #[error("supervisor call with SVCall masked")]
    MaskedSupervisorCall,
    /// The vector table cannot be read, or holds no Thumb address.
    #[error("no handler for exception {0} in the vector table")]
    NoHandler(u16),
}

impl core::fmt::Display for ObservationKind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Pin { pin, level, .. } => write!(f, "{pin} {}", if *level { "high" } else { "low" }),
            Self::Log(line) => line.fmt(f),
            Self::Record { channel, bytes } => write!(f, "{channel}: {bytes:02X?}"),
            Self::Reached { place, .. } => write!(f, "reached {place}"),
            Self::Handler { exception, begins, .. } => {
                write!(f, "handler of exception {exception} {}", if *begins { "begins" } else { "ends" })
            }
            Self::NotModelled { access, address, place } => {
                write!(
                    f,
                    "{access} of {address:#010x} at {place} is not modelled by the emulator, or not allowed now"
                )
            }
            Self::NotClocked { access, address, place } => write!(
                f,
                "{access} of {address:#010x} at {place} without effect: enable the peripheral's clock in RCC"
            ),
            Self::WrongBitRate { bits_per_second } => write!(
                f,
                "CAN set to {bits_per_second} bit/s, which is not the rate of the bus: correct BTR or the clocks"
            ),
            Self::Reset(cause) => write!(f, "reset by {cause}"),
            Self::Stopped { reason, place } => write!(f, "stopped by {reason} at {place}"),
        }
    }
}
