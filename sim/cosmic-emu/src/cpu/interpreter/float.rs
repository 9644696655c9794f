//! Single precision arithmetic (ARMv7-M ARM, A2.5).
//!
//! Results are those of IEEE 754 with rounding to nearest, which is what Rust programs use; the other
//! rounding modes of FPSCR act on conversions to integers only. Flush-to-zero and default NaN mode are
//! not modelled, nor are the cumulative exception flags.

use super::operands::{FloatBinary, FloatUnary};

/// FPSCR: N, Z, C, V.
pub(super) const FLAGS: u32 = 0xF << 28;
const ROUNDING: u32 = 22;

pub(super) fn binary(op: FloatBinary, d: f32, n: f32, m: f32) -> f32 {
    let signed = |value: f32, negate: bool| if negate { -value } else { value };
    match op {
        FloatBinary::Add => n + m,
        FloatBinary::Subtract => n - m,
        FloatBinary::Multiply => n * m,
        FloatBinary::NegatedMultiply => -(n * m),
        FloatBinary::Divide => n / m,
        FloatBinary::MultiplyAccumulate { negate_product, negate_addend } => {
            signed(d, negate_addend) + signed(n * m, negate_product)
        }
        FloatBinary::FusedMultiplyAccumulate { negate_product, negate_addend } => {
            signed(n, negate_product).mul_add(m, signed(d, negate_addend))
        }
    }
}

pub(super) fn unary(op: FloatUnary, bits: u32, fpscr: u32) -> u32 {
    let value = f32::from_bits(bits);
    match op {
        FloatUnary::Move => bits,
        FloatUnary::Absolute => bits & !(1 << 31),
        FloatUnary::Negate => bits ^ 1 << 31,
        FloatUnary::SquareRoot => value.sqrt().to_bits(),
        FloatUnary::FromSigned => (bits as i32 as f32).to_bits(),
        FloatUnary::FromUnsigned => (bits as f32).to_bits(),
        FloatUnary::ToSigned(to_zero) => round(value.into(), to_zero, fpscr) as i32 as u32,
        FloatUnary::ToUnsigned(to_zero) => round(value.into(), to_zero, fpscr) as u32,
    }
}

fn round(value: f64, to_zero: bool, fpscr: u32) -> f64 {
    match (to_zero, fpscr >> ROUNDING & 3) {
        (true, _) | (_, 3) => value.trunc(),
        (_, 0) => value.round_ties_even(),
        (_, 1) => value.ceil(),
        _ => value.floor(),
    }
}

/// To or from a fixed point number with `fraction` bits behind the point, in 16 or 32 bits.
pub(super) fn fixed(bits: u32, to_fixed: bool, fraction: u8, halves: bool, signed: bool) -> u32 {
    let scale = (1_u64 << fraction) as f64;
    if to_fixed {
        let value = (f64::from(f32::from_bits(bits)) * scale).trunc();
        return match (halves, signed) {
            (true, true) => value as i16 as u32,
            (true, false) => (value as u16).into(),
            (false, true) => value as i32 as u32,
            (false, false) => value as u32,
        };
    }
    let value = match (halves, signed) {
        (true, true) => f64::from(bits as i16),
        (true, false) => f64::from(bits as u16),
        (false, true) => f64::from(bits as i32),
        (false, false) => f64::from(bits),
    };
    ((value / scale) as f32).to_bits()
}

/// The flags of a comparison.
pub(super) fn compare(d: f32, m: f32) -> u32 {
    let flags = match d.partial_cmp(&m) {
        Some(core::cmp::Ordering::Equal) => 0b0110,
        Some(core::cmp::Ordering::Less) => 0b1000,
        Some(core::cmp::Ordering::Greater) => 0b0010,
        None => 0b0011,
    };
    flags << 28
}
