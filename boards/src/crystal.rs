//! The crystal, or the clock from outside, and what is done when it fails.
//!
//! Once it runs, the clock security system watches it (RM0090, 7.2.7). If it fails, the hardware has the core run by the
//! internal oscillator, and calls for the non-maskable interrupt. The bits that the node would send by that clock are wrong,
//! so the interrupt holds the CAN controllers in reset, and with them TX recessive, notes why, and resets the part. The
//! start after that waits for the crystal for as long as it takes: without it there is nothing that the node could do. It
//! says *crystal* in its statuses then.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use cortex_m::peripheral::SCB;
use stm32f4xx_hal::pac::RCC;
use stm32f4xx_hal::pac::rcc::RegisterBlock;

/// Starts it, or lets in the clock (RM0090, 7.2.1). Who sets the clocks waits for it without end, so it runs before. Returns
/// whether it does. It does not return while one that has run before does not.
pub(crate) fn start(rcc: &RegisterBlock, is_clock: bool) -> bool {
    if is_clock {
        rcc.cr().modify(|_, w| w.hsebyp().bypassed());
    }
    loop {
        rcc.cr().modify(|_, w| w.hseon().on());
        if (0..PATIENCE).any(|_| rcc.cr().read().hserdy().is_ready()) {
            return true;
        }
        if NOTE.get() & WAITS == 0 {
            return false;
        }
        rcc.cr().modify(|_, w| w.hseon().off());
    }
}

/// Watches it from here on.
pub(crate) fn watch(rcc: &RegisterBlock) {
    NOTE.set(NOTE.get() & !WAITS);
    rcc.cr().modify(|_, w| w.csson().on());
}

/// Returns whether it was the cause of a reset, once.
pub(crate) fn take_failure() -> bool {
    let note = NOTE.get();
    NOTE.set(note & !UNTOLD);
    note & UNTOLD != 0
}

/// There is no other cause of it on these parts.
#[allow(non_snake_case, reason = "the name of the vector")]
#[unsafe(no_mangle)]
extern "C" fn NonMaskableInt() -> ! {
    // SAFETY: nobody comes back from here.
    let rcc = unsafe { &*RCC::ptr() };
    rcc.apb1rstr().modify(|_, w| w.can1rst().set_bit().can2rst().set_bit());
    NOTE.set(WAITS | UNTOLD);
    SCB::sys_reset()
}

/// A word that outlives a reset: the start leaves its section alone. After power-on there is anything in it.
struct Note(UnsafeCell<MaybeUninit<u32>>);

// SAFETY: each access is one of a whole word. Who is interrupted by the one writer that interrupts, the NMI, does not go on.
unsafe impl Sync for Note {}

impl Note {
    /// Its flags; none after power-on.
    fn get(&self) -> u32 {
        // SAFETY: all patterns of bits are a word, and what is read volatile is what lies there.
        let word = unsafe { self.0.get().cast::<u32>().read_volatile() };
        if word & !FLAGS == IS_NOTED { word & FLAGS } else { 0 }
    }

    fn set(&self, flags: u32) {
        // SAFETY: the place is valid, and no reference to it exists.
        unsafe { self.0.get().cast::<u32>().write_volatile(IS_NOTED | flags) };
    }
}

#[unsafe(link_section = ".uninit.cosmic_crystal")]
static NOTE: Note = Note(UnsafeCell::new(MaybeUninit::uninit()));

/// In the bits that are no flags: not what memory holds after power-on.
const IS_NOTED: u32 = 0x4352_5958;
const FLAGS: u32 = WAITS | UNTOLD;
/// The start waits for it.
const WAITS: u32 = 1 << 0;
/// Nobody has been told.
const UNTOLD: u32 = 1 << 1;

/// So often it is asked whether the crystal runs: each takes 8 cycles at most, 100 ms at the 16 MHz after a reset. It
/// takes 2 ms (STM32F405 datasheet, 5.3.8).
const PATIENCE: u32 = 200_000;
