//! What the encodings of 16 and of 32 bits have in common.

use super::op::Op;
use super::operands::{Alu, CarryOut, Flags, Operand, Reg, Shift};

pub(super) const fn constant(value: u32) -> Operand {
    Operand::Constant(value, CarryOut::Unchanged)
}

pub(super) const fn alu(op: Alu, rd: Reg, rn: Reg, operand: Operand, flags: Flags) -> Op {
    Op::Alu { op, rd, rn, operand, flags }
}

/// The value of the low `bits` bits, with its sign.
pub(super) const fn sign_extend(value: u32, bits: u32) -> i32 {
    (value << (32 - bits)) as i32 >> (32 - bits)
}

/// An immediate shift as encoded: an amount of 0 means 32 for right shifts, and RRX for rotation.
pub(super) const fn shifted(rm: Reg, kind: u16, amount: u8) -> Operand {
    match (kind & 3, amount) {
        (0, 0) => Operand::Register(rm),
        (0, _) => Operand::Shifted(rm, Shift::Left, amount),
        (1, 0) => Operand::Shifted(rm, Shift::LogicalRight, 32),
        (1, _) => Operand::Shifted(rm, Shift::LogicalRight, amount),
        (2, 0) => Operand::Shifted(rm, Shift::ArithmeticRight, 32),
        (2, _) => Operand::Shifted(rm, Shift::ArithmeticRight, amount),
        (_, 0) => Operand::Shifted(rm, Shift::RotateExtended, 1),
        _ => Operand::Shifted(rm, Shift::RotateRight, amount),
    }
}
