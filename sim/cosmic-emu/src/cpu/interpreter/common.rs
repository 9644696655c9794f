//! The most frequent instructions in forms of their own.
//!
//! Firmware that sleeps most of the time runs mostly cold code, so the host mispredicts nearly every
//! branch of the interpreter. In the general forms an instruction takes several: its operation, the kind of
//! its operand, whether it sets flags. Here all that is one decision.

use super::Interpreter;
use super::operands::Reg;
use crate::cpu::Stop;

/// An instruction whose registers are not R15.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Common {
    LoadWord {
        rt: Reg,
        rn: Reg,
        offset: i32,
    },
    LoadByte {
        rt: Reg,
        rn: Reg,
        offset: i32,
    },
    StoreWord {
        rt: Reg,
        rn: Reg,
        offset: i32,
    },
    StoreByte {
        rt: Reg,
        rn: Reg,
        offset: i32,
    },
    Move {
        rd: Reg,
        rm: Reg,
    },
    MoveConstant {
        rd: Reg,
        value: u32,
    },
    /// Keeps the flags; a subtraction is the addition of the complement.
    AddConstant {
        rd: Reg,
        rn: Reg,
        value: u32,
    },
    Add {
        rd: Reg,
        rn: Reg,
        rm: Reg,
    },
    Or {
        rd: Reg,
        rn: Reg,
        rm: Reg,
    },
    And {
        rd: Reg,
        rn: Reg,
        value: u32,
    },
    CompareConstant {
        rn: Reg,
        value: u32,
    },
    Compare {
        rn: Reg,
        rm: Reg,
    },
}

impl Interpreter {
    #[inline(always)]
    pub(super) fn common(&mut self, op: Common) -> Result<(), Stop> {
        match op {
            Common::LoadWord { rt, rn, offset } => {
                let value = self.memory.load(self.get(rn).wrapping_add_signed(offset), 4)?;
                self.put(rt, value);
            }
            Common::LoadByte { rt, rn, offset } => {
                let value = self.memory.load(self.get(rn).wrapping_add_signed(offset), 1)?;
                self.put(rt, value);
            }
            Common::StoreWord { rt, rn, offset } => {
                self.memory.store(self.get(rn).wrapping_add_signed(offset), 4, self.get(rt))?;
            }
            Common::StoreByte { rt, rn, offset } => {
                self.memory.store(self.get(rn).wrapping_add_signed(offset), 1, self.get(rt))?;
            }
            Common::Move { rd, rm } => self.put(rd, self.get(rm)),
            Common::MoveConstant { rd, value } => self.put(rd, value),
            Common::AddConstant { rd, rn, value } => self.put(rd, self.get(rn).wrapping_add(value)),
            Common::Add { rd, rn, rm } => self.put(rd, self.get(rn).wrapping_add(self.get(rm))),
            Common::Or { rd, rn, rm } => self.put(rd, self.get(rn) | self.get(rm)),
            Common::And { rd, rn, value } => self.put(rd, self.get(rn) & value),
            Common::CompareConstant { rn, value } => self.compare(self.get(rn), value),
            Common::Compare { rn, rm } => self.compare(self.get(rn), self.get(rm)),
        }
        Ok(())
    }

    /// Writes a register other than R15.
    #[inline(always)]
    fn put(&mut self, register: Reg, value: u32) {
        self.r[usize::from(register & 15)] = value;
    }

    #[inline(always)]
    fn compare(&mut self, n: u32, m: u32) {
        let result = n.wrapping_sub(m);
        self.flags.n = result >> 31 != 0;
        self.flags.z = result == 0;
        self.flags.c = n >= m;
        self.flags.v = (n ^ m) & (n ^ result) & 1 << 31 != 0;
    }
}
