//! Registers that merely keep what is written: settings without an effect on what is emulated.
//!
//! This is the list of known harmless accesses. Anything else that no peripheral takes is reported.

use std::collections::BTreeMap;

/// Registers that are kept, with their reset value.
#[derive(Clone, Debug)]
pub(crate) struct Storage {
    values: BTreeMap<u32, u32>,
}

/// First and last address of each range, and the reset value.
const KEPT: &[(u32, u32, u32)] = &[
    // System configuration: memory remap, external interrupt sources, compensation cell.
    (0x4001_3800, 0x4001_3823, 0),
    // Flash interface: wait states and caches, which the timing does not model.
    (0x4002_3C00, 0x4002_3C00, 0),
    // What goes on in debug halt and sleep.
    (0xE004_2004, 0xE004_200F, 0),
];
/// Device and revision of the STM32F405.
const DBGMCU_IDCODE: (u32, u32) = (0xE004_2000, 0x100F_6413);

impl Storage {
    pub(crate) const fn new() -> Self {
        Self { values: BTreeMap::new() }
    }

    /// Returns whether the register is kept.
    pub(crate) fn keeps(address: u32) -> bool {
        address == DBGMCU_IDCODE.0 || reset_value(address).is_some()
    }

    pub(crate) fn read(&self, address: u32) -> Option<u32> {
        if address == DBGMCU_IDCODE.0 {
            return Some(DBGMCU_IDCODE.1);
        }
        let reset = reset_value(address)?;
        Some(self.values.get(&address).copied().unwrap_or(reset))
    }

    pub(crate) fn write(&mut self, address: u32, value: u32) -> Result<(), ()> {
        reset_value(address).ok_or(())?;
        self.values.insert(address, value);
        Ok(())
    }
}

fn reset_value(address: u32) -> Option<u32> {
    let range = KEPT.iter().find(|(first, last, _)| (*first..=*last).contains(&address))?;
    Some(range.2)
}
