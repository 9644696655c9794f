//! Decodes 32-bit Thumb instructions of the core (ARMv7-M ARM, A5.3).

use super::encoding::{alu, constant, shifted, sign_extend};
use super::op::Op;
use super::operands::{
    Accumulate, Address, Alu, Binary, CarryOut, Extend, Flags, Long, Operand, Parallel, ParallelKind, Reg,
    Shape, Shift, Unary, Width,
};

const PC: Reg = 15;

/// Decodes an instruction that is none of the coprocessor.
pub(super) fn decode(first: u16, second: u16) -> Op {
    match first >> 9 {
        0b111_0100 if first & 0x40 == 0 => multiple(first, second),
        0b111_0100 => dual_exclusive_table(first, second),
        0b111_0101 => shifted_register(first, second),
        0b111_1000 | 0b111_1010 if second & 0x8000 == 0 => modified_immediate(first, second),
        0b111_1001 | 0b111_1011 if second & 0x8000 == 0 => plain_immediate(first, second),
        0b111_1000..=0b111_1011 => branch_or_control(first, second),
        0b111_1100 => load_store(first, second),
        0b111_1101 if first & 0x100 == 0 => register(first, second),
        0b111_1101 if first & 0x80 == 0 => multiply(first, second),
        0b111_1101 => long_multiply(first, second),
        _ => Op::Undefined,
    }
}

const fn low(instruction: u16) -> Reg {
    (instruction & 0xF) as Reg
}

const fn field(instruction: u16, at: u32) -> Reg {
    (instruction >> at & 0xF) as Reg
}

const fn bit(instruction: u16, at: u32) -> bool {
    instruction >> at & 1 != 0
}

const fn signed_offset(up: bool, offset: u16) -> i32 {
    if up { offset as i32 } else { -(offset as i32) }
}

fn multiple(first: u16, second: u16) -> Op {
    let (rn, write_back, load) = (low(first), bit(first, 5), bit(first, 4));
    let decrement = match first >> 7 & 3 {
        1 => false,
        2 => true,
        _ => return Op::Undefined,
    };
    if load {
        Op::LoadMultiple { rn, list: second, write_back, decrement }
    } else {
        Op::StoreMultiple { rn, list: second, write_back, decrement }
    }
}

fn dual_exclusive_table(first: u16, second: u16) -> Op {
    let (pre, up, write_back, load) = (bit(first, 8), bit(first, 7), bit(first, 5), bit(first, 4));
    let (rn, rt, rt2) = (low(first), field(second, 12), field(second, 8));
    if pre || write_back {
        let offset = signed_offset(up, (second & 0xFF) * 4);
        let address = indexed(rn, offset, pre, write_back);
        return match (load, rn == PC) {
            (true, true) => Op::LoadDual { rt, rt2, address: Address::Literal(offset) },
            (true, false) => Op::LoadDual { rt, rt2, address },
            (false, false) => Op::StoreDual { rt, rt2, address },
            (false, true) => Op::Undefined,
        };
    }
    let narrow = match second >> 4 & 0xF {
        4 => Width::Byte,
        5 => Width::Half,
        _ => Width::Word,
    };
    match (up, load, second >> 4 & 0xF) {
        (false, false, _) => {
            Op::StoreExclusive { rd: rt2, rt, rn, offset: (second & 0xFF) * 4, width: Width::Word }
        }
        (false, true, _) => Op::LoadExclusive { rt, rn, offset: (second & 0xFF) * 4, width: Width::Word },
        (true, false, 4 | 5) => Op::StoreExclusive { rd: low(second), rt, rn, offset: 0, width: narrow },
        (true, true, 4 | 5) => Op::LoadExclusive { rt, rn, offset: 0, width: narrow },
        (true, true, kind @ (0 | 1)) => Op::TableBranch { rn, rm: low(second), halves: kind == 1 },
        _ => Op::Undefined,
    }
}

const fn indexed(rn: Reg, offset: i32, pre: bool, write_back: bool) -> Address {
    match (pre, write_back) {
        (true, true) => Address::PreIndexed(rn, offset),
        (true, false) => Address::Offset(rn, offset),
        (false, _) => Address::PostIndexed(rn, offset),
    }
}

