//! The core alone, without the rest of a node.

use super::*;
use crate::cpu::AccessKind;

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

fn cpu(code: &[u16]) -> (Interpreter, Rc<Pace>, Rc<RefCell<Log>>) {
    let bytes: Vec<u8> = code.iter().flat_map(|h| h.to_le_bytes()).collect();
    let pace = Rc::new(Pace::default());
    let log = Rc::new(RefCell::new(Log(Rc::clone(&pace), vec![])));
    let io: Rc<RefCell<dyn Io>> = log.clone();
    let mut cpu = Interpreter::new(&[(FLASH, &bytes)], &[RAM], &[IO], &io, &pace);
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
    assert_eq!(cpu.register(Register::Pc), FLASH.base + 10);
    assert_eq!(cpu.register(Register::R(0)), 4);
    assert_eq!((pace.cycle(), pace.instructions()), (5, 5));
}

#[test]
fn an_if_then_block_can_be_interrupted() {
    // movs r0, #0; cmp r0, #0; itete eq; adds or movs; bkpt
    let (mut cpu, pace, _) = cpu(&[0x2000, 0x2800, 0xBF0B, 0x3001, 0x2055, 0x3001, 0x2055, 0xBE05]);
    pace.set_limit(4);
    assert_eq!(cpu.run(), Stop::Limit);
    assert_eq!(cpu.register(Register::R(0)), 1);
    let context = cpu.register(Register::Xpsr);
    cpu.enter_exception();
    assert_eq!(cpu.register(Register::Xpsr) & 0x0600_FC00, 0);
    cpu.set_register(Register::Xpsr, context);
    pace.set_limit(100);
    assert_eq!(cpu.run(), Stop::Breakpoint(5));
    assert_eq!((cpu.register(Register::R(0)), pace.instructions()), (2, 7));
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
            assert!(pace.instructions() > (limit - 1) / turn.0 * turn.1);
        }
    }
}

#[test]
fn exception_returns_are_told_in_handler_mode_only() {
    // mvn r0, #6 (0xFFFFFFF9); bx r0
    let (mut cpu, pace, _) = cpu(&[0xF06F, 0x0006, 0x4700]);
    pace.set_limit(100);
    cpu.set_register(Register::Ipsr, 16);
    assert_eq!(cpu.run(), Stop::ExceptionReturn(0xFFFF_FFF9));
    cpu.set_register(Register::Ipsr, 0);
    cpu.set_register(Register::Pc, FLASH.base);
    let fault = CpuFault::Access { access: AccessKind::Fetch, address: 0xFFFF_FFF8 };
    assert_eq!(cpu.run(), Stop::Fault(fault));
}

#[test]
fn peripheral_accesses_see_the_cycle() {
    // mov.w r1, #0x40000000; str r1, [r1, #4]; ldr r2, [r1]; udf
    let (mut cpu, pace, log) = cpu(&[0xF04F, 0x4180, 0x6049, 0x680A, 0xDE00]);
    pace.set_limit(100);
    assert_eq!(cpu.run(), Stop::Fault(CpuFault::Undefined));
    assert_eq!(log.borrow().1, [(2, 0x4000_0004, 0x4000_0000)]);
    assert_eq!((cpu.register(Register::R(2)), pace.instructions()), (4, 3));
}

#[test]
fn faults_name_the_address_and_leave_the_pc() {
    // mov.w r1, #0xC0000000; ldr r1, [r1]
    let (mut cpu, pace, _) = cpu(&[0xF04F, 0x4140, 0x6809]);
    pace.set_limit(100);
    let fault = CpuFault::Access { access: AccessKind::Read, address: 0xC000_0000 };
    assert_eq!(cpu.run(), Stop::Fault(fault));
    assert_eq!(cpu.register(Register::Pc), FLASH.base + 4);
}

#[test]
fn code_in_ram_may_change() {
    let (mut cpu, pace, _) = cpu(&[0xBF00]);
    pace.set_limit(100);
    for value in [5, 9] {
        // movs r0, #value; bkpt
        assert!(cpu.write_memory(RAM.base, &[value, 0x20, 0, 0xBE]).is_ok());
        cpu.set_register(Register::Pc, RAM.base | 1);
        assert_eq!(cpu.run(), Stop::Breakpoint(0));
        assert_eq!(cpu.register(Register::R(0)), u32::from(value));
    }
}

#[test]
fn an_exception_opens_the_exclusive_monitor() {
    // ldrex r0, [sp, #-... ]: mov.w r1, #0x20000000; ldrex r0, [r1]; strex r2, r0, [r1]
    let program = [0xF04F, 0x5100, 0xE851, 0x0F00, 0xE841, 0x0200, 0xBE00];
    for (interrupted, failed) in [(false, 0), (true, 1)] {
        let (mut cpu, pace, _) = cpu(&program);
        pace.set_limit(2);
        assert_eq!(cpu.run(), Stop::Limit);
        if interrupted {
            cpu.enter_exception();
        }
        pace.set_limit(100);
        assert_eq!(cpu.run(), Stop::Breakpoint(0));
        assert_eq!(cpu.register(Register::R(2)), failed);
    }
}
