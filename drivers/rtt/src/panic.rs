//! What is left to do at a panic: say where.

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, Ordering};

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    // A panic within this one would come here for ever.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        crate::logger::take_over();
        let (file, line) = info.location().map_or(("?", 0), |at| (at.file(), at.line()));
        #[cfg(feature = "panic-messages")]
        defmt::error!("panicked at {=str}:{=u32}: {}", file, line, defmt::Display2Format(&info.message()));
        #[cfg(not(feature = "panic-messages"))]
        {
            let message = info.message().as_str().unwrap_or("(a message with values)");
            defmt::error!("panicked at {=str}:{=u32}: {=str}", file, line, message);
        }
    }
    end()
}

/// `defmt::panic!` has said what it has to say.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    end()
}

/// A HardFault.
fn end() -> ! {
    cortex_m::asm::udf()
}

static PANICKED: AtomicBool = AtomicBool::new(false);
