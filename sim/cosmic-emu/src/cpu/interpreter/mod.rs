//! The core: an interpreter of the ARMv7E-M instruction set with the FPv4-SP floating point unit.
//!
//! Every instruction of the flash memory is decoded once; executing it is one `match`. That suits
//! microcontroller firmware, which wakes, runs through a few thousand different instructions and sleeps:
//! a translator to host code spends most of its time in caches that such a program never warms, the more
//! so as time must be kept from instruction to instruction.
//!
//! With the feature `unicorn` the tests compare it with the Unicorn emulator, instruction by instruction.

mod arithmetic;
mod common;
mod decode;
mod decode_float;
mod decode_wide;
mod encoding;
mod execute;
mod float;
mod load_store;
mod memory;
mod op;
mod operands;
mod special;
mod specialise;

use std::cell::RefCell;
use std::rc::Rc;

use super::cycles::cycles;
use super::{AccessKind, Cpu, CpuFault, Io, NoMemory, Pace, Register, Stop};
use crate::memory::Region;
use memory::{Block, Memory};
use op::Op;

const SP: usize = 13;
const LR: usize = 14;
const PC: usize = 15;
const CONTROL_SPSEL: u32 = 1 << 1;
const CONTROL_FPCA: u32 = 1 << 2;
const THUMB: u32 = 1 << 24;

/// A core with its memories.
pub(crate) struct Interpreter {
    /// R0 to R12, the active stack pointer, LR, and the PC as instructions read it.
    r: [u32; 16],
    /// The next instruction to execute.
    pc: u32,
    /// Where execution goes on behind the present instruction.
    next: u32,
    flags: Flags,
    /// ITSTATE.
    it: u8,
    /// The exception number.
    ipsr: u32,
    /// The stack pointer that is not active.
    other_sp: u32,
    control: u32,
    primask: bool,
    faultmask: bool,
    basepri: u8,
    s: [u32; 32],
    fpscr: u32,
    /// The address of the last load-exclusive.
    exclusive: Option<u32>,
    memory: Memory,
    code_base: u32,
    decoded: Vec<Decoded>,
    pace: Rc<Pace>,
}

/// N, Z, C, V, Q and GE.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Flags {
    n: bool,
    z: bool,
    c: bool,
    v: bool,
    q: bool,
    ge: u8,
}

impl Flags {
    fn from_xpsr(xpsr: u32) -> Self {
        let bit = |at: u32| xpsr >> at & 1 != 0;
        Self { n: bit(31), z: bit(30), c: bit(29), v: bit(28), q: bit(27), ge: (xpsr >> 16 & 0xF) as u8 }
    }

    const fn to_xpsr(self) -> u32 {
        (self.n as u32) << 31
            | (self.z as u32) << 30
            | (self.c as u32) << 29
            | (self.v as u32) << 28
            | (self.q as u32) << 27
            | (self.ge as u32) << 16
    }

    /// ConditionPassed (A7.3.1). Looked up, as a host predicts such branches badly.
    #[inline]
    const fn pass(self, condition: u8) -> bool {
        let nzcv = (self.n as u16) << 3 | (self.z as u16) << 2 | (self.c as u16) << 1 | self.v as u16;
        PASSES[(condition & 15) as usize] >> nzcv & 1 != 0
    }
}

/// For each condition the set of flags NZCV with which it passes.
const PASSES: [u16; 16] = {
    let mut passes = [0; 16];
    let mut at = 0;
    while at < 256 {
        let (condition, nzcv) = (at >> 4, at & 15);
        let (n, z, c, v) = (nzcv & 8 != 0, nzcv & 4 != 0, nzcv & 2 != 0, nzcv & 1 != 0);
        let positive = match condition >> 1 {
            0 => z,
            1 => c,
            2 => n,
            3 => v,
            4 => c && !z,
            5 => n == v,
            6 => n == v && !z,
            _ => true,
        };
        if positive != (condition & 1 != 0 && condition != 15) {
            passes[condition] |= 1 << nzcv;
        }
        at += 1;
    }
    passes
};

#[derive(Clone, Copy, Debug)]
struct Decoded {
    op: Op,
    size: u8,
    cycles: u8,
}

