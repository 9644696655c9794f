//! Decodes 16-bit Thumb instructions (ARMv7-M ARM, A5.2).

use super::encoding::{alu, constant, shifted, sign_extend};
use super::op::Op;
use super::operands::{Address, Alu, Binary, Extend, Flags, Operand, Reg, Shift, Unary, Width};
use super::{decode_float, decode_wide};

const SP: Reg = 13;
const LR: u16 = 14;
const PC: u16 = 15;

/// Returns whether an instruction that starts with this halfword has a second one.
pub(super) const fn is_wide(first: u16) -> bool {
    first >= 0xE800
}

/// Decodes an instruction; `second` is the halfword behind the first, whether it belongs to it or not.
pub(super) fn decode(first: u16, second: u16) -> Op {
    if is_wide(first) {
        return if first & 0xEC00 == 0xEC00 {
            decode_float::decode(first, second)
        } else {
            decode_wide::decode(first, second)
        };
    }
    match first >> 12 {
        0x0 | 0x1 => shift_add_subtract(first),
        0x2 | 0x3 => immediate(first),
        0x4 => data_processing(first),
        0x5 => register_offset(first),
        0x6..=0x9 => immediate_offset(first),
        0xA => {
            let (rd, offset) = (reg(first, 8), i32::from(first & 0xFF) * 4);
            if first & 0x800 == 0 {
                Op::PcRelative { rd, offset }
            } else {
                alu(Alu::Add, rd, SP, constant(offset as u32), Flags::Keep)
            }
        }
        0xB => miscellaneous(first, second),
        0xC => {
            let (rn, list) = (reg(first, 8), first & 0xFF);
            if first & 0x800 == 0 {
                Op::StoreMultiple { rn, list, write_back: true, decrement: false }
            } else {
                Op::LoadMultiple { rn, list, write_back: list >> rn & 1 == 0, decrement: false }
            }
        }
        0xD => match first >> 8 & 0xF {
            0xE => Op::Undefined,
            0xF => Op::SupervisorCall,
            condition => Op::BranchIf { condition: condition as u8, offset: i32::from(first as i8) * 2 },
        },
        _ if first == 0xE7FE => Op::Spin { instructions: 1, cycles: 3, is_branch: true },
        _ => Op::Branch { offset: sign_extend(u32::from(first & 0x7FF) << 1, 12) },
    }
}

const fn reg(instruction: u16, at: u32) -> Reg {
    (instruction >> at & 7) as Reg
}

fn shift_add_subtract(first: u16) -> Op {
    let flags = Flags::SetOutsideIt;
    let (rd, rm) = (reg(first, 0), reg(first, 3));
    let kind = first >> 11 & 3;
    if kind != 3 {
        return alu(Alu::Mov, rd, 0, shifted(rm, kind, (first >> 6 & 0x1F) as u8), flags);
    }
    let op = if first & 0x200 == 0 { Alu::Add } else { Alu::Sub };
    let other = reg(first, 6);
    let operand = if first & 0x400 == 0 { Operand::Register(other) } else { constant(other.into()) };
    alu(op, rd, rm, operand, flags)
}

fn immediate(first: u16) -> Op {
    let (rd, operand) = (reg(first, 8), constant((first & 0xFF).into()));
    match first >> 11 & 3 {
        0 => alu(Alu::Mov, rd, 0, operand, Flags::SetOutsideIt),
        1 => Op::Test { op: Alu::Sub, rn: rd, operand },
        2 => alu(Alu::Add, rd, rd, operand, Flags::SetOutsideIt),
        _ => alu(Alu::Sub, rd, rd, operand, Flags::SetOutsideIt),
    }
}

fn data_processing(first: u16) -> Op {
    if first & 0x800 != 0 {
        let (rt, offset) = (reg(first, 8), i32::from(first & 0xFF) * 4);
        return Op::Load { rt, address: Address::Literal(offset), width: Width::Word };
    }
    if first & 0x400 != 0 {
        return high_registers(first);
    }
    let (rd, rm) = (reg(first, 0), reg(first, 3));
    let flags = Flags::SetOutsideIt;
    let operand = Operand::Register(rm);
    let shift = |kind| alu(Alu::Mov, rd, 0, Operand::ShiftedBy(rd, kind, rm), flags);
    match first >> 6 & 0xF {
        0x0 => alu(Alu::And, rd, rd, operand, flags),
        0x1 => alu(Alu::Eor, rd, rd, operand, flags),
        0x2 => shift(Shift::Left),
        0x3 => shift(Shift::LogicalRight),
        0x4 => shift(Shift::ArithmeticRight),
        0x5 => alu(Alu::Adc, rd, rd, operand, flags),
        0x6 => alu(Alu::Sbc, rd, rd, operand, flags),
        0x7 => shift(Shift::RotateRight),
        0x8 => Op::Test { op: Alu::And, rn: rd, operand },
        0x9 => alu(Alu::Rsb, rd, rm, constant(0), flags),
        0xA => Op::Test { op: Alu::Sub, rn: rd, operand },
        0xB => Op::Test { op: Alu::Add, rn: rd, operand },
        0xC => alu(Alu::Orr, rd, rd, operand, flags),
        0xD => Op::Binary { op: Binary::Multiply, rd, rn: rd, rm, flags },
        0xE => alu(Alu::Bic, rd, rd, operand, flags),
        _ => alu(Alu::Mvn, rd, 0, operand, flags),
    }
}

