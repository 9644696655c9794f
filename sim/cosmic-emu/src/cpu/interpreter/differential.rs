//! Our core against the Unicorn emulator (QEMU's translator): one random instruction at a time, on random
//! registers and memory. Both must agree on everything that it changes.
//!
//! Left out is what the node handles (sleep, supervisor calls, breakpoints, masks), what one of the two is
//! known not to model (exclusive monitor, cumulative floating point flags), and encodings whose effect the
//! architecture leaves open.

use std::collections::BTreeMap;

use super::op::Op;
use super::operands::Address;
use super::*;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use unicorn_engine::unicorn_const::uc_error;
use unicorn_engine::{Arch, ArmCpuModel, Mode, Prot, RegisterARM, Unicorn};

const FLASH: Region = Region { base: 0x0800_0000, size: 0x1000 };
const RAM: Region = Region { base: 0x2000_0000, size: 0x2000 };
/// Where the instruction stands.
const AT: u32 = FLASH.base + 0x100;
const ROUNDS: usize = 200_000;
const APSR: u32 = 0xF80F_0000;

struct NoIo;

impl Io for NoIo {
    fn read(&mut self, _: u32, _: usize) -> u32 {
        0
    }
    fn write(&mut self, _: u32, _: usize, _: u32) {}
}

/// Registers, flags and memory.
#[derive(Clone, PartialEq, Eq)]
struct State {
    r: [u32; 15],
    pc: u32,
    flags: u32,
    s: [u32; 32],
    fpscr: u32,
    ram: Vec<u8>,
}

fn random_word(random: &mut Pcg64Mcg) -> u32 {
    match random.next_u32() % 8 {
        0 => random.next_u32() % 64,
        1 => u32::MAX - random.next_u32() % 4,
        2 => 1 << (random.next_u32() % 32),
        3..=5 => RAM.base + 0xC00 + random.next_u32() % 0x200 * 4,
        _ => random.next_u32(),
    }
}

fn random_float(random: &mut Pcg64Mcg) -> u32 {
    let value = match random.next_u32() % 8 {
        0 => 0.0,
        1 => f32::INFINITY,
        2 => random.next_u32() as f32,
        3 => (random.next_u32() % 2000) as f32 - 1000.0,
        4 => return random.next_u32() & 0xFFFF,
        _ => random.next_u32() as f32 / 65536.0 - 20000.0,
    };
    value.to_bits()
}

fn random_state(random: &mut Pcg64Mcg, ram: &[u8]) -> State {
    let mut r = [0; 15];
    r.iter_mut().for_each(|register| *register = random_word(random));
    r[SP] = RAM.base + 0x1000;
    let mut s = [0; 32];
    s.iter_mut().for_each(|register| *register = random_float(random));
    State {
        r,
        pc: AT,
        flags: random.next_u32() & APSR,
        s,
        fpscr: random.next_u32() & float::FLAGS,
        ram: ram.to_vec(),
    }
}

/// One instruction by our core; `None` if it faults.
fn ours(before: &State, first: u16, second: u16) -> Option<State> {
    let pace = Rc::new(Pace::default());
    let io: Rc<RefCell<dyn Io>> = Rc::new(RefCell::new(NoIo));
    let mut code = vec![0xFF; 0x104];
    code[0x100..0x102].copy_from_slice(&first.to_le_bytes());
    code[0x102..0x104].copy_from_slice(&second.to_le_bytes());
    let mut core = Interpreter::new(&[(FLASH, &code)], &[RAM], &[], &io, &pace);
    core.r[..15].copy_from_slice(&before.r);
    core.pc = before.pc;
    core.flags = Flags::from_xpsr(before.flags);
    core.s = before.s;
    core.fpscr = before.fpscr;
    core.write_memory(RAM.base, &before.ram).ok()?;
    pace.set_limit(1);
    if core.run() != Stop::Limit {
        return None;
    }
    let mut after = before.clone();
    after.r.copy_from_slice(&core.r[..15]);
    (after.pc, after.flags, after.s, after.fpscr) = (core.pc, core.flags.to_xpsr(), core.s, core.fpscr);
    core.read_memory(RAM.base, &mut after.ram).ok()?;
    Some(after)
}

