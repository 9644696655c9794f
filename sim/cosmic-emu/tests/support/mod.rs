//! Firmware for the tests, assembled by hand: no Arm toolchain is needed.
#![allow(dead_code, unreachable_pub, reason = "each test file uses a part of it")]

use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::can::BitRate;
use cosmic_emu::{Cluster, Firmware, NodeConfig, Observation, ObservationKind};

pub const FLASH: u32 = 0x0800_0000;
pub const RAM: u32 = 0x2000_0000;
/// The clock after reset.
pub const HSI_PERIOD_NS: f64 = 62.5;
const VECTORS: u32 = 16 + 82;
const CODE: u32 = FLASH + 0x200;

pub mod register {
    pub const RCC_AHB1ENR: u32 = 0x4002_3830;
    pub const RCC_APB1ENR: u32 = 0x4002_3840;
    pub const GPIOA_MODER: u32 = 0x4002_0000;
    pub const GPIOA_ODR: u32 = 0x4002_0014;
    pub const GPIOA_BSRR: u32 = 0x4002_0018;
    pub const TIM2: u32 = 0x4000_0000;
    pub const CAN1: u32 = 0x4000_6400;
    pub const NVIC_ISER: u32 = 0xE000_E100;
    pub const NVIC_ISPR: u32 = 0xE000_E200;
    pub const NVIC_IPR: u32 = 0xE000_E400;
    pub const ICSR: u32 = 0xE000_ED04;
}
use register::*;

/// A program: handlers and code, and what else goes into the ELF file.
#[derive(Default)]
pub struct Program {
    code: Vec<u8>,
    /// Exception number and address.
    handlers: Vec<(u32, u32)>,
    reset: u32,
    ram: Vec<(u32, Vec<u8>)>,
    symbols: Vec<(String, u32, u8)>,
}

impl Program {
    /// A handler, and its code up to and including the return.
    pub fn handler(&mut self, exception: u32, code: impl FnOnce(&mut Self)) -> &mut Self {
        self.handlers.push((exception, self.here()));
        code(self);
        self.half(0x4770) // bx lr
    }

    /// The code behind reset.
    pub fn main(&mut self, code: impl FnOnce(&mut Self)) -> &mut Self {
        self.reset = self.here();
        code(self);
        self
    }

    /// The address of the next instruction.
    pub fn here(&self) -> u32 {
        CODE + self.code.len() as u32
    }

    pub fn half(&mut self, instruction: u16) -> &mut Self {
        self.code.extend(instruction.to_le_bytes());
        self
    }

    pub fn halves(&mut self, instructions: &[u16]) -> &mut Self {
        instructions.iter().for_each(|&instruction| {
            self.half(instruction);
        });
        self
    }

    /// MOVW and MOVT: two instructions.
    pub fn load(&mut self, register: u16, value: u32) -> &mut Self {
        for (opcode, part) in [(0xF240, value as u16), (0xF2C0, (value >> 16) as u16)] {
            let (imm4, i, imm3, imm8) = (part >> 12, part >> 11 & 1, part >> 8 & 7, part & 0xFF);
            self.half(opcode | i << 10 | imm4).half(imm3 << 12 | register << 8 | imm8);
        }
        self
    }

    /// Writes a word: five instructions, six cycles at most; the store is the last. Uses R0 and R1.
    pub fn write(&mut self, address: u32, value: u32) -> &mut Self {
        self.load(0, address).load(1, value).half(0x6001) // str r1, [r0]
    }

    /// Sets an output pin of port A.
    pub fn set(&mut self, pin: u32) -> &mut Self {
        self.write(GPIOA_BSRR, 1 << pin)
    }

    /// Clears an output pin of port A.
    pub fn clear(&mut self, pin: u32) -> &mut Self {
        self.write(GPIOA_BSRR, 1 << (pin + 16))
    }

    /// Waits until `word & mask == value`.
    pub fn poll(&mut self, address: u32, mask: u32, value: u32) -> &mut Self {
        self.load(0, address).load(2, mask).load(3, value);
        // ldr r1, [r0]; ands r1, r2; cmp r1, r3; bne to the first
        self.halves(&[0x6801, 0x4011, 0x4299, 0xD1FB])
    }

    /// Copies a word to the outputs of port A.
    pub fn show(&mut self, address: u32) -> &mut Self {
        self.load(0, address)
            .half(0x6801) // ldr r1, [r0]
            .load(0, GPIOA_ODR)
            .half(0x6001)
    }

    pub fn wfi(&mut self) -> &mut Self {
        self.half(0xBF30)
    }

    /// Sleeps for ever: wfi; b to it.
    pub fn sleep(&mut self) -> &mut Self {
        self.halves(&[0xBF30, 0xE7FD])
    }

    /// Clocks for port A, TIM2 and CAN1; all of port A are outputs.
    pub fn set_up(&mut self) -> &mut Self {
        self.write(RCC_AHB1ENR, 1).write(RCC_APB1ENR, 1 << 25 | 1).write(GPIOA_MODER, 0x5555_5555)
    }

    pub fn enable_interrupt(&mut self, number: u32, priority: u8) -> &mut Self {
        self.write(NVIC_ISER + number / 32 * 4, 1 << (number % 32));
        // strb r1, [r0]
        self.load(0, NVIC_IPR + number).load(1, priority.into()).half(0x7001)
    }

    pub fn pend(&mut self, number: u32) -> &mut Self {
        self.write(NVIC_ISPR + number / 32 * 4, 1 << (number % 32))
    }

