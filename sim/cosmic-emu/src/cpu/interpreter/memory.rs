//! The core's view of memory: arrays for flash memory and RAM, everything else is peripherals.

use std::cell::RefCell;
use std::rc::Rc;

use crate::cpu::{AccessKind, CpuFault, Io, NoMemory};
use crate::memory::Region;

/// A memory with its content.
pub(super) struct Block {
    pub(super) base: u32,
    pub(super) bytes: Vec<u8>,
}

/// All that the core can access.
pub(super) struct Memory {
    /// In the order in which they are looked at: first those that can be written.
    pub(super) blocks: Vec<Block>,
    /// How many can be written.
    pub(super) writable: usize,
    pub(super) io_regions: Vec<Region>,
    pub(super) io: Rc<RefCell<dyn Io>>,
}

impl Memory {
    /// A load of 1, 2 or 4 bytes, zero-extended.
    #[inline]
    pub(super) fn load(&mut self, address: u32, size: u32) -> Result<u32, CpuFault> {
        for block in &self.blocks {
            let offset = address.wrapping_sub(block.base) as usize;
            let Some(bytes) = block.bytes.get(offset..) else { continue };
            match (size, bytes) {
                (4, &[a, b, c, d, ..]) => return Ok(u32::from_le_bytes([a, b, c, d])),
                (2, &[a, b, ..]) => return Ok(u16::from_le_bytes([a, b]).into()),
                (1, &[a, ..]) => return Ok(a.into()),
                _ => {}
            }
        }
        self.load_io(address, size)
    }

    #[cold]
    fn load_io(&mut self, address: u32, size: u32) -> Result<u32, CpuFault> {
        self.check_io(address, size, AccessKind::Read)?;
        Ok(self.io.borrow_mut().read(address, size as usize))
    }

    /// A store of 1, 2 or 4 bytes.
    #[inline]
    pub(super) fn store(&mut self, address: u32, size: u32, value: u32) -> Result<(), CpuFault> {
        let [v0, v1, v2, v3] = value.to_le_bytes();
        for block in &mut self.blocks[..self.writable] {
            let offset = address.wrapping_sub(block.base) as usize;
            let Some(bytes) = block.bytes.get_mut(offset..) else { continue };
            match (size, bytes) {
                (4, [a, b, c, d, ..]) => (*a, *b, *c, *d) = (v0, v1, v2, v3),
                (2, [a, b, ..]) => (*a, *b) = (v0, v1),
                (1, [a, ..]) => *a = v0,
                _ => continue,
            }
            return Ok(());
        }
        self.store_io(address, size, value)
    }

    #[cold]
    fn store_io(&mut self, address: u32, size: u32, value: u32) -> Result<(), CpuFault> {
        self.check_io(address, size, AccessKind::Write)?;
        self.io.borrow_mut().write(address, size as usize, value);
        Ok(())
    }

    /// A halfword of code; none lies in peripherals.
    pub(super) fn fetch(&self, address: u32) -> Option<u16> {
        let bytes = self.blocks.iter().find_map(|block| slice(block, address, 2))?;
        Some(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    pub(super) fn read(&self, address: u32, into: &mut [u8]) -> Result<(), NoMemory> {
        let length = into.len() as u32;
        let bytes = self.blocks.iter().find_map(|block| slice(block, address, length));
        into.copy_from_slice(bytes.ok_or(NoMemory(address))?);
        Ok(())
    }

    /// Read-only memory is not written.
    pub(super) fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), NoMemory> {
        for block in &mut self.blocks[..self.writable] {
            let offset = address.wrapping_sub(block.base) as usize;
            if let Some(end) = offset.checked_add(bytes.len())
                && let Some(into) = block.bytes.get_mut(offset..end)
            {
                into.copy_from_slice(bytes);
                return Ok(());
            }
        }
        Err(NoMemory(address))
    }

    /// Peripherals take aligned accesses only.
    fn check_io(&self, address: u32, size: u32, access: AccessKind) -> Result<(), CpuFault> {
        let is_io = self.io_regions.iter().any(|region| region.holds(address, size as usize));
        if !is_io {
            return Err(CpuFault::Access { access, address });
        }
        if address.is_multiple_of(size) { Ok(()) } else { Err(CpuFault::Unaligned { access, address }) }
    }
}

#[inline]
fn slice(block: &Block, address: u32, size: u32) -> Option<&[u8]> {
    let offset = address.wrapping_sub(block.base) as usize;
    block.bytes.get(offset..offset.checked_add(size as usize)?)
}