fn other_core() -> Unicorn<'static, ()> {
    let mut unicorn = Unicorn::new(Arch::ARM, Mode::THUMB | Mode::MCLASS).unwrap();
    unicorn.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32).unwrap();
    unicorn.mem_map(FLASH.base.into(), FLASH.size.into(), Prot::READ | Prot::EXEC).unwrap();
    unicorn.mem_write(FLASH.base.into(), &[0xFF; FLASH.size as usize]).unwrap();
    unicorn.mem_map(RAM.base.into(), RAM.size.into(), Prot::READ | Prot::WRITE).unwrap();
    unicorn
}

/// What the other core made of an instruction.
enum Theirs {
    Done(Box<State>),
    CpuFault,
    /// It refuses some encodings whose effect is unpredictable, which ours executes.
    Undefined,
}

/// One instruction by the other core.
fn theirs(unicorn: &mut Unicorn<'static, ()>, before: &State, first: u16, second: u16) -> Theirs {
    let code = [first.to_le_bytes(), second.to_le_bytes()].concat();
    unicorn.mem_write(AT.into(), &code).unwrap();
    unicorn.ctl_remove_cache(AT.into(), u64::from(AT) + 4).unwrap();
    unicorn.mem_write(RAM.base.into(), &before.ram).unwrap();
    for (n, value) in before.r.iter().enumerate() {
        unicorn.reg_write(core_register(n), (*value).into()).unwrap();
    }
    for (n, value) in before.s.iter().enumerate() {
        unicorn.reg_write(RegisterARM::S0 as i32 + n as i32, (*value).into()).unwrap();
    }
    unicorn.reg_write(RegisterARM::CONTROL, 0).unwrap();
    unicorn.reg_write(RegisterARM::FPSCR, before.fpscr.into()).unwrap();
    unicorn.reg_write(RegisterARM::XPSR_NZCVQG, (before.flags | THUMB).into()).unwrap();
    match unicorn.emu_start(u64::from(AT) | 1, 0, 0, 1) {
        // It goes on to fetch at the target of a branch.
        Ok(()) | Err(uc_error::FETCH_UNMAPPED | uc_error::FETCH_PROT) => {}
        Err(uc_error::INSN_INVALID) => return Theirs::Undefined,
        Err(uc_error::READ_UNMAPPED | uc_error::WRITE_UNMAPPED | uc_error::WRITE_PROT) => {
            return Theirs::CpuFault;
        }
        Err(_) => {
            // It does not recover from an exception.
            *unicorn = other_core();
            return Theirs::CpuFault;
        }
    }
    let read = |register: i32| unicorn.reg_read(register).unwrap() as u32;
    let mut after = before.clone();
    for (n, value) in after.r.iter_mut().enumerate() {
        *value = read(core_register(n));
    }
    for (n, value) in after.s.iter_mut().enumerate() {
        *value = read(RegisterARM::S0 as i32 + n as i32);
    }
    after.pc = read(RegisterARM::PC as i32);
    after.flags = read(RegisterARM::XPSR as i32) & APSR;
    after.fpscr = read(RegisterARM::FPSCR as i32) & float::FLAGS;
    unicorn.mem_read(RAM.base.into(), &mut after.ram).unwrap();
    Theirs::Done(Box::new(after))
}

fn core_register(n: usize) -> i32 {
    match n {
        SP => RegisterARM::SP as i32,
        LR => RegisterARM::LR as i32,
        _ => RegisterARM::R0 as i32 + n as i32,
    }
}

