//! The processor core, behind a trait.
//!
//! A [`Cpu`] executes Thumb instructions and knows registers and memory. It knows nothing of interrupts,
//! sleep or peripherals: exception entry and return are [`crate::exception`], the rest is [`crate::soc`].
//! So the interpreter behind it can be replaced.
//!
//! The core and the rest share one [`Pace`]: the core advances it with each instruction and stops where it
//! says, everybody else reads the time from it.

mod cycles;
mod interpreter;
mod masking;
mod pace;

pub(crate) use interpreter::Interpreter;
pub(crate) use masking::MaskedAt;
pub(crate) use pace::Pace;

/// What the core reads and writes outside of its memories.
pub(crate) trait Io {
    /// A load of `size` bytes (1, 2 or 4).
    fn read(&mut self, address: u32, size: usize) -> u32;
    /// A store of `size` bytes (1, 2 or 4).
    fn write(&mut self, address: u32, size: usize, value: u32);
}

/// A register of the core.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Register {
    /// R0 to R12.
    R(u8),
    /// The active stack pointer.
    Sp,
    /// The main stack pointer.
    Msp,
    /// The process stack pointer.
    Psp,
    /// R14.
    Lr,
    /// R15, with bit 0 clear.
    Pc,
    /// Flags, IT state, Thumb bit and exception number.
    Xpsr,
    /// The exception number.
    Ipsr,
    /// Priority mask.
    Primask,
    /// Base priority.
    Basepri,
    /// CpuFault mask.
    Faultmask,
    /// Stack selection, privilege, FPCA.
    Control,
    /// S0 to S31.
    S(u8),
    /// Floating point status.
    Fpscr,
}

/// Why the core stopped.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Stop {
    /// The limit of the [`Pace`] is reached. The PC stands at the instruction that was not executed.
    Limit,
    /// Behind a WFI.
    WaitForInterrupt,
    /// Behind a WFE.
    WaitForEvent,
    /// Behind a SEV.
    SendEvent,
    /// Behind an SVC.
    SupervisorCall,
    /// At a BKPT with this immediate, which is not executed.
    Breakpoint(u8),
    /// A branch to this EXC_RETURN value.
    ExceptionReturn(u32),
    /// The instruction at PC cannot be executed.
    Fault(CpuFault),
}

/// What went wrong in an instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum CpuFault {
    /// Nothing is mapped at the address, or it may not be accessed in this way.
    #[error("{access} of unmapped or protected address {address:#010x}")]
    Access {
        /// What was tried.
        access: AccessKind,
        /// Where.
        address: u32,
    },
    /// An undefined instruction, which is also how Rust's `udf` and most panic handlers end.
    #[error("undefined instruction")]
    Undefined,
    /// The address of a double, multiple, floating point or peripheral access is not aligned.
    #[error("unaligned {access} of address {address:#010x}")]
    Unaligned {
        /// What was tried.
        access: AccessKind,
        /// Where.
        address: u32,
    },
    /// A branch to an address whose bit 0 is clear: there is no other instruction set than Thumb.
    #[error("branch to {target:#010x}, which is no Thumb address")]
    NotThumb {
        /// The target.
        target: u32,
    },
}

/// A kind of memory access.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AccessKind {
    /// A load.
    Read,
    /// A store.
    Write,
    /// An instruction fetch.
    Fetch,
}

impl core::fmt::Display for AccessKind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            AccessKind::Read => "read",
            AccessKind::Write => "write",
            AccessKind::Fetch => "instruction fetch",
        })
    }
}

/// A memory access of the host failed: nothing is mapped there.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("no memory at {0:#010x}")]
pub(crate) struct NoMemory(pub(crate) u32);

/// A processor core with its memories.
pub(crate) trait Cpu {
    /// The value of a register.
    fn register(&self, register: Register) -> u32;
    /// Changes a register.
    fn set_register(&mut self, register: Register, value: u32);
    /// Copies memory out; peripherals cannot be read in this way.
    fn read_memory(&self, address: u32, into: &mut [u8]) -> Result<(), NoMemory>;
    /// Copies into memory.
    fn write_memory(&mut self, address: u32, bytes: &[u8]) -> Result<(), NoMemory>;
    /// What the core itself does at the entry of an exception: it leaves an IT block, whose state is in the
    /// saved context, and clears its exclusive monitor.
    fn enter_exception(&mut self);
    /// Executes from PC until there is a reason to stop.
    fn run(&mut self) -> Stop;

    /// A word of memory.
    fn read_word(&self, address: u32) -> Result<u32, NoMemory> {
        let mut word = [0; 4];
        self.read_memory(address, &mut word)?;
        Ok(u32::from_le_bytes(word))
    }
}
