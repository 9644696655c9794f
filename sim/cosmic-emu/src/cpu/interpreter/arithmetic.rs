//! Integer arithmetic of the core, as functions (ARMv7-M ARM, A2.2 and D6.4).

use super::operands::{Extend, Parallel, ParallelKind, Shape, Shift, Unary};

/// Sum, carry and overflow.
#[inline]
pub(super) const fn add_with_carry(a: u32, b: u32, carry: bool) -> (u32, bool, bool) {
    let wide = a as u64 + b as u64 + carry as u64;
    let sum = wide as u32;
    let overflow = (a ^ sum) & (b ^ sum) & 1 << 31 != 0;
    (sum, wide >> 32 != 0, overflow)
}

/// Shifts, and tells the carry out; an amount of 0 changes nothing.
#[inline]
pub(super) const fn shift(value: u32, kind: Shift, amount: u32, carry: bool) -> (u32, bool) {
    if amount == 0 {
        return (value, carry);
    }
    match kind {
        Shift::Left => {
            let wide = if amount > 32 { 0 } else { (value as u64) << amount };
            (wide as u32, wide >> 32 & 1 != 0)
        }
        Shift::LogicalRight => {
            let wide = if amount > 32 { 0 } else { ((value as u64) << 32) >> amount };
            ((wide >> 32) as u32, wide >> 31 & 1 != 0)
        }
        Shift::ArithmeticRight => {
            let amount = if amount > 32 { 32 } else { amount };
            let wide = (((value as u64) << 32) as i64 >> amount) as u64;
            ((wide >> 32) as u32, wide >> 31 & 1 != 0)
        }
        Shift::RotateRight => {
            let result = value.rotate_right(amount & 31);
            (result, result >> 31 != 0)
        }
        Shift::RotateExtended => (value >> 1 | (carry as u32) << 31, value & 1 != 0),
    }
}

pub(super) const fn unary(op: Unary, value: u32) -> u32 {
    match op {
        Unary::ReverseBytes => value.swap_bytes(),
        Unary::ReverseBytes16 => value.swap_bytes().rotate_left(16),
        Unary::ReverseSignedHalf => (value as u16).swap_bytes() as i16 as u32,
        Unary::ReverseBits => value.reverse_bits(),
        Unary::CountLeadingZeros => value.leading_zeros(),
    }
}

/// Extends a rotated value, and adds it; to each half if there are two.
pub(super) const fn extend(kind: Extend, addend: u32, value: u32) -> u32 {
    match kind {
        Extend::SignedByte => addend.wrapping_add(value as i8 as u32),
        Extend::UnsignedByte => addend.wrapping_add(value as u8 as u32),
        Extend::SignedHalf => addend.wrapping_add(value as i16 as u32),
        Extend::UnsignedHalf => addend.wrapping_add(value as u16 as u32),
        Extend::SignedBytes16 => halves_sum(addend, value as i8 as u32, (value >> 16) as i8 as u32),
        Extend::UnsignedBytes16 => halves_sum(addend, value & 0xFF, value >> 16 & 0xFF),
    }
}

const fn halves_sum(addend: u32, low: u32, high: u32) -> u32 {
    (addend & 0xFFFF).wrapping_add(low) & 0xFFFF | (addend >> 16).wrapping_add(high) << 16
}

/// The low or the high half, with its sign.
pub(super) const fn half(value: u32, top: bool) -> i32 {
    if top { value as i32 >> 16 } else { value as i16 as i32 }
}

/// Both products of halves, the second factor's halves exchanged or not.
pub(super) const fn dual(n: u32, m: u32, subtract: bool, swap: bool) -> i64 {
    let m = if swap { m.rotate_left(16) } else { m };
    let (low, high) =
        (half(n, false) as i64 * half(m, false) as i64, half(n, true) as i64 * half(m, true) as i64);
    if subtract { low - high } else { low + high }
}

