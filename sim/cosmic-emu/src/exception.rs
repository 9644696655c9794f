//! Exception entry and return of the Cortex-M4F (ARMv7-M ARM, B1.5.6 to B1.5.8).
//!
//! A task that has used the floating point unit (CONTROL.FPCA) gets the extended frame. The registers are
//! saved at entry, not lazily at the first floating point instruction of the handler: programs cannot
//! tell the difference, except in the cycles of a handler that uses the unit, where lazy saving is the
//! cheaper one; so entry costs the same with both frames, as on hardware with a handler that does not.

use crate::cpu::{AccessKind, Cpu, CpuFault, NoMemory, Register};
use crate::soc::{Masks, number};

/// Cycles from an exception to the first instruction of its handler (Cortex-M4 TRM, 3.9.1).
pub(crate) const ENTRY_CYCLES: u64 = 12;
/// Cycles from one handler to the next without unstacking and stacking between.
pub(crate) const TAIL_CHAIN_CYCLES: u64 = 6;
/// Cycles from the return to the first instruction of what was interrupted.
pub(crate) const RETURN_CYCLES: u64 = 10;

const BASIC_FRAME: u32 = 0x20;
const EXTENDED_FRAME: u32 = 0x68;
const CONTROL_SPSEL: u32 = 1 << 1;
const CONTROL_FPCA: u32 = 1 << 2;
/// xPSR bit 9 of a frame: the stack was moved by four bytes to be aligned.
const ALIGNED: u32 = 1 << 9;
const THUMB: u32 = 1 << 24;
/// Bits of EXC_RETURN: basic frame, to thread mode, from the process stack.
const RETURN_BASIC: u32 = 1 << 4;
const RETURN_THREAD: u32 = 1 << 3;
const RETURN_PROCESS: u32 = 1 << 2;

/// The interrupt masks as the core has them.
pub(crate) fn masks(cpu: &dyn Cpu) -> Masks {
    Masks {
        primask: cpu.register(Register::Primask) & 1 != 0,
        faultmask: cpu.register(Register::Faultmask) & 1 != 0,
        basepri: cpu.register(Register::Basepri) as u8,
    }
}

/// Saves the context that is interrupted and returns the EXC_RETURN that leads back to it.
pub(crate) fn stack(cpu: &mut dyn Cpu, align: bool) -> Result<u32, CpuFault> {
    let control = cpu.register(Register::Control);
    let is_thread = cpu.register(Register::Xpsr) & 0x1FF == 0;
    let uses_process_stack = is_thread && control & CONTROL_SPSEL != 0;
    let is_extended = control & CONTROL_FPCA != 0;

    let top = cpu.register(Register::Sp);
    let size = if is_extended { EXTENDED_FRAME } else { BASIC_FRAME };
    let moved = align && top & 4 != 0;
    let frame = top.wrapping_sub(size) & if align { !7 } else { !3 };
    let mut words: Vec<u32> = (0..=3).map(|n| cpu.register(Register::R(n))).collect();
    words.push(cpu.register(Register::R(12)));
    words.push(cpu.register(Register::Lr));
    words.push(cpu.register(Register::Pc));
    let xpsr = cpu.register(Register::Xpsr) & !ALIGNED | THUMB;
    words.push(xpsr | if moved { ALIGNED } else { 0 });
    if is_extended {
        words.extend((0..16).map(|n| cpu.register(Register::S(n))));
        words.push(cpu.register(Register::Fpscr));
    }
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    cpu.write_memory(frame, &bytes).map_err(|fault| stack_fault(fault, AccessKind::Write))?;
    cpu.set_register(Register::Sp, frame);

    let mode = if is_thread { RETURN_THREAD } else { 0 };
    let process = if uses_process_stack { RETURN_PROCESS } else { 0 };
    let basic = if is_extended { 0 } else { RETURN_BASIC };
    Ok(0xFFFF_FFE1 | mode | process | basic)
}

/// Enters a handler; the context it interrupts is saved.
pub(crate) fn enter(cpu: &mut dyn Cpu, exception: u16, handler: u32, exc_return: u32) {
    // In thread mode this selects the main stack before the exception number does the rest.
    let control = cpu.register(Register::Control);
    cpu.set_register(Register::Control, control & !(CONTROL_SPSEL | CONTROL_FPCA));
    cpu.set_register(Register::Ipsr, exception.into());
    cpu.enter_exception();
    cpu.set_register(Register::Lr, exc_return);
    cpu.set_register(Register::Pc, handler);
}

/// Returns whether this is an EXC_RETURN that the core accepts in this situation.
pub(crate) fn is_valid(exc_return: u32, leaves_thread: bool) -> bool {
    let is_known = matches!(exc_return | RETURN_BASIC, 0xFFFF_FFF1 | 0xFFFF_FFF9 | 0xFFFF_FFFD);
    is_known && leaves_thread == (exc_return & RETURN_THREAD != 0)
}

/// Restores the context that `exc_return` leads to.
pub(crate) fn unstack(cpu: &mut dyn Cpu, exc_return: u32) -> Result<(), CpuFault> {
    let to_process_stack = exc_return & RETURN_PROCESS != 0;
    let is_extended = exc_return & RETURN_BASIC == 0;
    let stack_pointer = if to_process_stack { Register::Psp } else { Register::Msp };
    let frame = cpu.register(stack_pointer);
    let size = if is_extended { EXTENDED_FRAME } else { BASIC_FRAME };
    let mut bytes = vec![0; size as usize];
    cpu.read_memory(frame, &mut bytes).map_err(|fault| stack_fault(fault, AccessKind::Read))?;
    let words: Vec<u32> =
        bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();

    for n in 0..=3 {
        cpu.set_register(Register::R(n), words[usize::from(n)]);
    }
    cpu.set_register(Register::R(12), words[4]);
    let xpsr = words[7];
    cpu.set_register(Register::Xpsr, xpsr & !ALIGNED | THUMB);
    if exc_return & RETURN_THREAD != 0 {
        // In thread mode now, so the stack selection can be written.
        let control = cpu.register(Register::Control) & !(CONTROL_SPSEL | CONTROL_FPCA);
        let selection = if to_process_stack { CONTROL_SPSEL } else { 0 };
        cpu.set_register(Register::Control, control | selection);
    }
    let control = cpu.register(Register::Control) & !CONTROL_FPCA;
    cpu.set_register(Register::Control, control | if is_extended { CONTROL_FPCA } else { 0 });
    let top = frame.wrapping_add(size) | if xpsr & ALIGNED != 0 { 4 } else { 0 };
    cpu.set_register(Register::Sp, top);
    cpu.set_register(Register::Lr, words[5]);
    cpu.set_register(Register::Pc, words[6]);
    if is_extended {
        for n in 0..16 {
            cpu.set_register(Register::S(n), words[8 + usize::from(n)]);
        }
        cpu.set_register(Register::Fpscr, words[24]);
    }
    Ok(())
}

/// Leaving an exception clears FAULTMASK, except for NMI.
pub(crate) fn clear_faultmask(cpu: &mut dyn Cpu, exception: u16) {
    if exception != number::NMI {
        cpu.set_register(Register::Faultmask, 0);
    }
}

fn stack_fault(NoMemory(address): NoMemory, access: AccessKind) -> CpuFault {
    CpuFault::Access { access, address }
}
