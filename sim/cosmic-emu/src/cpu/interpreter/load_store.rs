//! Loads and stores.

use super::operands::{Address, Reg, Width};
use super::{Interpreter, PC};
use crate::cpu::{AccessKind, CpuFault, Stop};

impl Interpreter {
    #[inline]
    pub(super) fn get(&self, register: Reg) -> u32 {
        self.r[usize::from(register & 15)]
    }

    /// Writes a register; writing R15 is a branch without a change of state.
    #[inline]
    pub(super) fn set(&mut self, register: Reg, value: u32) {
        self.r[usize::from(register & 15)] = value;
        if usize::from(register) == PC {
            self.next = value & !1;
        }
    }

    /// A branch by BX, or by a load to R15.
    pub(super) fn branch_exchange(&mut self, target: u32) -> Result<(), Stop> {
        const EXC_RETURN: u32 = 0xF000_0000;
        if self.ipsr != 0 && target >= EXC_RETURN {
            return Err(Stop::ExceptionReturn(target));
        }
        if target & 1 == 0 {
            return Err(Stop::Fault(CpuFault::NotThumb { target }));
        }
        self.next = target & !1;
        Ok(())
    }

    /// The address of an access, and what is to be written to the base afterwards.
    #[inline]
    fn address(&self, address: Address) -> (u32, Option<(Reg, u32)>) {
        match address {
            Address::Offset(rn, offset) => (self.get(rn).wrapping_add_signed(offset), None),
            Address::Register(rn, rm, shift) => (self.get(rn).wrapping_add(self.get(rm) << shift), None),
            Address::PreIndexed(rn, offset) => {
                let address = self.get(rn).wrapping_add_signed(offset);
                (address, Some((rn, address)))
            }
            Address::PostIndexed(rn, offset) => {
                let address = self.get(rn);
                (address, Some((rn, address.wrapping_add_signed(offset))))
            }
            Address::Literal(offset) => ((self.r[PC] & !3).wrapping_add_signed(offset), None),
        }
    }

    fn write_back(&mut self, base: Option<(Reg, u32)>) {
        if let Some((rn, value)) = base {
            self.set(rn, value);
        }
    }

    #[inline]
    pub(super) fn load(&mut self, rt: Reg, address: Address, width: Width) -> Result<(), Stop> {
        let (address, base) = self.address(address);
        let raw = self.memory.load(address, width.bytes())?;
        let value = match width {
            Width::SignedByte => raw as i8 as u32,
            Width::SignedHalf => raw as i16 as u32,
            _ => raw,
        };
        self.write_back(base);
        if usize::from(rt) == PC {
            return self.branch_exchange(value);
        }
        self.set(rt, value);
        Ok(())
    }

    #[inline]
    pub(super) fn store(&mut self, rt: Reg, address: Address, width: Width) -> Result<(), Stop> {
        let (address, base) = self.address(address);
        self.memory.store(address, width.bytes(), self.get(rt))?;
        self.write_back(base);
        Ok(())
    }

    pub(super) fn load_dual(&mut self, rt: Reg, rt2: Reg, address: Address) -> Result<(), Stop> {
        let (address, base) = self.address(address);
        aligned(address, AccessKind::Read)?;
        let (low, high) = (self.memory.load(address, 4)?, self.memory.load(address.wrapping_add(4), 4)?);
        self.write_back(base);
        self.set(rt, low);
        self.set(rt2, high);
        Ok(())
    }

    pub(super) fn store_dual(&mut self, rt: Reg, rt2: Reg, address: Address) -> Result<(), Stop> {
        let (address, base) = self.address(address);
        aligned(address, AccessKind::Write)?;
        self.memory.store(address, 4, self.get(rt))?;
        self.memory.store(address.wrapping_add(4), 4, self.get(rt2))?;
        self.write_back(base);
        Ok(())
    }

    /// The first address of a block of words, and the base afterwards.
    fn block(&self, rn: Reg, words: u32, decrement: bool) -> (u32, u32) {
        let base = self.get(rn);
        if decrement {
            let first = base.wrapping_sub(4 * words);
            (first, first)
        } else {
            (base, base.wrapping_add(4 * words))
        }
    }

