//! What instructions do.

use super::arithmetic::{self, add_with_carry, dual, half};
use super::op::Op;
use super::operands::{Accumulate, Alu, Binary, CarryOut, Flags, Long, Operand, Reg, Shift};
use super::{CONTROL_FPCA, Interpreter, LR, PC, float};
use crate::cpu::{CpuFault, Stop};

impl Interpreter {
    /// Performs an instruction; `self.next` is where execution goes on. This is the one large function:
    /// a jump table over all operations, each of which is done elsewhere.
    #[inline]
    pub(super) fn perform(&mut self, slot: usize, outside_it: bool) -> Result<(), Stop> {
        // Matched in place: a copy would have to go through memory.
        match self.decoded[slot].op {
            Op::Alu { op, rd, rn, operand, flags } => self.alu(op, rd, rn, operand, sets(flags, outside_it)),
            Op::Test { op, rn, operand } => self.test(op, rn, operand),
            Op::Load { rt, address, width } => return self.load(rt, address, width),
            Op::Store { rt, address, width } => return self.store(rt, address, width),
            Op::Branch { offset } => self.next = self.r[PC].wrapping_add_signed(offset),
            Op::BranchIf { condition, offset } => {
                let target = self.r[PC].wrapping_add_signed(offset);
                self.next = if self.flags.pass(condition) { target } else { self.next };
            }
            Op::CompareBranch { rn, offset, if_zero } => {
                let target = self.r[PC].wrapping_add_signed(offset);
                self.next = if (self.get(rn) == 0) == if_zero { target } else { self.next };
            }
            Op::Common(op) => return self.common(op),
            Op::BranchLink { offset } => {
                self.r[LR] = self.next | 1;
                self.next = self.r[PC].wrapping_add_signed(offset);
            }
            Op::BranchExchange { rm } => return self.branch_exchange(self.get(rm)),
            Op::BranchLinkExchange { rm } => {
                let target = self.get(rm);
                self.r[LR] = self.next | 1;
                return self.branch_exchange(target);
            }
            Op::IfThen(state) => self.it = state,
            Op::PcRelative { rd, offset } => self.set(rd, (self.r[PC] & !3).wrapping_add_signed(offset)),
            Op::MoveTop { rd, value } => self.set(rd, self.get(rd) & 0xFFFF | u32::from(value) << 16),
            Op::Extend { extend, rd, rn, rm, rotation } => {
                let addend = if usize::from(rn) == PC { 0 } else { self.get(rn) };
                let value = self.get(rm).rotate_right(rotation.into());
                self.set(rd, arithmetic::extend(extend, addend, value));
            }
            Op::Unary { op, rd, rm } => self.set(rd, arithmetic::unary(op, self.get(rm))),
            Op::Binary { op, rd, rn, rm, flags } => self.binary(op, rd, rn, rm, sets(flags, outside_it)),
            Op::Accumulate { op, rd, rn, rm, ra } => self.accumulate(op, rd, rn, rm, ra),
            Op::Long { op, low, high, rn, rm } => self.long(op, low, high, self.get(rn), self.get(rm)),
            Op::ExtractField { rd, rn, lsb, width, signed } => {
                let unused = 32 - u32::from(width).min(32);
                let value = self.get(rn) >> lsb << unused;
                self.set(rd, if signed { (value as i32 >> unused) as u32 } else { value >> unused });
            }
            Op::InsertField { rd, rn, lsb, width } => {
                let mask = u32::MAX >> (32 - u32::from(width)) << lsb;
                let source = if usize::from(rn) == PC { 0 } else { self.get(rn) << lsb };
                self.set(rd, self.get(rd) & !mask | source & mask);
            }
            Op::LoadDual { rt, rt2, address } => return self.load_dual(rt, rt2, address),
            Op::StoreDual { rt, rt2, address } => return self.store_dual(rt, rt2, address),
            Op::LoadMultiple { rn, list, write_back, decrement } => {
                return self.load_multiple(rn, list, write_back, decrement);
            }
            Op::StoreMultiple { rn, list, write_back, decrement } => {
                return self.store_multiple(rn, list, write_back, decrement);
            }
            Op::LoadExclusive { rt, rn, offset, width } => return self.load_exclusive(rt, rn, offset, width),
            Op::StoreExclusive { rd, rt, rn, offset, width } => {
                return self.store_exclusive(rd, rt, rn, offset, width);
            }
            Op::ClearExclusive => self.exclusive = None,
            Op::TableBranch { rn, rm, halves } => return self.table_branch(rn, rm, halves),
            Op::Saturate { rd, rn, bits, shift, amount, signed } => {
                let (value, _) = arithmetic::shift(self.get(rn), shift, amount.into(), false);
                self.saturate(rd, value, bits, signed);
            }
            Op::SaturateHalves { rd, rn, bits, signed } => self.saturate_halves(rd, rn, bits, signed),
            Op::ChangeMasks { disable, primask, faultmask } => self.change_masks(disable, primask, faultmask),
            Op::MoveToSpecial { rn, special, mask } => self.write_special(special, mask, self.get(rn)),
            Op::MoveFromSpecial { rd, special } => self.set(rd, self.read_special(special)),
            Op::WaitForInterrupt => return Err(Stop::WaitForInterrupt),
            Op::WaitForEvent => return Err(Stop::WaitForEvent),
            Op::SendEvent => return Err(Stop::SendEvent),
            Op::SupervisorCall => return Err(Stop::SupervisorCall),
            Op::Spin { instructions, cycles, is_branch } => {
                if is_branch {
                    self.next = self.r[PC].wrapping_sub(4);
                }
                if outside_it {
                    self.pace.spin(instructions.into(), cycles.into());
                }
            }
            Op::Nop => {}
            Op::Unknown | Op::Undefined => return Err(Stop::Fault(CpuFault::Undefined)),
            Op::Breakpoint(immediate) => return Err(Stop::Breakpoint(immediate)),
            op => return self.float(op),
        }
        Ok(())
    }