/// Not compared: see the head of the file.
fn is_left_out(op: &Op, state: &State) -> bool {
    // Where nothing is mapped: it must not go on to execute there.
    let is_code = |address: u32| address & 1 != 0 && address < FLASH.base;
    let text = format!("{op:?}");
    let names_pc = ["rd: 15", "rn: 15", "rm: 15", "ra: 15", "rt: 15", "rt2: 15", "low: 15", "high: 15"];
    match *op {
        Op::Undefined | Op::Nop | Op::Spin { .. } | Op::IfThen(_) | Op::Breakpoint(_) => true,
        Op::WaitForInterrupt | Op::WaitForEvent | Op::SendEvent | Op::SupervisorCall => true,
        Op::ChangeMasks { .. } | Op::MoveToSpecial { .. } | Op::MoveFromSpecial { .. } => true,
        Op::LoadExclusive { .. } | Op::StoreExclusive { .. } | Op::FloatStatus { to_core: false, .. } => true,
        Op::BranchExchange { rm } | Op::BranchLinkExchange { rm } => {
            rm > 14 || !is_code(state.r[usize::from(rm)])
        }
        // Popped addresses are random.
        Op::LoadMultiple { rn, list, write_back, .. } => {
            rn == 15 || list & 0xA000 != 0 || write_back && list >> rn & 1 != 0
        }
        Op::StoreMultiple { rn, list, write_back, .. } => {
            rn == 15 || list & 0xA000 != 0 || write_back && list >> rn & 1 != 0
        }
        Op::LoadDual { rt, rt2, address } | Op::StoreDual { rt, rt2, address } => match address {
            Address::PreIndexed(rn, _) | Address::PostIndexed(rn, _) => {
                rn == rt || rn == rt2 || rt > 12 || rt2 > 12
            }
            Address::Literal(_) => true,
            _ => rt > 12 || rt2 > 12 || rt == rt2,
        },
        Op::Load { rt, address, .. } | Op::Store { rt, address, .. } => match address {
            Address::PreIndexed(rn, _) | Address::PostIndexed(rn, _) => rn == rt || rt == 15,
            Address::Register(_, rm, _) => rt == 15 || rm == 15,
            _ => rt == 15,
        },
        Op::TableBranch { rm, .. } => rm == 15,
        Op::Alu { .. } | Op::Test { .. } | Op::Extend { .. } | Op::PcRelative { .. } => {
            text.contains("rd: 15")
        }
        Op::InsertField { .. } => text.contains("rd: 15"),
        _ => names_pc.iter().any(|name| text.contains(name)),
    }
}

fn difference(ours: &State, theirs: &State) -> Option<String> {
    for n in 0..15 {
        if ours.r[n] != theirs.r[n] {
            return Some(format!("r{n} {:#x} instead of {:#x}", ours.r[n], theirs.r[n]));
        }
    }
    for n in 0..32 {
        let (a, b) = (f32::from_bits(ours.s[n]), f32::from_bits(theirs.s[n]));
        if ours.s[n] != theirs.s[n] && !(a.is_nan() && b.is_nan()) {
            return Some(format!("s{n} {a} ({:#x}) instead of {b} ({:#x})", ours.s[n], theirs.s[n]));
        }
    }
    let words = [
        (ours.pc, theirs.pc, "pc"),
        (ours.flags, theirs.flags, "flags"),
        (ours.fpscr, theirs.fpscr, "fpscr"),
    ];
    if let Some((a, b, name)) = words.into_iter().find(|(a, b, _)| a != b) {
        return Some(format!("{name} {a:#x} instead of {b:#x}"));
    }
    (ours.ram != theirs.ram).then(|| "memory".to_owned())
}

#[test]
fn both_cores_agree() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut unicorn = other_core();
    let ram: Vec<u8> = (0..RAM.size).map(|_| random.next_u32() as u8).collect();
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut wrong: BTreeMap<String, (usize, String)> = BTreeMap::new();
    for _ in 0..ROUNDS {
        let narrow = random.next_u32() % 4 == 0;
        let first =
            if narrow { random.next_u32() % 0xE800 } else { 0xE800 + random.next_u32() % 0x1800 } as u16;
        let second = random.next_u32() as u16;
        let op = decode::decode(first, second);
        let name: String = format!("{op:?}").chars().take_while(|c| *c != ' ' && *c != '(').collect();
        let before = random_state(&mut random, &ram);
        if is_left_out(&op, &before) {
            continue;
        }
        let (our_state, their_state) =
            (ours(&before, first, second), theirs(&mut unicorn, &before, first, second));
        *seen.entry(name.clone()).or_default() += 1;
        let what = match (&our_state, &their_state) {
            (Some(a), Theirs::Done(b)) => difference(a, b),
            (None, Theirs::Done(_)) => Some("fault here only".to_owned()),
            (Some(_), Theirs::CpuFault) => Some("fault there only".to_owned()),
            _ => None,
        };
        if let Some(what) = what {
            let entry = wrong.entry(name).or_default();
            entry.0 += 1;
            if entry.0 <= 4 {
                entry.1 += &format!("\n    {first:04X} {second:04X} {op:?}: {what}");
            }
        }
    }
    let report: String =
        wrong.iter().map(|(name, (n, text))| format!("\n{name}: {n} of {}{text}", seen[name])).collect();
    assert!(wrong.is_empty(), "{report}");
    // Nearly all kinds of operation came up.
    assert!(seen.len() > 30, "{seen:?}");
}