    pub(super) fn load_multiple(
        &mut self,
        rn: Reg,
        list: u16,
        write_back: bool,
        decrement: bool,
    ) -> Result<(), Stop> {
        let (mut address, after) = self.block(rn, list.count_ones(), decrement);
        aligned(address, AccessKind::Read)?;
        let mut target = None;
        let mut loaded = self.r;
        for register in (0..16).filter(|register| list >> register & 1 != 0) {
            let value = self.memory.load(address, 4)?;
            address = address.wrapping_add(4);
            if register == PC { target = Some(value) } else { loaded[register] = value }
        }
        if write_back {
            loaded[usize::from(rn & 15)] = after;
        }
        self.r = loaded;
        target.map_or(Ok(()), |target| self.branch_exchange(target))
    }

    pub(super) fn store_multiple(
        &mut self,
        rn: Reg,
        list: u16,
        write_back: bool,
        decrement: bool,
    ) -> Result<(), Stop> {
        let (mut address, after) = self.block(rn, list.count_ones(), decrement);
        aligned(address, AccessKind::Write)?;
        for register in (0..16).filter(|register| list >> register & 1 != 0) {
            self.memory.store(address, 4, self.r[register])?;
            address = address.wrapping_add(4);
        }
        if write_back {
            self.set(rn, after);
        }
        Ok(())
    }

    pub(super) fn load_exclusive(&mut self, rt: Reg, rn: Reg, offset: u16, width: Width) -> Result<(), Stop> {
        let address = self.get(rn).wrapping_add(offset.into());
        let value = self.memory.load(address, width.bytes())?;
        self.exclusive = Some(address);
        self.set(rt, value);
        Ok(())
    }

    pub(super) fn store_exclusive(
        &mut self,
        rd: Reg,
        rt: Reg,
        rn: Reg,
        offset: u16,
        width: Width,
    ) -> Result<(), Stop> {
        let address = self.get(rn).wrapping_add(offset.into());
        let is_open = self.exclusive.take() == Some(address);
        if is_open {
            self.memory.store(address, width.bytes(), self.get(rt))?;
        }
        self.set(rd, (!is_open).into());
        Ok(())
    }

    pub(super) fn table_branch(&mut self, rn: Reg, rm: Reg, halves: bool) -> Result<(), Stop> {
        let (base, index) = (self.get(rn), self.get(rm));
        let entry = if halves {
            self.memory.load(base.wrapping_add(index << 1), 2)?
        } else {
            self.memory.load(base.wrapping_add(index), 1)?
        };
        self.next = self.r[PC].wrapping_add(entry * 2);
        Ok(())
    }

    pub(super) fn float_load(&mut self, first: u8, count: u8, address: Address) -> Result<(), Stop> {
        let (address, _) = self.address(address);
        self.load_floats(first, count, address)
    }

    pub(super) fn float_store(&mut self, first: u8, count: u8, address: Address) -> Result<(), Stop> {
        let (address, _) = self.address(address);
        self.store_floats(first, count, address)
    }

    /// VLDM and VSTM: register, base, whether it changes, direction.
    pub(super) fn float_multiple(
        &mut self,
        rn: Reg,
        registers: (u8, u8),
        write_back: bool,
        decrement: bool,
        load: bool,
    ) -> Result<(), Stop> {
        let (first, count) = registers;
        let (address, after) = self.block(rn, count.into(), decrement);
        if load {
            self.load_floats(first, count, address)?;
        } else {
            self.store_floats(first, count, address)?;
        }
        if write_back {
            self.set(rn, after);
        }
        Ok(())
    }

    fn load_floats(&mut self, first: u8, count: u8, mut address: u32) -> Result<(), Stop> {
        aligned(address, AccessKind::Read)?;
        for register in first..first + count {
            self.s[usize::from(register & 31)] = self.memory.load(address, 4)?;
            address = address.wrapping_add(4);
        }
        Ok(())
    }

    fn store_floats(&mut self, first: u8, count: u8, mut address: u32) -> Result<(), Stop> {
        aligned(address, AccessKind::Write)?;
        for register in first..first + count {
            self.memory.store(address, 4, self.s[usize::from(register & 31)])?;
            address = address.wrapping_add(4);
        }
        Ok(())
    }
}

/// Multiple, dual and floating point accesses must be aligned (A3.2.1).
fn aligned(address: u32, access: AccessKind) -> Result<(), CpuFault> {
    if address.is_multiple_of(4) { Ok(()) } else { Err(CpuFault::Unaligned { access, address }) }
}