    /// The floating point instructions; the first one makes the task a user of the unit.
    fn float(&mut self, op: Op) -> Result<(), Stop> {
        if self.control & CONTROL_FPCA == 0 {
            // A new floating point context starts with the default FPSCR (A2.5.5).
            self.control |= CONTROL_FPCA;
            self.fpscr = 0;
        }
        let s = |core: &Self, register: u8| f32::from_bits(core.s[usize::from(register & 31)]);
        match op {
            Op::FloatBinary { op, sd, sn, sm } => {
                let result = float::binary(op, s(self, sd), s(self, sn), s(self, sm));
                self.set_float(sd, result.to_bits());
            }
            Op::FloatUnary { op, sd, sm } => {
                self.set_float(sd, float::unary(op, self.s[usize::from(sm & 31)], self.fpscr));
            }
            Op::FloatConstant { sd, bits } => self.set_float(sd, bits),
            Op::FloatCompare { sd, sm } => {
                let flags = float::compare(s(self, sd), sm.map_or(0.0, |sm| s(self, sm)));
                self.fpscr = self.fpscr & !float::FLAGS | flags;
            }
            Op::FloatFixed { sd, to_fixed, fraction, halves, signed } => {
                let bits = self.s[usize::from(sd & 31)];
                self.set_float(sd, float::fixed(bits, to_fixed, fraction, halves, signed));
            }
            Op::FloatLoad { first, count, address } => return self.float_load(first, count, address),
            Op::FloatStore { first, count, address } => return self.float_store(first, count, address),
            Op::FloatMultiple { rn, first, count, write_back, decrement, load } => {
                return self.float_multiple(rn, (first, count), write_back, decrement, load);
            }
            Op::FloatMove { rt, sn, to_core: true } => self.set(rt, self.s[usize::from(sn & 31)]),
            Op::FloatMove { rt, sn, to_core: false } => self.set_float(sn, self.get(rt)),
            Op::FloatMovePair { rt, rt2, first, to_core: true } => {
                self.set(rt, self.s[usize::from(first & 31)]);
                self.set(rt2, self.s[usize::from((first + 1) & 31)]);
            }
            Op::FloatMovePair { rt, rt2, first, to_core: false } => {
                self.set_float(first, self.get(rt));
                self.set_float(first + 1, self.get(rt2));
            }
            Op::FloatStatus { rt, to_core: true } if usize::from(rt) == PC => {
                let ge_and_q = super::Flags { n: false, z: false, c: false, v: false, ..self.flags };
                self.flags = super::Flags::from_xpsr(self.fpscr & float::FLAGS | ge_and_q.to_xpsr());
            }
            Op::FloatStatus { rt, to_core: true } => self.set(rt, self.fpscr),
            Op::FloatStatus { rt, to_core: false } => self.fpscr = self.get(rt),
            _ => {}
        }
        Ok(())
    }

    fn set_float(&mut self, register: u8, bits: u32) {
        self.s[usize::from(register & 31)] = bits;
    }

    /// The second operand, and the carry out of its shift.
    #[inline(always)]
    fn operand(&self, operand: Operand) -> (u32, bool) {
        let carry = self.flags.c;
        match operand {
            Operand::Constant(value, CarryOut::Unchanged) => (value, carry),
            Operand::Constant(value, out) => (value, out == CarryOut::Set),
            Operand::Register(rm) => (self.get(rm), carry),
            Operand::Shifted(rm, kind, amount) => arithmetic::shift(self.get(rm), kind, amount.into(), carry),
            Operand::ShiftedBy(rm, kind, rs) => {
                arithmetic::shift(self.get(rm), kind, self.get(rs) & 0xFF, carry)
            }
        }
    }

