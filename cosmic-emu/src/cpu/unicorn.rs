//! The core on top of the Unicorn emulator (QEMU's ARM translator).
//!
//! A hook before every instruction keeps the [`Pace`], so the core stops at the exact instruction. The
//! emulator itself cannot stop inside an IT block; a block is therefore executed as one instruction.
//!
//! Unicorn models no NVIC. On the M profile it also does not follow a change of the exception number at
//! once, so an EXC_RETURN is seen in either of two ways: as its interrupt 8, or as a fetch from an
//! address of 0xFFFF_FFE0 and above. Both end here as [`Stop::ExceptionReturn`].

use core::cell::{Cell, RefCell};
use std::rc::Rc;

use unicorn_engine::unicorn_const::uc_error;
use unicorn_engine::{Arch, ArmCpuModel, HookType, MemType, Mode, Prot, RegisterARM, Unicorn};

use crate::memory::Region;

use super::opcode::{Kind, Opcode};
use super::{Access, Cpu, Fault, Io, NoMemory, Pace, Register, Stop};

/// Values of the PC from here on are EXC_RETURN (ARMv7-M ARM, B1.5.8).
const EXC_RETURN: u32 = 0xFFFF_FFE0;
/// The longest code that is decoded at once: an IT block of four wide instructions.
const LONGEST_BLOCK: usize = 2 + 4 * 4;

/// Memory that can be written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ram<'a> {
    pub(crate) regions: &'a [Region],
    /// May code run there? It makes all stores several times slower, as each might change code.
    pub(crate) executable: bool,
}

/// A core on the Unicorn emulator.
pub(crate) struct UnicornCpu {
    emulator: Unicorn<'static, ()>,
    stop: Rc<Cell<Option<Stop>>>,
}

impl UnicornCpu {
    /// A core with these memories; all accesses to the `io` regions go to `io`. `code` lies at the start
    /// of the first of the read-only regions.
    pub(crate) fn new(
        rom: &[(Region, &[u8])],
        ram: Ram<'_>,
        io_regions: &[Region],
        io: &Rc<RefCell<dyn Io>>,
        pace: &Rc<Pace>,
    ) -> Result<Self, uc_error> {
        let mut emulator = Unicorn::new(Arch::ARM, Mode::THUMB | Mode::MCLASS)?;
        emulator.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32)?;
        let mut code = Vec::new();
        for (region, content) in rom {
            emulator.mem_map(region.base.into(), region.size.into(), Prot::READ | Prot::EXEC)?;
            emulator.mem_write(region.base.into(), content)?;
            code.push(Decoded::new(*region, content));
        }
        let permissions = if ram.executable { Prot::ALL } else { Prot::READ | Prot::WRITE };
        for region in ram.regions {
            emulator.mem_map(region.base.into(), region.size.into(), permissions)?;
        }
        for region in io_regions {
            let (base, size) = (region.base, region.size);
            let (reader, writer) = (Rc::clone(io), Rc::clone(io));
            emulator.mmio_map(
                base.into(),
                size.into(),
                Some(move |_: &mut Unicorn<'_, ()>, offset: u64, size: usize| {
                    u64::from(reader.borrow_mut().read(base + offset as u32, size))
                }),
                Some(move |_: &mut Unicorn<'_, ()>, offset: u64, size: usize, value: u64| {
                    writer.borrow_mut().write(base + offset as u32, size, value as u32);
                }),
            )?;
        }
        let stop = Rc::new(Cell::new(None));
        install_hooks(&mut emulator, code, pace, &stop)?;
        Ok(Self { emulator, stop })
    }
}