impl Decoded {
    fn new(first: u16, second: u16) -> Self {
        let size = if decode::is_wide(first) { 4 } else { 2 };
        Self {
            op: specialise::specialise(decode::decode(first, second)),
            size,
            cycles: cycles(first, second),
        }
    }
}

impl Interpreter {
    /// A core with these memories; all accesses to the `io_regions` go to `io`. The code is expected in
    /// the first of the read-only regions.
    pub(crate) fn new(
        rom: &[(Region, &[u8])],
        ram: &[Region],
        io_regions: &[Region],
        io: &Rc<RefCell<dyn Io>>,
        pace: &Rc<Pace>,
    ) -> Self {
        let block = |region: &Region, erased: u8| Block {
            base: region.base,
            bytes: vec![erased; region.size as usize],
        };
        let mut blocks: Vec<Block> = ram.iter().map(|region| block(region, 0)).collect();
        for (region, content) in rom {
            let mut block = block(region, 0xFF);
            for (byte, content) in block.bytes.iter_mut().zip(*content) {
                *byte = *content;
            }
            blocks.push(block);
        }
        let memory =
            Memory { blocks, writable: ram.len(), io_regions: io_regions.to_vec(), io: Rc::clone(io) };
        let (code_base, code_size) = rom.first().map_or((0, 0), |(region, code)| (region.base, code.len()));
        let unknown = Decoded { op: Op::Unknown, size: 0, cycles: 0 };
        Self {
            r: [0; 16],
            pc: 0,
            next: 0,
            flags: Flags::default(),
            it: 0,
            ipsr: 0,
            other_sp: 0,
            control: 0,
            primask: false,
            faultmask: false,
            basepri: 0,
            s: [0; 32],
            fpscr: 0,
            exclusive: None,
            memory,
            code_base,
            decoded: vec![unknown; code_size.div_ceil(2) + 1],
            pace: Rc::clone(pace),
        }
    }

    /// The slot of [`Self::decoded`] that holds the instruction at `pc`. The last slot is for code outside
    /// of the flash memory, and decoded anew each time.
    #[inline]
    fn fetch(&mut self, pc: u32) -> Result<usize, CpuFault> {
        let slot = (pc.wrapping_sub(self.code_base) / 2) as usize;
        match self.decoded.get(slot) {
            Some(decoded) if decoded.op != Op::Unknown => Ok(slot),
            _ => self.decode(pc, slot.min(self.decoded.len() - 1)),
        }
    }

    #[cold]
    fn decode(&mut self, pc: u32, slot: usize) -> Result<usize, CpuFault> {
        let first =
            self.memory.fetch(pc).ok_or(CpuFault::Access { access: AccessKind::Fetch, address: pc })?;
        // Behind the last instruction of a memory there may be nothing.
        let second = self.memory.fetch(pc.wrapping_add(2)).unwrap_or(0);
        self.decoded[slot] = Decoded::new(first, second);
        Ok(slot)
    }

    #[inline]
    fn step(&mut self, pc: u32) -> Result<(), Stop> {
        let slot = self.fetch(pc)?;
        let Decoded { size, cycles, .. } = self.decoded[slot];
        self.next = pc.wrapping_add(size.into());
        self.r[PC] = pc.wrapping_add(4);
        let outside_it = self.it == 0;
        let passes = outside_it || self.flags.pass(self.it >> 4);
        if passes {
            self.pace.execute(cycles.into());
            if let Err(stop) = self.perform(slot, outside_it) {
                return Err(self.stop(stop));
            }
        } else {
            self.pace.execute(1);
        }
        self.pace.branch(self.next != pc.wrapping_add(size.into()));
        self.pc = self.next;
        if !outside_it {
            self.advance_it();
        }
        if slot == self.decoded.len() - 1 {
            self.decoded[slot].op = Op::Unknown;
        }
        Ok(())
    }

    /// What is left of an instruction at which the core stops.
    #[cold]
    fn stop(&mut self, stop: Stop) -> Stop {
        match stop {
            // The PC stays at the instruction.
            Stop::Fault(_) | Stop::Breakpoint(_) => self.pace.take_back(),
            _ => {
                self.pc = self.next;
                if self.it != 0 {
                    self.advance_it();
                }
            }
        }
        stop
    }

