//! What instructions work on and what they do to it: registers, operands, addresses, operations.
//!
//! Registers are numbers 0 to 15, floating point registers 0 to 31. Reading R15 gives the address of the
//! instruction plus 4.

/// A register number, 0 to 15.
pub(super) type Reg = u8;

/// An operation of the data processing group (ARMv7-M ARM, A5.3.1).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Alu {
    And,
    Eor,
    Orr,
    Orn,
    Bic,
    Mov,
    Mvn,
    Add,
    Adc,
    Sub,
    Sbc,
    Rsb,
}

/// The kinds of shift, as encoded.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Shift {
    Left,
    LogicalRight,
    ArithmeticRight,
    RotateRight,
    /// By one bit, through the carry flag.
    RotateExtended,
}

/// The second operand of a data processing instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Operand {
    /// A constant, and what it does to the carry flag.
    Constant(u32, CarryOut),
    Register(Reg),
    Shifted(Reg, Shift, u8),
    /// Shifted by the low byte of another register.
    ShiftedBy(Reg, Shift, Reg),
}

/// What an expanded constant does to the carry flag.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum CarryOut {
    Unchanged,
    Clear,
    Set,
}

/// Whether an instruction sets the flags.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Flags {
    Keep,
    Set,
    /// The 16-bit encodings: only outside of an IT block.
    SetOutsideIt,
}

/// How the address of a load or store is made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Address {
    /// Base and offset.
    Offset(Reg, i32),
    /// Base and offset; the base becomes the address.
    PreIndexed(Reg, i32),
    /// Base; the base becomes base and offset.
    PostIndexed(Reg, i32),
    /// Base and a register, shifted left.
    Register(Reg, Reg, u8),
    /// The word-aligned PC and an offset.
    Literal(i32),
}

/// What a load does with the bits above the size.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Width {
    Byte,
    Half,
    Word,
    SignedByte,
    SignedHalf,
}

impl Width {
    pub(super) const fn bytes(self) -> u32 {
        match self {
            Self::Byte | Self::SignedByte => 1,
            Self::Half | Self::SignedHalf => 2,
            Self::Word => 4,
        }
    }
}

/// Sign or zero extension.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Extend {
    SignedByte,
    UnsignedByte,
    SignedHalf,
    UnsignedHalf,
    /// Two bytes to two halves.
    SignedBytes16,
    UnsignedBytes16,
}

/// Operations of two registers from the groups multiply, divide and miscellaneous.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Binary {
    Multiply,
    SignedDivide,
    UnsignedDivide,
    Qadd,
    Qsub,
    Qdadd,
    Qdsub,
    Select,
    /// The halves of the factors; true is the top one.
    MultiplyHalves(bool, bool),
    /// A word and a half of the second factor; true is the top one.
    MultiplyWordHalf(bool),
    /// Two products of halves, added or (true) subtracted; with the second factor swapped, or not.
    MultiplyDual {
        subtract: bool,
        swap: bool,
    },
    /// The high word of the product, rounded (true) or not.
    MultiplyHigh(bool),
    SumOfDifferences,
    /// Pack halves: of a shifted second operand, the top (true) or bottom.
    Pack {
        top: bool,
        shift: u8,
    },
    Parallel(Parallel),
}

/// Operations of two registers and an accumulator, 32 bits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Accumulate {
    Add,
    Subtract,
    Halves(bool, bool),
    WordHalf(bool),
    Dual { subtract: bool, swap: bool },
    HighAdd(bool),
    HighSubtract(bool),
    SumOfDifferences,
}

/// Operations with a 64-bit result.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Long {
    Signed,
    Unsigned,
    SignedAccumulate,
    UnsignedAccumulate,
    /// Both words of the result are added.
    UnsignedAccumulateAccumulate,
    Halves(bool, bool),
    Dual {
        subtract: bool,
        swap: bool,
    },
}

/// Parallel addition and subtraction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Parallel {
    pub(super) shape: Shape,
    pub(super) kind: ParallelKind,
    pub(super) signed: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Shape {
    Add8,
    Add16,
    Sub8,
    Sub16,
    /// Exchange halves; subtract the low, add the high ones.
    AddSubtractExchange,
    /// Exchange halves; add the low, subtract the high ones.
    SubtractAddExchange,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ParallelKind {
    /// Sets the GE flags.
    Plain,
    Saturating,
    Halving,
}

/// Operations of one register.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Unary {
    ReverseBytes,
    ReverseBytes16,
    ReverseSignedHalf,
    ReverseBits,
    CountLeadingZeros,
}

/// Floating point operations of two registers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum FloatBinary {
    Add,
    Subtract,
    Multiply,
    NegatedMultiply,
    Divide,
    /// The destination is added; each part may be negated. Rounded twice.
    MultiplyAccumulate {
        negate_product: bool,
        negate_addend: bool,
    },
    /// The same, rounded once.
    FusedMultiplyAccumulate {
        negate_product: bool,
        negate_addend: bool,
    },
}

/// Floating point operations of one register.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum FloatUnary {
    Move,
    Absolute,
    Negate,
    SquareRoot,
    FromSigned,
    FromUnsigned,
    /// Rounded to zero, or as FPSCR says.
    ToSigned(bool),
    ToUnsigned(bool),
}