fn high_registers(first: u16) -> Op {
    let rd = reg(first, 0) | (first >> 4 & 8) as Reg;
    let rm = (first >> 3 & 0xF) as Reg;
    let operand = Operand::Register(rm);
    match first >> 8 & 3 {
        0 => alu(Alu::Add, rd, rd, operand, Flags::Keep),
        1 => Op::Test { op: Alu::Sub, rn: rd, operand },
        2 => alu(Alu::Mov, rd, 0, operand, Flags::Keep),
        _ if first & 0x80 == 0 => Op::BranchExchange { rm },
        _ => Op::BranchLinkExchange { rm },
    }
}

fn register_offset(first: u16) -> Op {
    let rt = reg(first, 0);
    let address = Address::Register(reg(first, 3), reg(first, 6), 0);
    let store = |width| Op::Store { rt, address, width };
    let load = |width| Op::Load { rt, address, width };
    match first >> 9 & 7 {
        0 => store(Width::Word),
        1 => store(Width::Half),
        2 => store(Width::Byte),
        3 => load(Width::SignedByte),
        4 => load(Width::Word),
        5 => load(Width::Half),
        6 => load(Width::Byte),
        _ => load(Width::SignedHalf),
    }
}

fn immediate_offset(first: u16) -> Op {
    let offset = i32::from(first >> 6 & 0x1F);
    let (rt, rn, offset, width) = match first >> 12 {
        6 => (reg(first, 0), reg(first, 3), offset * 4, Width::Word),
        7 => (reg(first, 0), reg(first, 3), offset, Width::Byte),
        8 => (reg(first, 0), reg(first, 3), offset * 2, Width::Half),
        _ => (reg(first, 8), SP, i32::from(first & 0xFF) * 4, Width::Word),
    };
    let address = Address::Offset(rn, offset);
    if first & 0x800 == 0 { Op::Store { rt, address, width } } else { Op::Load { rt, address, width } }
}

fn miscellaneous(first: u16, second: u16) -> Op {
    let (rd, rm) = (reg(first, 0), reg(first, 3));
    let extend = |extend| Op::Extend { extend, rd, rn: PC as Reg, rm, rotation: 0 };
    let unary = |op| Op::Unary { op, rd, rm };
    match first >> 8 & 0xF {
        0x0 => {
            let op = if first & 0x80 == 0 { Alu::Add } else { Alu::Sub };
            alu(op, SP, SP, constant(u32::from(first & 0x7F) * 4), Flags::Keep)
        }
        0x1 | 0x3 | 0x9 | 0xB => {
            let offset = i32::from((first >> 9 & 1) << 6 | (first >> 3 & 0x1F) << 1);
            Op::CompareBranch { rn: rd, offset, if_zero: first & 0x800 == 0 }
        }
        0x2 => match first >> 6 & 3 {
            0 => extend(Extend::SignedHalf),
            1 => extend(Extend::SignedByte),
            2 => extend(Extend::UnsignedHalf),
            _ => extend(Extend::UnsignedByte),
        },
        0x4 | 0x5 => {
            let list = first & 0xFF | (first >> 8 & 1) << LR;
            Op::StoreMultiple { rn: SP, list, write_back: true, decrement: true }
        }
        0x6 if first & 0xE8 == 0x60 => {
            Op::ChangeMasks { disable: first & 0x10 != 0, primask: first & 2 != 0, faultmask: first & 1 != 0 }
        }
        0xA => match first >> 6 & 3 {
            0 => unary(Unary::ReverseBytes),
            1 => unary(Unary::ReverseBytes16),
            3 => unary(Unary::ReverseSignedHalf),
            _ => Op::Undefined,
        },
        0xC | 0xD => {
            let list = first & 0xFF | (first >> 8 & 1) << PC;
            Op::LoadMultiple { rn: SP, list, write_back: true, decrement: false }
        }
        0xE => Op::Breakpoint(first as u8),
        0xF => hint(first, second),
        _ => Op::Undefined,
    }
}

fn hint(first: u16, second: u16) -> Op {
    // A branch to the halfword before it.
    const BRANCH_BACK: u16 = 0xE7FD;
    if first & 0xF != 0 {
        return Op::IfThen(first as u8);
    }
    match first >> 4 & 0xF {
        0 if second == BRANCH_BACK => Op::Spin { instructions: 2, cycles: 4, is_branch: false },
        2 => Op::WaitForEvent,
        3 => Op::WaitForInterrupt,
        4 => Op::SendEvent,
        _ => Op::Nop,
    }
}