/// The common part of both data processing groups.
fn data_processing(first: u16, rd: Reg, operand: Operand) -> Op {
    let (rn, set) = (low(first), bit(first, 4));
    let flags = if set { Flags::Set } else { Flags::Keep };
    let or_test =
        |op| if rd == PC && set { Op::Test { op, rn, operand } } else { alu(op, rd, rn, operand, flags) };
    match first >> 5 & 0xF {
        0x0 => or_test(Alu::And),
        0x1 => alu(Alu::Bic, rd, rn, operand, flags),
        0x2 if rn == PC => alu(Alu::Mov, rd, 0, operand, flags),
        0x2 => alu(Alu::Orr, rd, rn, operand, flags),
        0x3 if rn == PC => alu(Alu::Mvn, rd, 0, operand, flags),
        0x3 => alu(Alu::Orn, rd, rn, operand, flags),
        0x4 => or_test(Alu::Eor),
        0x8 => or_test(Alu::Add),
        0xA => alu(Alu::Adc, rd, rn, operand, flags),
        0xB => alu(Alu::Sbc, rd, rn, operand, flags),
        0xD => or_test(Alu::Sub),
        0xE => alu(Alu::Rsb, rd, rn, operand, flags),
        _ => Op::Undefined,
    }
}

fn shifted_register(first: u16, second: u16) -> Op {
    let (rd, rm) = (field(second, 8), low(second));
    let amount = ((second >> 12 & 7) << 2 | second >> 6 & 3) as u8;
    if first >> 5 & 0xF == 6 {
        if bit(first, 4) || bit(second, 4) {
            return Op::Undefined;
        }
        let op = Binary::Pack { top: bit(second, 5), shift: amount };
        return Op::Binary { op, rd, rn: low(first), rm, flags: Flags::Keep };
    }
    data_processing(first, rd, shifted(rm, second >> 4, amount))
}

/// The 12 bits of a constant, from both halves.
const fn immediate_12(first: u16, second: u16) -> u16 {
    (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF
}

fn modified_immediate(first: u16, second: u16) -> Op {
    data_processing(first, field(second, 8), expand(immediate_12(first, second)))
}

/// ThumbExpandImm_C (A5.3.2).
fn expand(encoded: u16) -> Operand {
    let byte = u32::from(encoded & 0xFF);
    let unrotated = match encoded >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => {
            let value = (u32::from(encoded & 0x7F) | 0x80).rotate_right(u32::from(encoded >> 7));
            let carry = if value >> 31 != 0 { CarryOut::Set } else { CarryOut::Clear };
            return Operand::Constant(value, carry);
        }
    };
    constant(unrotated)
}

fn plain_immediate(first: u16, second: u16) -> Op {
    let (rd, rn) = (field(second, 8), low(first));
    let value = immediate_12(first, second);
    let lsb = ((second >> 12 & 7) << 2 | second >> 6 & 3) as u8;
    let low_bits = (second & 0x1F) as u8;
    let saturate = |signed: bool| {
        let arithmetic = bit(first, 5);
        let bits = low_bits + u8::from(signed);
        if arithmetic && lsb == 0 {
            if low_bits & 0x10 != 0 {
                return Op::Undefined;
            }
            return Op::SaturateHalves { rd, rn, bits, signed };
        }
        let shift = if arithmetic { Shift::ArithmeticRight } else { Shift::Left };
        Op::Saturate { rd, rn, bits, shift, amount: lsb, signed }
    };
    let whole = u32::from(low(first)) << 12 | u32::from(value);
    match first >> 4 & 0x1F {
        0x00 if rn == PC => Op::PcRelative { rd, offset: value.into() },
        0x00 => alu(Alu::Add, rd, rn, constant(value.into()), Flags::Keep),
        0x04 => alu(Alu::Mov, rd, 0, constant(whole), Flags::Keep),
        0x0A if rn == PC => Op::PcRelative { rd, offset: -i32::from(value) },
        0x0A => alu(Alu::Sub, rd, rn, constant(value.into()), Flags::Keep),
        0x0C => Op::MoveTop { rd, value: whole as u16 },
        0x10 | 0x12 => saturate(true),
        0x14 => Op::ExtractField { rd, rn, lsb, width: low_bits + 1, signed: true },
        0x16 if low_bits >= lsb => Op::InsertField { rd, rn, lsb, width: low_bits - lsb + 1 },
        0x18 | 0x1A => saturate(false),
        0x1C => Op::ExtractField { rd, rn, lsb, width: low_bits + 1, signed: false },
        _ => Op::Undefined,
    }
}

