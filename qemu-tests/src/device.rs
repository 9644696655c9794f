//! The device: as much of Arm's MPS2 board with the AN386 image (a Cortex-M4F) as the tests use.
//!
//! What a peripheral access crate would give: the interrupt numbers, the vector table, and the two
//! CMSDK APB timers. Sources: Arm DAI 0386 (memory map, interrupts) and Arm DDI 0479, *Cortex-M System
//! Design Kit Technical Reference Manual*, chapter "APB timer".

use cortex_m::interrupt::InterruptNumber;
use volatile_register::RW;

/// How many bits of priority each interrupt has: eight levels.
pub const NVIC_PRIO_BITS: u8 = 3;

/// The clock of the CPU and of the timers, in hertz.
pub const SYSTEM_CLOCK_HZ: u32 = 25_000_000;

macro_rules! interrupts {
    ($($(#[$doc:meta])* $name:ident = $number:literal,)*) => {
        /// The interrupts, by their position in the vector table.
        // The names are those of Arm's documents, upper case as in every peripheral access crate.
        #[allow(clippy::upper_case_acronyms, non_camel_case_types)]
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        #[repr(u16)]
        pub enum Interrupt {
            $($(#[$doc])* $name = $number,)*
        }

        unsafe extern "C" {
            $(fn $name();)*
        }

        /// What follows the exceptions in the vector table.
        #[unsafe(link_section = ".vector_table.interrupts")]
        // cortex-m-rt's linker script keeps the symbol of this name.
        #[unsafe(no_mangle)]
        #[used]
        pub static __INTERRUPTS: [unsafe extern "C" fn(); COUNT] = [$($name,)*];

        const COUNT: usize = [$($number,)*].len();
    };
}

interrupts! {
    /// UART 0, received.
    UARTRX0 = 0,
    /// UART 0, sent.
    UARTTX0 = 1,
    /// UART 1, received.
    UARTRX1 = 2,
    /// UART 1, sent.
    UARTTX1 = 3,
    /// UART 2, received.
    UARTRX2 = 4,
    /// UART 2, sent.
    UARTTX2 = 5,
    /// Any pin of GPIO 0.
    GPIO0 = 6,
    /// Any pin of GPIO 1.
    GPIO1 = 7,
    /// CMSDK timer 0.
    TIMER0 = 8,
    /// CMSDK timer 1.
    TIMER1 = 9,
    /// CMSDK dual timer.
    DUALTIMER = 10,
    /// SPI controllers.
    SPI = 11,
    /// An overrun of any UART.
    UARTOVF = 12,
    /// Ethernet.
    ETHERNET = 13,
    /// Audio.
    I2S = 14,
    /// Touch screen.
    TSC = 15,
    /// GPIO 0, pin 0. Nothing drives the pins here, so the tests pend these eight by software.
    GPIO0_0 = 16,
    /// GPIO 0, pin 1.
    GPIO0_1 = 17,
    /// GPIO 0, pin 2.
    GPIO0_2 = 18,
    /// GPIO 0, pin 3.
    GPIO0_3 = 19,
    /// GPIO 0, pin 4.
    GPIO0_4 = 20,
    /// GPIO 0, pin 5.
    GPIO0_5 = 21,
    /// GPIO 0, pin 6.
    GPIO0_6 = 22,
    /// GPIO 0, pin 7.
    GPIO0_7 = 23,
}

/// The name under which RTIC looks for [`Interrupt`].
#[allow(non_camel_case_types)]
pub type interrupt = Interrupt;

// SAFETY: the discriminants are the positions in the vector table, each once, and do not change.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

/// A CMSDK APB timer: counts down from `reload` to 0 with the system clock, sets its interrupt at 0 and
/// starts again from `reload` one tick later; with a `reload` of 0 it stops at 0.
#[repr(C)]
pub struct Timer {
    /// Bit 0: run. Bit 3: interrupt enable.
    pub control: RW<u32>,
    /// The count.
    pub value: RW<u32>,
    /// Where the count starts again. Writing it sets the count as well.
    pub reload: RW<u32>,
    /// Bit 0: the interrupt is set. Writing 1 clears it.
    pub interrupt: RW<u32>,
}

impl Timer {
    /// Control: run, with interrupt.
    pub const RUN_WITH_INTERRUPT: u32 = 1 << 0 | 1 << 3;
    /// Control: stop.
    pub const STOP: u32 = 0;
    /// Interrupt: set, or (written) clear it.
    pub const INTERRUPT_SET: u32 = 1;

    /// Timer 0.
    pub fn timer0() -> &'static Self {
        // SAFETY: the registers of CMSDK timer 0 stand at this address (DAI 0386), for as long as the
        // machine runs, and are only accessed through volatile cells.
        unsafe { &*(0x4000_0000 as *const Self) }
    }

    /// Timer 1.
    pub fn timer1() -> &'static Self {
        // SAFETY: as for timer 0.
        unsafe { &*(0x4000_1000 as *const Self) }
    }

    /// Writes a register.
    pub fn write(register: &RW<u32>, value: u32) {
        // SAFETY: no register of this timer has an effect on memory.
        unsafe { register.write(value) }
    }
}
