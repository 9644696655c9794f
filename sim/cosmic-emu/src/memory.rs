//! The memory map of the STM32F405 and STM32F407 (RM0090, section 2.3).

/// A range of addresses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Region {
    pub(crate) base: u32,
    pub(crate) size: u32,
}

impl Region {
    /// Returns whether the region holds `length` bytes from `address` on.
    pub(crate) const fn holds(&self, address: u32, length: usize) -> bool {
        match address.checked_sub(self.base) {
            Some(offset) => offset as usize + length <= self.size as usize,
            None => false,
        }
    }
}

/// Flash memory.
pub(crate) const FLASH: Region = Region { base: 0x0800_0000, size: 0x10_0000 };
/// Flash memory again, where the core looks for its first vector table.
pub(crate) const BOOT_ALIAS: Region = Region { base: 0, size: FLASH.size };
/// SRAM1 and SRAM2.
pub(crate) const RAM: Region = Region { base: 0x2000_0000, size: 0x2_0000 };
/// Core-coupled memory.
pub(crate) const CCM: Region = Region { base: 0x1000_0000, size: 0x1_0000 };
/// A page of system memory: unique device identifier and size of the flash memory.
pub(crate) const SYSTEM: Region = Region { base: 0x1FFF_7000, size: 0x1000 };
/// Peripherals, their bit-band alias, AHB2 and AHB3, private peripherals of the core.
pub(crate) const IO: [Region; 4] = [
    Region { base: 0x4000_0000, size: 0x0010_0000 },
    Region { base: 0x4200_0000, size: 0x0200_0000 },
    Region { base: 0x5000_0000, size: 0x1000_0000 },
    Region { base: 0xE000_0000, size: 0x0010_0000 },
];

const UNIQUE_ID: usize = 0xA10;
const FLASH_SIZE: usize = 0xA22;

/// The content of [`SYSTEM`] of a device with this unique identifier.
pub(crate) fn system_memory(unique_id: [u8; 12]) -> Vec<u8> {
    let mut content = vec![0xFF; SYSTEM.size as usize];
    content[UNIQUE_ID..UNIQUE_ID + 12].copy_from_slice(&unique_id);
    let kibibytes = (FLASH.size / 1024) as u16;
    content[FLASH_SIZE..FLASH_SIZE + 2].copy_from_slice(&kibibytes.to_le_bytes());
    content
}