fn branch_or_control(first: u16, second: u16) -> Op {
    let sign = u32::from(first >> 10 & 1);
    let (j1, j2) = (u32::from(second >> 13 & 1), u32::from(second >> 11 & 1));
    let low_part = u32::from(second & 0x7FF) << 1;
    if second & 0x5000 == 0 {
        let condition = first >> 6 & 0xF;
        if condition >= 0xE {
            return control(first, second);
        }
        let high = sign << 20 | j2 << 19 | j1 << 18 | u32::from(first & 0x3F) << 12;
        return Op::BranchIf { condition: condition as u8, offset: sign_extend(high | low_part, 21) };
    }
    let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
    let high = sign << 24 | i1 << 23 | i2 << 22 | u32::from(first & 0x3FF) << 12;
    let offset = sign_extend(high | low_part, 25);
    match second & 0x5000 {
        0x1000 if offset == -4 => Op::Spin { instructions: 1, cycles: 3, is_branch: true },
        0x1000 => Op::Branch { offset },
        0x5000 => Op::BranchLink { offset },
        _ => Op::Undefined,
    }
}

fn control(first: u16, second: u16) -> Op {
    let special = second as u8;
    match first >> 4 & 0x7F {
        0x38 => Op::MoveToSpecial { rn: low(first), special, mask: (second >> 10 & 3) as u8 },
        0x3A if second & 0x700 != 0 => Op::Undefined,
        0x3A => match second & 0xFF {
            2 => Op::WaitForEvent,
            3 => Op::WaitForInterrupt,
            4 => Op::SendEvent,
            _ => Op::Nop,
        },
        0x3B => match second >> 4 & 0xF {
            2 => Op::ClearExclusive,
            4..=6 => Op::Nop,
            _ => Op::Undefined,
        },
        0x3E => Op::MoveFromSpecial { rd: field(second, 8), special },
        _ => Op::Undefined,
    }
}

fn load_store(first: u16, second: u16) -> Op {
    let (load, signed) = (bit(first, 4), bit(first, 8));
    let width = match (first >> 5 & 3, signed) {
        (0, false) => Width::Byte,
        (1, false) => Width::Half,
        (2, false) => Width::Word,
        (0, true) => Width::SignedByte,
        (1, true) => Width::SignedHalf,
        _ => return Op::Undefined,
    };
    let (rn, rt) = (low(first), field(second, 12));
    let address = match address(first, second, rn, load) {
        Some(address) => address,
        None => return Op::Undefined,
    };
    match (load, signed) {
        // A load of a byte or halfword to the PC is a preload hint.
        (true, _) if rt == PC && width != Width::Word => Op::Nop,
        (true, _) => Op::Load { rt, address, width },
        (false, true) => Op::Undefined,
        (false, false) => Op::Store { rt, address, width },
    }
}

fn address(first: u16, second: u16, rn: Reg, load: bool) -> Option<Address> {
    let offset_12 = second & 0xFFF;
    if rn == PC {
        return load.then(|| Address::Literal(signed_offset(bit(first, 7), offset_12)));
    }
    if bit(first, 7) {
        return Some(Address::Offset(rn, offset_12.into()));
    }
    if !bit(second, 11) {
        let is_register = second & 0x7C0 == 0;
        return is_register.then(|| Address::Register(rn, low(second), (second >> 4 & 3) as u8));
    }
    let (pre, up, write_back) = (bit(second, 10), bit(second, 9), bit(second, 8));
    let offset = signed_offset(up, second & 0xFF);
    // Neither indexed nor with a new base: undefined.
    (pre || write_back).then(|| indexed(rn, offset, pre, write_back))
}