fn install_hooks(
    emulator: &mut Unicorn<'static, ()>,
    mut code: Vec<Decoded>,
    pace: &Rc<Pace>,
    stop: &Rc<Cell<Option<Stop>>>,
) -> Result<(), uc_error> {
    let (pace, at_instruction) = (Rc::clone(pace), Rc::clone(stop));
    // The IT block being executed: its first byte behind the IT, and its length.
    let mut block = (0_u32, 0_u32);
    emulator.add_code_hook(1, 0, move |emulator, address, _size| {
        let pc = address as u32;
        if pc.wrapping_sub(block.0) < block.1 {
            return;
        }
        block = (0, 0);
        let runs = pace.reach(pc);
        let opcode = match code.iter_mut().find(|memory| memory.contains(pc)) {
            Some(memory) => memory.opcode(pc),
            None => decode_ram(emulator, pc),
        };
        let reason = if runs { special(opcode.kind, pc, &pace, &mut block) } else { Some(Stop::Limit) };
        match reason {
            None => pace.execute(pc, opcode.size.into(), opcode.count.into(), opcode.cycles.into()),
            Some(reason) => {
                at_instruction.set(Some(reason));
                // Fails only on a handle that is not initialised.
                let _ = emulator.emu_stop();
            }
        }
    })?;
    let at_exception = Rc::clone(stop);
    emulator.add_intr_hook(move |emulator, number| {
        let pc = emulator.reg_read(RegisterARM::PC).unwrap_or(0) as u32;
        at_exception.set(Some(if pc >= EXC_RETURN {
            Stop::ExceptionReturn(pc | 1)
        } else {
            Stop::Fault(Fault::Other(number))
        }));
        let _ = emulator.emu_stop();
    })?;
    let at_access = Rc::clone(stop);
    emulator.add_mem_hook(HookType::MEM_INVALID, 1, 0, move |_, kind, address, _, _| {
        let access = match kind {
            MemType::WRITE_UNMAPPED | MemType::WRITE_PROT => Access::Write,
            MemType::FETCH_UNMAPPED | MemType::FETCH_PROT => Access::Fetch,
            _ => Access::Read,
        };
        let address = address as u32;
        at_access.set(Some(if access == Access::Fetch && address >= EXC_RETURN {
            Stop::ExceptionReturn(address | 1)
        } else {
            Stop::Fault(Fault::Access { access, address })
        }));
        false
    })?;
    Ok(())
}

/// Must the core stop at an instruction of this kind? Notes what goes on otherwise.
#[inline]
fn special(kind: Kind, pc: u32, pace: &Pace, block: &mut (u32, u32)) -> Option<Stop> {
    match kind {
        Kind::Plain => return None,
        Kind::Masks => pace.masks_change(),
        Kind::IfThen(length) => *block = (pc + 2, length.into()),
        Kind::WaitForInterrupt => return Some(Stop::WaitForInterrupt),
        Kind::WaitForEvent => return Some(Stop::WaitForEvent),
        Kind::SendEvent => return Some(Stop::SendEvent),
        Kind::SupervisorCall => return Some(Stop::SupervisorCall),
        Kind::Spin { instructions, cycles } => {
            return (!pace.spin(instructions.into(), cycles.into())).then_some(Stop::Limit);
        }
        Kind::Breakpoint(immediate) => return Some(Stop::Breakpoint(immediate)),
    }
    None
}

fn decode_ram(emulator: &Unicorn<'_, ()>, pc: u32) -> Opcode {
    let mut bytes = [0; LONGEST_BLOCK];
    // At the end of a memory fewer bytes are there; one instruction always is, or it would not execute.
    for length in [LONGEST_BLOCK, 4, 2] {
        if emulator.mem_read(pc.into(), &mut bytes[..length]).is_ok() {
            break;
        }
    }
    Opcode::decode(&bytes)
}

/// A read-only memory with what was decoded of it.
struct Decoded {
    base: u32,
    code: Vec<u8>,
    opcodes: Vec<Option<Opcode>>,
}

impl Decoded {
    fn new(region: Region, code: &[u8]) -> Self {
        Self { base: region.base, code: code.to_vec(), opcodes: vec![None; code.len().div_ceil(2)] }
    }

    #[inline]
    fn contains(&self, pc: u32) -> bool {
        (pc.wrapping_sub(self.base) as usize) < self.code.len()
    }

    #[inline]
    fn opcode(&mut self, pc: u32) -> Opcode {
        let offset = (pc - self.base) as usize;
        let slot = &mut self.opcodes[offset / 2];
        *slot.get_or_insert_with(|| Opcode::decode(&self.code[offset..]))
    }
}

