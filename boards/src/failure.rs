//! A crystal or a supply that fails: the node leaves the bus at once, is reset, and waits until it may go on.
//!
//! **The crystal**, or the clock from outside. Once it runs, the clock security system watches it (RM0090, 7.2.7). If it
//! fails, the hardware has the core run by the internal oscillator, and calls for the non-maskable interrupt. The bits that
//! the node would send by that clock are wrong.
//!
//! **The supply.** The programmable voltage detector watches it (RM0090, 5.2.3): at 168 MHz the flash wants 2.7 V (3.5.1), and
//! what the core reads far below that may be anything. The interrupt has the highest priority of all.
//!
//! Either interrupt holds the CAN controllers in reset, and with them TX recessive, notes why, and resets the part; for the
//! supply to return it waits before. The start after that waits for the crystal and the supply for as long as it takes:
//! without them there is nothing that the node could do. Its statuses say *crystal*, or *brown-out*.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use cortex_m::peripheral::{NVIC, SCB};
use stm32f4xx_hal::pac::rcc::RegisterBlock;
use stm32f4xx_hal::pac::{EXTI, Interrupt, PWR, RCC};

/// What made a node leave the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Failure {
    Crystal,
    Supply,
}

/// Starts the crystal, or lets in the clock (RM0090, 7.2.1). Who sets the clocks waits for it without end, so it runs before.
/// Returns whether it does. It does not return while one that has run before does not.
pub(crate) fn start_crystal(rcc: &RegisterBlock, is_clock: bool) -> bool {
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

/// Watches the crystal, which runs, from here on.
pub(crate) fn watch_crystal(rcc: &RegisterBlock) {
    NOTE.set(NOTE.get() & !WAITS);
    rcc.cr().modify(|_, w| w.csson().on());
}

/// Watches the supply from here on. Waits until it is high enough.
pub(crate) fn watch_supply(rcc: &RegisterBlock) {
    rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    // SAFETY: interrupts are not enabled yet, and only bits of the detector and of its line are changed.
    let (power, lines) = unsafe { (&*PWR::ptr(), &*EXTI::ptr()) };
    // SAFETY: three bits, all of whose values are thresholds.
    power.cr().modify(|_, w| unsafe { w.pls().bits(PLS).pvde().set_bit() });
    while is_low() {}
    lines.rtsr().modify(|_, w| w.tr16().set_bit());
    lines.imr().modify(|_, w| w.mr16().set_bit());
    // SAFETY: the priority is the highest already, and the handler shares nothing with others.
    unsafe { NVIC::unmask(Interrupt::PVD) };
}

/// What was the cause of a reset, once.
pub(crate) fn take() -> Option<Failure> {
    let note = NOTE.get();
    NOTE.set(note & WAITS);
    if note & CRYSTAL != 0 { Some(Failure::Crystal) } else { (note & SUPPLY != 0).then_some(Failure::Supply) }
}

/// The crystal has failed: there is no other cause of it on these parts.
#[allow(non_snake_case, reason = "the name of the vector")]
#[unsafe(no_mangle)]
extern "C" fn NonMaskableInt() -> ! {
    leave_bus();
    NOTE.set(WAITS | CRYSTAL);
    SCB::sys_reset()
}

/// The supply sinks.
#[unsafe(no_mangle)]
extern "C" fn PVD() -> ! {
    leave_bus();
    NOTE.set(SUPPLY);
    while is_low() {}
    SCB::sys_reset()
}

#[inline]
fn leave_bus() {
    // SAFETY: who calls this is not left again.
    let rcc = unsafe { &*RCC::ptr() };
    rcc.apb1rstr().modify(|_, w| w.can1rst().set_bit().can2rst().set_bit());
}

#[inline]
fn is_low() -> bool {
    // SAFETY: reads.
    unsafe { (*PWR::ptr()).csr().read().pvdo().bit_is_set() }
}

/// A word that outlives a reset: the start leaves its section alone. After power-on there is anything in it.
struct Note(UnsafeCell<MaybeUninit<u32>>);

// SAFETY: each access is one of a whole word, and an interrupt that writes it does not return.
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

#[unsafe(link_section = ".uninit.cosmic_failure")]
static NOTE: Note = Note(UnsafeCell::new(MaybeUninit::uninit()));

/// In the bits that are no flags: hardly what memory holds after power-on.
const IS_NOTED: u32 = 0x4352_5958;
const FLAGS: u32 = WAITS | CRYSTAL | SUPPLY;
/// The start waits for the crystal.
const WAITS: u32 = 1 << 0;
/// The crystal has failed, and nobody has been told.
const CRYSTAL: u32 = 1 << 1;
/// The supply has.
const SUPPLY: u32 = 1 << 2;

/// So often it is asked whether the crystal runs: each takes 8 cycles at most, 100 ms at the 16 MHz after a reset. It
/// takes 2 ms (STM32F405 datasheet, 5.3.8).
const PATIENCE: u32 = 200_000;
/// The level of the detector (RM0090, `PWR_CR`): typically 2.66 V when the supply falls, 2.76 V when it rises (STM32F405
/// datasheet, 5.3.5). The next one is at up to 2.99 V, which would keep boards from starting that run on 3 V, as the Discovery.
const PLS: u8 = 4;
