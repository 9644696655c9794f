//! The processor core, behind a trait.
//!
//! A [`Cpu`] executes Thumb instructions and knows registers and memory. It knows nothing of interrupts,
//! sleep or peripherals: exception entry and return are [`crate::exception`], the rest is [`crate::soc`].
//! So the emulator behind it can be replaced.
//!
//! The core and the rest share one [`Pace`]: the core advances it with each instruction and stops where it
//! says, everybody else reads the time from it.

mod opcode;
mod pace;
mod unicorn;

pub(crate) use pace::Pace;
pub(crate) use unicorn::{Ram, UnicornCpu};

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
    /// Flags, IT state and exception number.
    Xpsr,
    /// Writes to the exception number only.
    Ipsr,
    /// Priority mask.
    Primask,
    /// Base priority.
    Basepri,
    /// Fault mask.
    Faultmask,
    /// Stack selection, privilege, FPCA.
    Control,
    /// S0 to S31.
    S(u8),
    /// Floating point status.
    Fpscr,
}

/// Why the core stopped. The PC stands at the instruction that was not executed, unless said otherwise.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Stop {
    /// The limit of the [`Pace`] is reached.
    Limit,
    /// At a WFI.
    WaitForInterrupt,
    /// At a WFE.
    WaitForEvent,
    /// At a SEV.
    SendEvent,
    /// At an SVC.
    SupervisorCall,
    /// At a BKPT with this immediate.
    Breakpoint(u8),
    /// The PC was loaded with this EXC_RETURN value.
    ExceptionReturn(u32),
    /// The instruction at PC could not be executed.
    Fault(Fault),
}

/// What went wrong in an instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Fault {
    /// Nothing is mapped at the address, or it may not be accessed in this way.
    #[error("{access} of unmapped or protected address {address:#010x}")]
    Access {
        /// What was tried.
        access: Access,
        /// Where.
        address: u32,
    },
    /// An undefined instruction, which is also how Rust's `udf` and most panic handlers end.
    #[error("undefined instruction")]
    Undefined,
    /// Another exception of the core, with the number that the emulator gives it.
    #[error("processor exception {0}")]
    Other(u32),
}

/// A kind of memory access.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Access {
    /// A load.
    Read,
    /// A store.
    Write,
    /// An instruction fetch.
    Fetch,
}

impl core::fmt::Display for Access {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Access::Read => "read",
            Access::Write => "write",
            Access::Fetch => "instruction fetch",
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
    /// Executes from PC until there is a reason to stop.
    fn run(&mut self) -> Stop;

    /// A word of memory.
    fn read_word(&self, address: u32) -> Result<u32, NoMemory> {
        let mut word = [0; 4];
        self.read_memory(address, &mut word)?;
        Ok(u32::from_le_bytes(word))
    }
}
