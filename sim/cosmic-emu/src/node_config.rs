//! What a node is made of.

use std::path::PathBuf;

use cosmic_bus::{VirtualInstant, time};
use fugit::HertzU32;

use crate::clock::ClockError;
use crate::soc::can::CanController;

/// Where a node's firmware comes from.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Firmware {
    /// An ELF file, as it is flashed.
    File(PathBuf),
    /// The bytes of such a file, with a name for messages.
    Bytes {
        /// For messages.
        name: String,
        /// The file.
        bytes: Vec<u8>,
    },
}

/// What a node is made of.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NodeConfig {
    /// For traces and messages.
    pub name: String,
    /// Its program.
    pub firmware: Firmware,
    /// How far its crystal is from its nominal frequency.
    pub clock_error: ClockError,
    /// When it is switched on.
    pub start_at: VirtualInstant,
    /// The crystal of its board.
    pub crystal: HertzU32,
    /// It oscillates.
    pub crystal_runs: bool,
    /// Its supply is below the threshold of the voltage detector, and above what the part runs with.
    pub supply_is_low: bool,
    /// The internal low-speed oscillator, which the independent watchdog counts: 32 kHz, but 17 to 47 kHz over parts
    /// and temperatures (STM32F405 datasheet, 5.3.9).
    pub low_speed: HertzU32,
    /// Which of its controllers the transceiver is at.
    pub can: CanController,
    /// The unique device identifier that the firmware can read (RM0090, 39.1).
    pub unique_id: [u8; 12],
}

impl NodeConfig {
    /// A node with an exact crystal of 8 MHz, switched on at the start, running an ELF file. Its unique
    /// identifier is made from its name.
    pub fn new(name: impl Into<String>, elf: impl Into<PathBuf>) -> Self {
        let name = name.into();
        let mut unique_id = [0; 12];
        for (slot, byte) in unique_id.iter_mut().zip(name.bytes()) {
            *slot = byte;
        }
        Self {
            name,
            firmware: Firmware::File(elf.into()),
            clock_error: ClockError::ZERO,
            start_at: time::EPOCH,
            crystal: HertzU32::MHz(8),
            crystal_runs: true,
            supply_is_low: false,
            low_speed: HertzU32::kHz(32),
            can: CanController::Can1,
            unique_id,
        }
    }
}