    /// ITAdvance (A7.3.2).
    fn advance_it(&mut self) {
        self.it = if self.it & 7 == 0 { 0 } else { self.it & 0xE0 | self.it << 1 & 0x1F };
    }

    const fn uses_process_stack(&self) -> bool {
        self.ipsr == 0 && self.control & CONTROL_SPSEL != 0
    }

    /// Changes something that the choice of the stack pointer depends on.
    fn reselect_stack(&mut self, change: impl FnOnce(&mut Self)) {
        let before = self.uses_process_stack();
        change(self);
        if self.uses_process_stack() != before {
            core::mem::swap(&mut self.r[SP], &mut self.other_sp);
        }
    }

    const fn xpsr(&self) -> u32 {
        let it = self.it as u32;
        self.flags.to_xpsr() | (it & 3) << 25 | (it >> 2) << 10 | THUMB | self.ipsr
    }

    fn set_xpsr(&mut self, xpsr: u32) {
        self.flags = Flags::from_xpsr(xpsr);
        self.it = (xpsr >> 25 & 3 | (xpsr >> 10 & 0x3F) << 2) as u8;
        self.reselect_stack(|core| core.ipsr = xpsr & 0x1FF);
    }
}

impl From<CpuFault> for Stop {
    fn from(fault: CpuFault) -> Self {
        Self::Fault(fault)
    }
}

impl Cpu for Interpreter {
    fn register(&self, register: Register) -> u32 {
        let process = self.uses_process_stack();
        match register {
            Register::R(number) => self.r[usize::from(number & 15)],
            Register::Sp => self.r[SP],
            Register::Msp => {
                if process {
                    self.other_sp
                } else {
                    self.r[SP]
                }
            }
            Register::Psp => {
                if process {
                    self.r[SP]
                } else {
                    self.other_sp
                }
            }
            Register::Lr => self.r[LR],
            Register::Pc => self.pc,
            Register::Xpsr => self.xpsr(),
            Register::Ipsr => self.ipsr,
            Register::Primask => self.primask.into(),
            Register::Basepri => self.basepri.into(),
            Register::Faultmask => self.faultmask.into(),
            Register::Control => self.control,
            Register::S(number) => self.s[usize::from(number & 31)],
            Register::Fpscr => self.fpscr,
        }
    }

    fn set_register(&mut self, register: Register, value: u32) {
        let process = self.uses_process_stack();
        match register {
            Register::R(number) => self.r[usize::from(number & 15)] = value,
            Register::Sp => self.r[SP] = value,
            Register::Msp if process => self.other_sp = value,
            Register::Psp if !process => self.other_sp = value,
            Register::Msp | Register::Psp => self.r[SP] = value,
            Register::Lr => self.r[LR] = value,
            Register::Pc => self.pc = value & !1,
            Register::Xpsr => self.set_xpsr(value),
            Register::Ipsr => self.reselect_stack(|core| core.ipsr = value),
            Register::Primask => self.primask = value & 1 != 0,
            Register::Basepri => self.basepri = value as u8,
            Register::Faultmask => self.faultmask = value & 1 != 0,
            Register::Control => self.set_control(value),
            Register::S(number) => self.s[usize::from(number & 31)] = value,
            Register::Fpscr => self.fpscr = value,
        }
    }

    fn read_memory(&self, address: u32, into: &mut [u8]) -> Result<(), NoMemory> {
        self.memory.read(address, into)
    }

    fn write_memory(&mut self, address: u32, bytes: &[u8]) -> Result<(), NoMemory> {
        self.memory.write(address, bytes)
    }

    fn enter_exception(&mut self) {
        self.it = 0;
        self.exclusive = None;
    }

    fn run(&mut self) -> Stop {
        loop {
            let pc = self.pc;
            if !self.pace.reach(pc) {
                return Stop::Limit;
            }
            if let Err(stop) = self.step(pc) {
                return stop;
            }
        }
    }
}

#[cfg(all(test, feature = "unicorn"))]
mod differential;
#[cfg(test)]
mod tests;