/// The sum of the absolute differences of the four bytes.
pub(super) fn sum_of_differences(n: u32, m: u32) -> u32 {
    let pairs = n.to_le_bytes().into_iter().zip(m.to_le_bytes());
    pairs.map(|(n, m)| u32::from(n.abs_diff(m))).sum()
}

/// Saturates to signed or unsigned numbers of so many bits; tells if that changed it.
pub(super) fn saturate(value: i64, bits: u8, signed: bool) -> (u32, bool) {
    let (least, most) =
        if signed { (-(1_i64 << (bits - 1)), (1_i64 << (bits - 1)) - 1) } else { (0, (1_i64 << bits) - 1) };
    let kept = value.clamp(least, most);
    (kept as u32, kept != value)
}

/// Parallel addition or subtraction, and the GE flags of the plain ones.
pub(super) fn parallel(op: Parallel, n: u32, m: u32) -> (u32, u8) {
    let (bits, lanes) = match op.shape {
        Shape::Add8 | Shape::Sub8 => (8, 4),
        _ => (16, 2),
    };
    let lane = |value: u32, at: u32| {
        let raw = value >> (at * bits) & ((1 << bits) - 1);
        if op.signed { i64::from((raw << (32 - bits)) as i32 >> (32 - bits)) } else { i64::from(raw) }
    };
    let (mut result, mut flags) = (0, 0);
    for at in 0..lanes {
        let (other, subtracts) = match op.shape {
            Shape::Add8 | Shape::Add16 => (at, false),
            Shape::Sub8 | Shape::Sub16 => (at, true),
            Shape::AddSubtractExchange => (1 - at, at == 0),
            Shape::SubtractAddExchange => (1 - at, at == 1),
        };
        let (n, m) = (lane(n, at), lane(m, other));
        let value = if subtracts { n - m } else { n + m };
        let kept = match op.kind {
            ParallelKind::Plain => value as u32,
            ParallelKind::Saturating => saturate(value, bits as u8, op.signed).0,
            ParallelKind::Halving => (value >> 1) as u32,
        };
        result |= (kept & ((1 << bits) - 1)) << (at * bits);
        let is_set = if op.signed || subtracts { value >= 0 } else { value >= 1 << bits };
        if is_set {
            flags |= if lanes == 4 { 1 << at } else { 0b11 << (2 * at) };
        }
    }
    (result, flags)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn carries_and_overflows() {
        assert_eq!(add_with_carry(u32::MAX, 0, true), (0, true, false));
        assert_eq!(add_with_carry(0x7FFF_FFFF, 1, false), (0x8000_0000, false, true));
        assert_eq!(add_with_carry(5, !5, true), (0, true, false));
    }

    #[test]
    fn shifts_by_all_amounts() {
        assert_eq!(shift(0x8000_0001, Shift::Left, 1, false), (2, true));
        assert_eq!(shift(1, Shift::Left, 32, false), (0, true));
        assert_eq!(shift(1, Shift::Left, 33, true), (0, false));
        assert_eq!(shift(0x8000_0000, Shift::LogicalRight, 32, false), (0, true));
        assert_eq!(shift(0x8000_0000, Shift::ArithmeticRight, 200, false), (u32::MAX, true));
        assert_eq!(shift(1, Shift::RotateRight, 1, false), (0x8000_0000, true));
        assert_eq!(shift(7, Shift::RotateRight, 32, true), (7, false));
        assert_eq!(shift(2, Shift::RotateExtended, 1, true), (0x8000_0001, false));
        assert_eq!(shift(7, Shift::Left, 0, true), (7, true));
    }

    #[test]
    fn parallel_lanes() {
        let op = |shape, kind, signed| Parallel { shape, kind, signed };
        let add = parallel(op(Shape::Add8, ParallelKind::Saturating, false), 0xFF01_80FE, 0x0101_8003);
        assert_eq!(add.0, 0xFF02_FFFF);
        assert_eq!(parallel(op(Shape::Sub16, ParallelKind::Plain, true), 0x0001_0005, 0x0002_0005).1, 0b0011);
    }
}
