//! Finds the special form of an instruction, if it has one.

use super::PC;
use super::common::Common;
use super::op::Op;
use super::operands::{Address, Alu, CarryOut, Flags, Operand, Reg, Width};

/// The special form of an instruction, if it has one.
pub(super) fn specialise(op: Op) -> Op {
    let common = match op {
        Op::Load { rt, address: Address::Offset(rn, offset), width: Width::Word }
            if names_none(&[rt, rn]) =>
        {
            Common::LoadWord { rt, rn, offset }
        }
        Op::Load { rt, address: Address::Offset(rn, offset), width: Width::Byte }
            if names_none(&[rt, rn]) =>
        {
            Common::LoadByte { rt, rn, offset }
        }
        Op::Store { rt, address: Address::Offset(rn, offset), width: Width::Word } => {
            Common::StoreWord { rt, rn, offset }
        }
        Op::Store { rt, address: Address::Offset(rn, offset), width: Width::Byte } => {
            Common::StoreByte { rt, rn, offset }
        }
        Op::Alu { op, rd, rn, operand, flags: Flags::Keep } if names_none(&[rd, rn]) => {
            return alu(op, rd, rn, operand)
                .map_or(Op::Alu { op, rd, rn, operand, flags: Flags::Keep }, Op::Common);
        }
        Op::Test { op: Alu::Sub, rn, operand: Operand::Constant(value, _) } => {
            Common::CompareConstant { rn, value }
        }
        Op::Test { op: Alu::Sub, rn, operand: Operand::Register(rm) } => Common::Compare { rn, rm },
        other => return other,
    };
    Op::Common(common)
}

fn alu(op: Alu, rd: Reg, rn: Reg, operand: Operand) -> Option<Common> {
    Some(match (op, operand) {
        (Alu::Mov, Operand::Register(rm)) => Common::Move { rd, rm },
        (Alu::Mov, Operand::Constant(value, _)) => Common::MoveConstant { rd, value },
        (Alu::Mvn, Operand::Constant(value, _)) => Common::MoveConstant { rd, value: !value },
        (Alu::Add, Operand::Constant(value, _)) => Common::AddConstant { rd, rn, value },
        (Alu::Sub, Operand::Constant(value, _)) => {
            Common::AddConstant { rd, rn, value: value.wrapping_neg() }
        }
        (Alu::Add, Operand::Register(rm)) => Common::Add { rd, rn, rm },
        (Alu::Orr, Operand::Register(rm)) => Common::Or { rd, rn, rm },
        (Alu::And, Operand::Constant(value, _)) => Common::And { rd, rn, value },
        (Alu::Bic, Operand::Constant(value, CarryOut::Unchanged)) => Common::And { rd, rn, value: !value },
        _ => return None,
    })
}

fn names_none(registers: &[Reg]) -> bool {
    registers.iter().all(|register| usize::from(*register) != PC)
}