    #[inline(always)]
    fn alu(&mut self, op: Alu, rd: Reg, rn: Reg, operand: Operand, sets_flags: bool) {
        let (m, shifter_carry) = self.operand(operand);
        let n = self.get(rn);
        let (result, carry, overflow) = match op {
            Alu::Add => add_with_carry(n, m, false),
            Alu::Adc => add_with_carry(n, m, self.flags.c),
            Alu::Sub => add_with_carry(n, !m, true),
            Alu::Sbc => add_with_carry(n, !m, self.flags.c),
            Alu::Rsb => add_with_carry(!n, m, true),
            Alu::And => (n & m, shifter_carry, self.flags.v),
            Alu::Eor => (n ^ m, shifter_carry, self.flags.v),
            Alu::Orr => (n | m, shifter_carry, self.flags.v),
            Alu::Orn => (n | !m, shifter_carry, self.flags.v),
            Alu::Bic => (n & !m, shifter_carry, self.flags.v),
            Alu::Mov => (m, shifter_carry, self.flags.v),
            Alu::Mvn => (!m, shifter_carry, self.flags.v),
        };
        if sets_flags {
            self.set_flags(result, carry, overflow);
        }
        self.set(rd, result);
    }

    fn set_flags(&mut self, result: u32, carry: bool, overflow: bool) {
        self.flags.n = result >> 31 != 0;
        self.flags.z = result == 0;
        self.flags.c = carry;
        self.flags.v = overflow;
    }

    #[inline]
    fn test(&mut self, op: Alu, rn: Reg, operand: Operand) {
        let (m, shifter_carry) = self.operand(operand);
        let n = self.get(rn);
        let (result, carry, overflow) = match op {
            Alu::Add => add_with_carry(n, m, false),
            Alu::Sub => add_with_carry(n, !m, true),
            Alu::Eor => (n ^ m, shifter_carry, self.flags.v),
            _ => (n & m, shifter_carry, self.flags.v),
        };
        self.set_flags(result, carry, overflow);
    }

    fn binary(&mut self, op: Binary, rd: Reg, rn: Reg, rm: Reg, sets_flags: bool) {
        let (n, m) = (self.get(rn), self.get(rm));
        let doubled = |core: &mut Self| core.saturated(i64::from(n as i32) * 2);
        let result = match op {
            Binary::Multiply => n.wrapping_mul(m),
            // Division by zero gives zero (CCR.DIV_0_TRP is clear).
            Binary::SignedDivide => {
                (n as i32).checked_div(m as i32).map_or(if m == 0 { 0 } else { n }, |q| q as u32)
            }
            Binary::UnsignedDivide => n.checked_div(m).unwrap_or(0),
            // The operands of these stand the other way round.
            Binary::Qadd => self.saturated(i64::from(m as i32) + i64::from(n as i32)),
            Binary::Qsub => self.saturated(i64::from(m as i32) - i64::from(n as i32)),
            Binary::Qdadd => {
                let twice = doubled(self) as i32;
                self.saturated(i64::from(m as i32) + i64::from(twice))
            }
            Binary::Qdsub => {
                let twice = doubled(self) as i32;
                self.saturated(i64::from(m as i32) - i64::from(twice))
            }
            Binary::Select => {
                let mask = (0..4)
                    .fold(0, |mask, lane| mask | (u32::from(self.flags.ge >> lane & 1) * 0xFF) << (8 * lane));
                n & mask | m & !mask
            }
            Binary::MultiplyHalves(top_n, top_m) => half(n, top_n).wrapping_mul(half(m, top_m)) as u32,
            Binary::MultiplyWordHalf(top) => ((i64::from(n as i32) * i64::from(half(m, top))) >> 16) as u32,
            Binary::MultiplyDual { subtract, swap } => {
                let sum = dual(n, m, subtract, swap);
                self.flags.q |= i64::from(sum as i32) != sum;
                sum as u32
            }
            Binary::MultiplyHigh(round) => high_word(i64::from(n as i32) * i64::from(m as i32), round),
            Binary::SumOfDifferences => arithmetic::sum_of_differences(n, m),
            Binary::Pack { top: false, shift } => pack_bottom(n, m, shift),
            Binary::Pack { top: true, shift } => {
                let amount = if shift == 0 { 32 } else { u32::from(shift) };
                let (shifted, _) = arithmetic::shift(m, Shift::ArithmeticRight, amount, false);
                n & 0xFFFF_0000 | shifted & 0xFFFF
            }
            Binary::Parallel(op) => {
                let (result, flags) = arithmetic::parallel(op, n, m);
                if op.kind == super::operands::ParallelKind::Plain {
                    self.flags.ge = flags;
                }
                result
            }
        };
        if sets_flags {
            self.set_flags(result, self.flags.c, self.flags.v);
        }
        self.set(rd, result);
    }