impl Cpu for UnicornCpu {
    fn register(&self, register: Register) -> u32 {
        // Fails only for registers that do not exist.
        self.emulator.reg_read(id(register)).unwrap_or(0) as u32
    }

    fn set_register(&mut self, register: Register, value: u32) {
        // Written by its plain name, xPSR would keep its GE flags.
        let id = if register == Register::Xpsr { RegisterARM::XPSR_NZCVQG as i32 } else { id(register) };
        let _ = self.emulator.reg_write(id, value.into());
    }

    fn read_memory(&self, address: u32, into: &mut [u8]) -> Result<(), NoMemory> {
        self.emulator.mem_read(address.into(), into).map_err(|_| NoMemory(address))
    }

    fn write_memory(&mut self, address: u32, bytes: &[u8]) -> Result<(), NoMemory> {
        self.emulator.mem_write(address.into(), bytes).map_err(|_| NoMemory(address))
    }

    fn run(&mut self) -> Stop {
        self.stop.set(None);
        let start = u64::from(self.register(Register::Pc) | 1);
        // Address 0 as the end: nothing is ever executed there, as the vector table stands there.
        let result = self.emulator.emu_start(start, 0, 0, 0);
        match (self.stop.get(), result) {
            (Some(stop), _) => stop,
            (None, Err(uc_error::INSN_INVALID)) => Stop::Fault(Fault::Undefined),
            (None, Err(error)) => Stop::Fault(Fault::Other(error as u32)),
            (None, Ok(())) => Stop::Limit,
        }
    }
}