    /// CAN1 in normal mode at 1 Mbit/s from 16 MHz (1 + 12 + 3 quanta), all frames to FIFO 0.
    pub fn start_can(&mut self) -> &mut Self {
        self.write(CAN1, 1).poll(CAN1 + 4, 3, 1);
        self.write(CAN1 + 0x1C, 11 << 16 | 2 << 20);
        self.write(CAN1 + 0x20C, 1).write(CAN1 + 0x21C, 1).write(CAN1 + 0x200, 0x0E00);
        self.write(CAN1, 0).poll(CAN1 + 4, 3, 0)
    }

    /// Requests the transmission of an extended frame of four bytes.
    pub fn send(&mut self, mailbox: u32, id: u32, data: u32) -> &mut Self {
        let base = CAN1 + 0x180 + 0x10 * mailbox;
        self.write(base + 4, 4).write(base + 8, data).write(base, id << 3 | 1 << 2 | 1)
    }

    /// Initial content of RAM, and a symbol for it.
    pub fn data(&mut self, name: &str, address: u32, bytes: Vec<u8>) -> &mut Self {
        self.ram.push((address, bytes));
        self.symbols.push((name.to_owned(), address, 1));
        self
    }

    /// Names the next instruction as a function.
    pub fn function(&mut self, name: &str) -> &mut Self {
        self.symbols.push((name.to_owned(), self.here() | 1, 2));
        self
    }

    /// The ELF file.
    pub fn elf(&self) -> Vec<u8> {
        let mut flash = vec![0; (CODE - FLASH) as usize];
        let mut vector = |number: u32, value: u32| {
            flash[number as usize * 4..][..4].copy_from_slice(&value.to_le_bytes());
        };
        vector(0, RAM + 0x2000);
        vector(1, self.reset | 1);
        for &(exception, address) in &self.handlers {
            assert!(exception < VECTORS);
            vector(exception, address | 1);
        }
        flash.extend(&self.code);
        let mut segments = vec![(FLASH, flash)];
        segments.extend(self.ram.iter().cloned());
        elf(&segments, &self.symbols)
    }

    /// A node that runs the program.
    pub fn node(&self, name: &str) -> NodeConfig {
        let mut config = NodeConfig::new(name, "");
        config.firmware = Firmware::Bytes { name: name.to_owned(), bytes: self.elf() };
        config
    }
}

/// A 32-bit little-endian Arm ELF file with these segments and symbols (name, value, type).
pub fn elf(segments: &[(u32, Vec<u8>)], symbols: &[(String, u32, u8)]) -> Vec<u8> {
    let words = |values: &[u32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let header_size = 52 + 32 * segments.len() as u32;
    let (mut content, mut program_headers) = (Vec::<u8>::new(), Vec::<u8>::new());
    for (address, bytes) in segments {
        let (offset, length) = (header_size + content.len() as u32, bytes.len() as u32);
        program_headers.extend(words(&[1, offset, *address, *address, length, length, 4, 4]));
        content.extend(bytes);
        content.resize(content.len().next_multiple_of(4), 0);
    }
    let (mut names, mut table) = (vec![0_u8], words(&[0; 4]));
    for (name, value, kind) in symbols {
        table.extend(words(&[names.len() as u32, *value, 0]));
        table.extend([1 << 4 | kind, 0, 0xF1, 0xFF]); // global, absolute
        names.extend(name.bytes().chain([0]));
    }
    names.resize(names.len().next_multiple_of(4), 0);
    let table_at = header_size + content.len() as u32;
    let names_at = table_at + table.len() as u32;
    let sections_at = names_at + names.len() as u32;
    let mut file = vec![0x7F, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    file.extend([2, 0, 40, 0]); // executable, Arm
    file.extend(words(&[1, CODE, 52, sections_at, 0x0500_0000]));
    file.extend([52, 0, 32, 0, segments.len() as u8, 0, 40, 0, 3, 0, 2, 0]);
    file.extend(program_headers);
    file.extend(content);
    file.extend(&table);
    file.extend(&names);
    file.extend(words(&[0; 10]));
    file.extend(words(&[0, 2, 0, 0, table_at, table.len() as u32, 2, 1, 4, 16]));
    file.extend(words(&[0, 3, 0, 0, names_at, names.len() as u32, 0, 0, 1, 0]));
    file
}

pub fn instant(microseconds: u64) -> VirtualInstant {
    VirtualInstant::from_ticks(microseconds * 1000)
}

/// A bus of 1 Mbit/s without faults.
pub fn quiet_bus() -> Bus {
    Bus::new(BitRate::MAX, FaultModel::none())
}

/// Runs one program alone for a time and returns what was seen.
pub fn run(program: &Program, microseconds: u64) -> Vec<Observation> {
    let mut cluster = Cluster::new(quiet_bus());
    cluster.add_node(program.node("alone")).unwrap_or_else(|error| panic!("{error}"));
    cluster.run_until(instant(microseconds));
    cluster.take_observations()
}

/// The edges of port A: instant in nanoseconds, pin, level. Anything else that was seen is a failure.
pub fn edges(observations: &[Observation]) -> Vec<(u64, u8, bool)> {
    let edge = |seen: &Observation| match seen.kind {
        ObservationKind::Pin { pin, level, .. } => (seen.at.as_ticks(), pin.number, level),
        ref other => panic!("at {}: {other}", seen.at),
    };
    observations.iter().map(edge).collect()
}

/// The edges without their instants.
pub fn order(observations: &[Observation]) -> Vec<(u8, bool)> {
    edges(observations).into_iter().map(|(_, pin, level)| (pin, level)).collect()
}
