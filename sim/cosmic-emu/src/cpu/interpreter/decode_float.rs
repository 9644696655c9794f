//! Decodes floating point instructions, single precision (ARMv7-M ARM, A6).
//!
//! The FPv4-SP unit has no double precision arithmetic; it loads, stores and moves double registers.

use super::op::Op;
use super::operands::{Address, FloatBinary, FloatUnary};

/// Decodes an instruction of the coprocessor space.
pub(super) fn decode(first: u16, second: u16) -> Op {
    let coprocessor = second >> 8 & 0xF;
    let is_double = coprocessor == 11;
    if coprocessor & 0xE != 10 || first & 0x1000 != 0 {
        return Op::Undefined;
    }
    if first & 0x0200 == 0 {
        return load_store(first, second, is_double);
    }
    if first & 0x0100 != 0 {
        return Op::Undefined;
    }
    if second & 0x10 != 0 {
        return transfer(first, second, is_double);
    }
    if is_double { Op::Undefined } else { data_processing(first, second) }
}

/// The number of a single register: four bits of the field, and the low bit elsewhere.
const fn single(field: u16, low: u16) -> u8 {
    ((field & 0xF) << 1 | low & 1) as u8
}

/// The first of the two single registers that make a double one; `None` for D16 and above.
const fn double(field: u16, high: u16) -> Option<u8> {
    if high & 1 == 0 { Some(((field & 0xF) << 1) as u8) } else { None }
}

fn load_store(first: u16, second: u16, is_double: bool) -> Op {
    let bit = |at: u32| first >> at & 1 != 0;
    let (pre, up, write_back, load) = (bit(8), bit(7), bit(5), bit(4));
    let (rn, words) = ((first & 0xF) as u8, (second & 0xFF) as u8);
    let register =
        if is_double { double(second >> 12, first >> 6) } else { Some(single(second >> 12, first >> 6)) };
    if !pre && !up && !write_back {
        return if bit(6) { move_pair(first, second, is_double) } else { Op::Undefined };
    }
    let Some(first_register) = register else { return Op::Undefined };
    if pre && !write_back {
        let offset = i32::from(words) * if up { 4 } else { -4 };
        let address = if rn == 15 { Address::Literal(offset) } else { Address::Offset(rn, offset) };
        let count = if is_double { 2 } else { 1 };
        return if load {
            Op::FloatLoad { first: first_register, count, address }
        } else {
            Op::FloatStore { first: first_register, count, address }
        };
    }
    // An odd number of words of double registers is the form FLDMX, which is deprecated.
    let count = words;
    if pre == up
        || count == 0
        || (is_double && count % 2 != 0)
        || u16::from(first_register) + u16::from(count) > 32
    {
        return Op::Undefined;
    }
    Op::FloatMultiple { rn, first: first_register, count, write_back, decrement: pre, load }
}

fn move_pair(first: u16, second: u16, is_double: bool) -> Op {
    if second & 0xD0 != 0x10 {
        return Op::Undefined;
    }
    let register = if is_double { double(second, second >> 5) } else { Some(single(second, second >> 5)) };
    match register {
        Some(register) if register < 31 => Op::FloatMovePair {
            rt: (second >> 12) as u8,
            rt2: (first & 0xF) as u8,
            first: register,
            to_core: first & 0x10 != 0,
        },
        _ => Op::Undefined,
    }
}

fn transfer(first: u16, second: u16, is_double: bool) -> Op {
    let (rt, to_core) = ((second >> 12) as u8, first & 0x10 != 0);
    match (first >> 5 & 7, is_double) {
        (0, false) => Op::FloatMove { rt, sn: single(first, second >> 7), to_core },
        (7, false) if first & 0xF == 1 => Op::FloatStatus { rt, to_core },
        // One half of a double register.
        (half @ (0 | 1), true) if second & 0x60 == 0 => match double(first, second >> 7) {
            Some(register) => Op::FloatMove { rt, sn: register + half as u8, to_core },
            None => Op::Undefined,
        },
        _ => Op::Undefined,
    }
}

fn data_processing(first: u16, second: u16) -> Op {
    let (sd, sn, sm) =
        (single(second >> 12, first >> 6), single(first, second >> 7), single(second, second >> 5));
    let negate = second & 0x40 != 0;
    let binary = |op| Op::FloatBinary { op, sd, sn, sm };
    let multiply = |negate_product, negate_addend| {
        binary(FloatBinary::MultiplyAccumulate { negate_product, negate_addend })
    };
    let fused = |negate_product, negate_addend| {
        binary(FloatBinary::FusedMultiplyAccumulate { negate_product, negate_addend })
    };
    match (first >> 4 & 0xB, negate) {
        (0x0, negate) => multiply(negate, false),
        (0x1, negate) => multiply(negate, true),
        (0x2, false) => binary(FloatBinary::Multiply),
        (0x2, true) => binary(FloatBinary::NegatedMultiply),
        (0x3, false) => binary(FloatBinary::Add),
        (0x3, true) => binary(FloatBinary::Subtract),
        (0x8, false) => binary(FloatBinary::Divide),
        (0x9, negate) => fused(negate, true),
        (0xA, negate) => fused(negate, false),
        (0xB, false) => Op::FloatConstant { sd, bits: expand(first & 0xF, second & 0xF) },
        (0xB, true) => other(first, second, sd, sm),
        _ => Op::Undefined,
    }
}

/// VFPExpandImm: sign, inverted exponent bit, exponent and fraction of four bits.
const fn expand(high: u16, low: u16) -> u32 {
    let (high, low) = (high as u32, low as u32);
    let exponent = if high & 4 != 0 { 0x3E00_0000 } else { 0x4000_0000 };
    (high >> 3) << 31 | exponent | (high & 3) << 23 | low << 19
}

fn other(first: u16, second: u16, sd: u8, sm: u8) -> Op {
    let top = second & 0x80 != 0;
    let unary = |op| Op::FloatUnary { op, sd, sm };
    let fixed = |to_fixed: bool, signed: bool| {
        let size = if top { 32 } else { 16 };
        let bits = ((second & 0xF) << 1 | second >> 5 & 1) as u8;
        if bits > size {
            return Op::Undefined;
        }
        Op::FloatFixed { sd, to_fixed, fraction: size - bits, halves: !top, signed }
    };
    match (first & 0xF, top) {
        (0, false) => unary(FloatUnary::Move),
        (0, true) => unary(FloatUnary::Absolute),
        (1, false) => unary(FloatUnary::Negate),
        (1, true) => unary(FloatUnary::SquareRoot),
        (4, _) => Op::FloatCompare { sd, sm: Some(sm) },
        (5, _) if second & 0x2F == 0 => Op::FloatCompare { sd, sm: None },
        (8, false) => unary(FloatUnary::FromUnsigned),
        (8, true) => unary(FloatUnary::FromSigned),
        (0xA, _) => fixed(false, true),
        (0xB, _) => fixed(false, false),
        (0xC, to_zero) => unary(FloatUnary::ToUnsigned(to_zero)),
        (0xD, to_zero) => unary(FloatUnary::ToSigned(to_zero)),
        (0xE, _) => fixed(true, true),
        (0xF, _) => fixed(true, false),
        _ => Op::Undefined,
    }
}