fn id(register: Register) -> i32 {
    let id = match register {
        Register::R(number) => return RegisterARM::R0 as i32 + i32::from(number),
        Register::S(number) => return RegisterARM::S0 as i32 + i32::from(number),
        Register::Sp => RegisterARM::SP,
        Register::Msp => RegisterARM::MSP,
        Register::Psp => RegisterARM::PSP,
        Register::Lr => RegisterARM::LR,
        Register::Pc => RegisterARM::PC,
        Register::Xpsr => RegisterARM::XPSR,
        Register::Ipsr => RegisterARM::IPSR,
        Register::Primask => RegisterARM::PRIMASK,
        Register::Basepri => RegisterARM::BASEPRI,
        Register::Faultmask => RegisterARM::FAULTMASK,
        Register::Control => RegisterARM::CONTROL,
        Register::Fpscr => RegisterARM::FPSCR,
    };
    id as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLASH: Region = Region { base: 0x0800_0000, size: 0x1000 };
    const RAM: Region = Region { base: 0x2000_0000, size: 0x1000 };
    const IO: Region = Region { base: 0x4000_0000, size: 0x1000 };

    struct Log(Rc<Pace>, Vec<(u64, u32, u32)>);
    impl Io for Log {
        fn read(&mut self, _: u32, _: usize) -> u32 {
            self.0.cycle() as u32
        }
        fn write(&mut self, address: u32, _: usize, value: u32) {
            self.1.push((self.0.cycle(), address, value));
        }
    }

    fn cpu(code: &[u16]) -> (UnicornCpu, Rc<Pace>, Rc<RefCell<Log>>) {
        let bytes: Vec<u8> = code.iter().flat_map(|h| h.to_le_bytes()).collect();
        let pace = Rc::new(Pace::default());
        let log = Rc::new(RefCell::new(Log(Rc::clone(&pace), vec![])));
        let io: Rc<RefCell<dyn Io>> = log.clone();
        let ram = Ram { regions: &[RAM], executable: false };
        let mut cpu = UnicornCpu::new(&[(FLASH, &bytes)], ram, &[IO], &io, &pace).unwrap();
        cpu.set_register(Register::Pc, FLASH.base | 1);
        cpu.set_register(Register::Sp, RAM.base + RAM.size);
        (cpu, pace, log)
    }

    #[test]
    fn stops_at_the_exact_instruction() {
        let (mut cpu, pace, _) = cpu(&[0x2001, 0x3001, 0x3001, 0x3001, 0xBF30]);
        pace.set_limit(3);
        assert_eq!(cpu.run(), Stop::Limit);
        assert_eq!(cpu.register(Register::R(0)), 3);
        assert_eq!(cpu.register(Register::Pc), FLASH.base + 6);
        pace.set_limit(100);
        assert_eq!(cpu.run(), Stop::WaitForInterrupt);
        assert_eq!(cpu.register(Register::R(0)), 4);
        assert_eq!((pace.cycle(), pace.instructions()), (4, 4));
    }

    #[test]
    fn an_idle_loop_takes_the_same_time_in_one_leap() {
        for (program, turn) in [(&[0x2001, 0xE7FE][..], (3, 1)), (&[0x2001, 0xBF00, 0xE7FD], (4, 2))] {
            for limit in 1..20 {
                let (mut cpu, pace, _) = cpu(program);
                pace.set_limit(limit);
                assert_eq!(cpu.run(), Stop::Limit);
                let leapt = (pace.cycle(), pace.instructions(), cpu.register(Register::Pc));
                // One cycle after the other, so no turn ever fits.
                let (mut cpu, pace, _) = self::cpu(program);
                for limit in 1..=limit {
                    pace.set_limit(limit);
                    assert_eq!(cpu.run(), Stop::Limit);
                }
                assert_eq!((pace.cycle(), pace.instructions(), cpu.register(Register::Pc)), leapt);
                let turns = (limit - 1) / turn.0;
                assert!(pace.instructions() >= 1 + turns * turn.1);
            }
        }
    }

    #[test]
    fn an_if_then_block_is_one_instruction() {
        // movs r0, #0; cmp r0, #0; ittt eq; adds x 3; bkpt
        let (mut cpu, pace, _) = cpu(&[0x2000, 0x2800, 0xBF02, 0x3001, 0x3001, 0x3001, 0xBE05]);
        pace.set_limit(3);
        assert_eq!(cpu.run(), Stop::Limit);
        assert_eq!(cpu.register(Register::R(0)), 3);
        pace.set_limit(100);
        assert_eq!(cpu.run(), Stop::Breakpoint(5));
        assert_eq!(pace.cycle(), 6);
    }

    #[test]
    fn exception_return_is_seen_in_both_modes() {
        // mvn r0, #6 (0xFFFFFFF9); bx r0; and the same behind an MSR in handler mode
        let program = [0xF06F, 0x0006, 0x4700, 0xF381, 0x8811, 0x4700];
        let (mut cpu, pace, _) = cpu(&program);
        pace.set_limit(100);
        assert_eq!(cpu.run(), Stop::ExceptionReturn(0xFFFF_FFF9));
        cpu.set_register(Register::Ipsr, 16);
        assert_eq!(cpu.register(Register::Xpsr) & 0x1FF, 16);
        cpu.set_register(Register::Pc, FLASH.base + 6);
        assert_eq!(cpu.run(), Stop::ExceptionReturn(0xFFFF_FFF9));
        cpu.set_register(Register::Ipsr, 0);
        cpu.set_register(Register::Pc, FLASH.base);
        assert_eq!(cpu.run(), Stop::ExceptionReturn(0xFFFF_FFF9));
    }

    #[test]
    fn peripheral_accesses_see_the_cycle() {
        // mov.w r1, #0x40000000; str r1, [r1, #4]; ldr r2, [r1]; udf
        let (mut cpu, pace, log) = cpu(&[0xF04F, 0x4180, 0x6049, 0x680A, 0xDE00]);
        pace.set_limit(100);
        assert_eq!(cpu.run(), Stop::Fault(Fault::Undefined));
        assert_eq!(log.borrow().1, [(2, 0x4000_0004, 0x4000_0000)]);
        assert_eq!(cpu.register(Register::R(2)), 4);
    }

    #[test]
    fn faults_name_the_address() {
        let (mut cpu, pace, _) = cpu(&[0xF04F, 0x4140, 0x6809]); // mov.w r1, #0xC0000000; ldr r1, [r1]
        pace.set_limit(100);
        let fault = Fault::Access { access: Access::Read, address: 0xC000_0000 };
        assert_eq!(cpu.run(), Stop::Fault(fault));
        assert_eq!(cpu.register(Register::Pc), FLASH.base + 4);
    }
}