    fn accumulate(&mut self, op: Accumulate, rd: Reg, rn: Reg, rm: Reg, ra: Reg) {
        let (n, m, a) = (self.get(rn), self.get(rm), self.get(ra));
        let product = i64::from(n as i32) * i64::from(m as i32);
        let high_accumulator = i64::from(a as i32) << 32;
        let result = match op {
            Accumulate::Add => a.wrapping_add(n.wrapping_mul(m)),
            Accumulate::Subtract => a.wrapping_sub(n.wrapping_mul(m)),
            Accumulate::Halves(top_n, top_m) => {
                self.overflowing(i64::from(half(n, top_n)) * i64::from(half(m, top_m)) + i64::from(a as i32))
            }
            Accumulate::WordHalf(top) => self
                .overflowing(((i64::from(n as i32) * i64::from(half(m, top))) >> 16) + i64::from(a as i32)),
            Accumulate::Dual { subtract, swap } => {
                self.overflowing(dual(n, m, subtract, swap) + i64::from(a as i32))
            }
            Accumulate::HighAdd(round) => high_word(high_accumulator.wrapping_add(product), round),
            Accumulate::HighSubtract(round) => high_word(high_accumulator.wrapping_sub(product), round),
            Accumulate::SumOfDifferences => a.wrapping_add(arithmetic::sum_of_differences(n, m)),
        };
        self.set(rd, result);
    }

    fn long(&mut self, op: Long, low: Reg, high: Reg, n: u32, m: u32) {
        let before = u64::from(self.get(high)) << 32 | u64::from(self.get(low));
        let signed = (i64::from(n as i32) * i64::from(m as i32)) as u64;
        let unsigned = u64::from(n) * u64::from(m);
        let result = match op {
            Long::Signed => signed,
            Long::Unsigned => unsigned,
            Long::SignedAccumulate => before.wrapping_add(signed),
            Long::UnsignedAccumulate => before.wrapping_add(unsigned),
            // Cannot overflow: (2^32 - 1)^2 + 2 * (2^32 - 1) = 2^64 - 1.
            Long::UnsignedAccumulateAccumulate => {
                unsigned.wrapping_add(before >> 32).wrapping_add(before & 0xFFFF_FFFF)
            }
            Long::Halves(top_n, top_m) => {
                before.wrapping_add_signed(i64::from(half(n, top_n)) * i64::from(half(m, top_m)))
            }
            Long::Dual { subtract, swap } => before.wrapping_add_signed(dual(n, m, subtract, swap)),
        };
        self.set(low, result as u32);
        self.set(high, (result >> 32) as u32);
    }

    /// To 32 bits; sets Q if that changes the value.
    fn saturated(&mut self, value: i64) -> u32 {
        let (kept, changed) = arithmetic::saturate(value, 32, true);
        self.flags.q |= changed;
        kept
    }

    /// The low word; sets Q if it does not hold the value.
    fn overflowing(&mut self, value: i64) -> u32 {
        self.flags.q |= i64::from(value as i32) != value;
        value as u32
    }

    fn saturate(&mut self, rd: Reg, value: u32, bits: u8, signed: bool) {
        let (kept, changed) = arithmetic::saturate(i64::from(value as i32), bits, signed);
        self.flags.q |= changed;
        self.set(rd, kept);
    }

    fn saturate_halves(&mut self, rd: Reg, rn: Reg, bits: u8, signed: bool) {
        let value = self.get(rn);
        let (low, low_changed) = arithmetic::saturate(half(value, false).into(), bits, signed);
        let (high, high_changed) = arithmetic::saturate(half(value, true).into(), bits, signed);
        self.flags.q |= low_changed || high_changed;
        self.set(rd, high << 16 | low & 0xFFFF);
    }
}

const fn sets(flags: Flags, outside_it: bool) -> bool {
    match flags {
        Flags::Keep => false,
        Flags::Set => true,
        Flags::SetOutsideIt => outside_it,
    }
}

const fn high_word(value: i64, round: bool) -> u32 {
    let value = if round { value.wrapping_add(0x8000_0000) } else { value };
    (value >> 32) as u32
}

/// The low half of the first operand below the high half of the shifted second one.
const fn pack_bottom(n: u32, m: u32, shift: u8) -> u32 {
    n & 0xFFFF | m << shift & 0xFFFF_0000
}
