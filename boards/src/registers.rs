//! Access to the registers of bxCAN (RM0090, bxCAN register map).
//!
//! Each owner of a part of the controller holds a copy of the address; which registers it accesses is laid
//! down where the owner stands. The tests put memory in place of the peripheral.

/// The registers, from the base address of the peripheral on.
#[derive(Clone, Copy)]
pub(crate) struct Registers {
    base: *mut u32,
}

// SAFETY: the pointer stands for a peripheral, which any context may access; no owner writes a register in
// a way that acts on bits of another owner.
unsafe impl Send for Registers {}

impl Registers {
    /// # Safety
    /// `base` is the address of a bxCAN's registers, or of [`SIZE`] bytes of memory in their place, valid for
    /// as long as this is used.
    pub(crate) const unsafe fn new(base: *mut u32) -> Self {
        Self { base }
    }

    /// `offset` is that of a register.
    #[inline]
    pub(crate) fn read(self, offset: usize) -> u32 {
        debug_assert!(offset < SIZE);
        // SAFETY: `base` is valid by the contract of `new`, and all offsets are registers of the peripheral.
        unsafe { self.base.byte_add(offset).read_volatile() }
    }

    /// `offset` is that of a register, and the writer its owner.
    #[inline]
    pub(crate) fn write(self, offset: usize, value: u32) {
        debug_assert!(offset < SIZE);
        #[cfg(test)]
        WRITTEN.with_borrow_mut(|written| written.push((offset, value)));
        // SAFETY: as for `read`; a write acts only on the bits that its owner has for itself.
        unsafe { self.base.byte_add(offset).write_volatile(value) }
    }
}

/// Bytes from the first register to behind the last.
pub(crate) const SIZE: usize = 0x320;

#[cfg(test)]
std::thread_local! {
    /// What this test has written so far, in this order.
    pub(crate) static WRITTEN: core::cell::RefCell<std::vec::Vec<(usize, u32)>> =
        const { core::cell::RefCell::new(std::vec::Vec::new()) };
}

/// Memory in place of the peripheral. It keeps what is written last.
#[cfg(test)]
pub(crate) struct Memory([u32; SIZE / 4]);

#[cfg(test)]
impl Memory {
    pub(crate) fn new() -> Self {
        Self([0; _])
    }

    pub(crate) fn registers(&mut self) -> Registers {
        // SAFETY: the array has the size, and outlives what the tests make of it.
        unsafe { Registers::new(self.0.as_mut_ptr()) }
    }

    pub(crate) fn at(&self, offset: usize) -> u32 {
        self.0[offset / 4]
    }

    pub(crate) fn set(&mut self, offset: usize, value: u32) {
        self.0[offset / 4] = value;
    }

    /// The offsets of all registers that are not zero.
    pub(crate) fn written(&self) -> impl Iterator<Item = usize> {
        self.0.iter().enumerate().filter(|(_, value)| **value != 0).map(|(word, _)| 4 * word)
    }
}