fn register(first: u16, second: u16) -> Op {
    if second & 0xF000 != 0xF000 {
        return Op::Undefined;
    }
    let (rd, rn, rm) = (field(second, 8), low(first), low(second));
    let (op1, op2) = (first >> 4 & 0xF, second >> 4 & 0xF);
    let binary = |op| Op::Binary { op, rd, rn, rm, flags: Flags::Keep };
    match (op1, op2) {
        (0..=7, 0) => {
            let kind = match op1 >> 1 {
                0 => Shift::Left,
                1 => Shift::LogicalRight,
                2 => Shift::ArithmeticRight,
                _ => Shift::RotateRight,
            };
            let flags = if op1 & 1 != 0 { Flags::Set } else { Flags::Keep };
            alu(Alu::Mov, rd, 0, Operand::ShiftedBy(rn, kind, rm), flags)
        }
        (0..=5, 8..=15) => {
            let extend = match op1 {
                0 => Extend::SignedHalf,
                1 => Extend::UnsignedHalf,
                2 => Extend::SignedBytes16,
                3 => Extend::UnsignedBytes16,
                4 => Extend::SignedByte,
                _ => Extend::UnsignedByte,
            };
            Op::Extend { extend, rd, rn, rm, rotation: (op2 & 3) as u8 * 8 }
        }
        (8..=14, 0..=7) => parallel(op1, op2).map_or(Op::Undefined, |op| binary(Binary::Parallel(op))),
        (8, 8) => binary(Binary::Qadd),
        (8, 9) => binary(Binary::Qdadd),
        (8, 10) => binary(Binary::Qsub),
        (8, 11) => binary(Binary::Qdsub),
        (9, 8) => Op::Unary { op: Unary::ReverseBytes, rd, rm },
        (9, 9) => Op::Unary { op: Unary::ReverseBytes16, rd, rm },
        (9, 10) => Op::Unary { op: Unary::ReverseBits, rd, rm },
        (9, 11) => Op::Unary { op: Unary::ReverseSignedHalf, rd, rm },
        (10, 8) => binary(Binary::Select),
        (11, 8) => Op::Unary { op: Unary::CountLeadingZeros, rd, rm },
        _ => Op::Undefined,
    }
}

fn parallel(op1: u16, op2: u16) -> Option<Parallel> {
    let shape = match op1 & 7 {
        0 => Shape::Add8,
        1 => Shape::Add16,
        2 => Shape::AddSubtractExchange,
        4 => Shape::Sub8,
        5 => Shape::Sub16,
        6 => Shape::SubtractAddExchange,
        _ => return None,
    };
    let kind = match op2 & 3 {
        0 => ParallelKind::Plain,
        1 => ParallelKind::Saturating,
        2 => ParallelKind::Halving,
        _ => return None,
    };
    Some(Parallel { shape, kind, signed: op2 & 4 == 0 })
}

fn multiply(first: u16, second: u16) -> Op {
    let (rd, rn, rm, ra) = (field(second, 8), low(first), low(second), field(second, 12));
    let (n, m) = (bit(second, 5), bit(second, 4));
    if second & 0xC0 != 0 {
        return Op::Undefined;
    }
    let (alone, with) = match (first >> 4 & 7, n) {
        (0, false) if !m => (Some(Binary::Multiply), Accumulate::Add),
        (0, false) => (None, Accumulate::Subtract),
        (1, _) => (Some(Binary::MultiplyHalves(n, m)), Accumulate::Halves(n, m)),
        (2, false) => dual(false, m),
        (3, false) => (Some(Binary::MultiplyWordHalf(m)), Accumulate::WordHalf(m)),
        (4, false) => dual(true, m),
        (5, false) => (Some(Binary::MultiplyHigh(m)), Accumulate::HighAdd(m)),
        (6, false) => (None, Accumulate::HighSubtract(m)),
        (7, false) if !m => (Some(Binary::SumOfDifferences), Accumulate::SumOfDifferences),
        _ => return Op::Undefined,
    };
    match alone {
        Some(op) if ra == PC => Op::Binary { op, rd, rn, rm, flags: Flags::Keep },
        _ => Op::Accumulate { op: with, rd, rn, rm, ra },
    }
}

const fn dual(subtract: bool, swap: bool) -> (Option<Binary>, Accumulate) {
    (Some(Binary::MultiplyDual { subtract, swap }), Accumulate::Dual { subtract, swap })
}

fn long_multiply(first: u16, second: u16) -> Op {
    let (low_word, high_word) = (field(second, 12), field(second, 8));
    let (rn, rm) = (low(first), low(second));
    let long = |op| Op::Long { op, low: low_word, high: high_word, rn, rm };
    let divide = |op| Op::Binary { op, rd: high_word, rn, rm, flags: Flags::Keep };
    let (n, m) = (bit(second, 5), bit(second, 4));
    match (first >> 4 & 7, second >> 4 & 0xF) {
        (0, 0) => long(Long::Signed),
        (1, 15) => divide(Binary::SignedDivide),
        (2, 0) => long(Long::Unsigned),
        (3, 15) => divide(Binary::UnsignedDivide),
        (4, 0) => long(Long::SignedAccumulate),
        (4, 8..=11) => long(Long::Halves(n, m)),
        (4, 12 | 13) => long(Long::Dual { subtract: false, swap: m }),
        (5, 12 | 13) => long(Long::Dual { subtract: true, swap: m }),
        (6, 0) => long(Long::UnsignedAccumulate),
        (6, 6) => long(Long::UnsignedAccumulateAccumulate),
        _ => Op::Undefined,
    }
}
