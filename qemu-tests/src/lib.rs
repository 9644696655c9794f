//! The machine on which the tests of this crate run, and their way out to the host.
//!
//! Each program in `src/bin/` is a test: QEMU runs it on an emulated Cortex-M4F, it prints by
//! semihosting, and what it prints must be the text in `expected/`. It ends with [`pass`], or with a
//! panic, which makes QEMU's exit code 1.
//!
//! Standard output carries what must be the same with every compiler: orders, outcomes, instants that
//! were asked for, whether a bound was kept. Measured values, which depend on the code generated, go to
//! standard error.
#![no_std]

pub mod board;
pub mod controller;
pub mod count;
pub mod device;
pub mod hardware;
pub mod mono;

pub use cortex_m_semihosting::{heprintln as measured, hprintln as println};

use core::panic::PanicInfo;

use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};

/// Ends the test: it has passed, if it printed what was expected.
pub fn pass() -> ! {
    debug::exit(EXIT_SUCCESS);
    halt()
}

/// What an idle program does: sleep until the next interrupt. (RTIC's own idle task computes, and virtual
/// time leaps only while the CPU sleeps.)
pub fn sleep() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    measured!("{}", info);
    debug::exit(EXIT_FAILURE);
    halt()
}

#[cortex_m_rt::exception]
// SAFETY: nothing is assumed of the state of the program; it is ended.
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    panic!("hard fault: {frame:?}");
}

#[cortex_m_rt::exception]
// SAFETY: as above.
unsafe fn DefaultHandler(interrupt: i16) {
    panic!("interrupt {interrupt} has no handler");
}

// Only a debugger that lets the program go on gets here; QEMU has ended.
fn halt() -> ! {
    loop {
        cortex_m::asm::bkpt();
    }
}
