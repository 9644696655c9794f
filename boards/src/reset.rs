//! Why the part has started, and memory that outlives a reset.

use cosmic_core::protocol::ResetCause;

/// What the reset flags of RCC say (RM0090, `RCC_CSR`), which add up until they are removed. The rarest first: each
/// reset pulls the reset pin low, and power-on is a brown-out, too.
pub const fn cause(flags: u32) -> ResetCause {
    if flags & (IWDGRSTF | WWDGRSTF) != 0 {
        ResetCause::Watchdog
    } else if flags & LPWRRSTF != 0 {
        ResetCause::LowPower
    } else if flags & SFTRSTF != 0 {
        ResetCause::Software
    } else if flags & PORRSTF != 0 {
        ResetCause::PowerOn
    } else if flags & BORRSTF != 0 {
        ResetCause::BrownOut
    } else if flags & PINRSTF != 0 {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// Why the part has started. The first call says so, and removes the flags; a second finds none.
#[cfg(target_arch = "arm")]
pub fn take_cause() -> ResetCause {
    use crate::failure::Failure;

    // SAFETY: nobody else writes the register, but to start the low-speed oscillator, whose bit stays.
    let register = unsafe { (*stm32f4xx_hal::pac::RCC::ptr()).csr() };
    let cause = cause(register.read().bits());
    register.modify(|_, w| w.rmvf().set_bit());
    match (cause, crate::failure::take()) {
        (ResetCause::Software, Some(Failure::Crystal)) => ResetCause::Crystal,
        // While a low supply is waited for, a watchdog that runs is not fed.
        (ResetCause::Software | ResetCause::Watchdog, Some(Failure::Supply)) => ResetCause::BrownOut,
        (cause, _) => cause,
    }
}

/// The exceptions that were kept over the reset, for one owner: the second call returns `None`. After `cause` has said
/// that the part was switched on there is nothing.
#[cfg(target_arch = "arm")]
pub fn take_memory(cause: ResetCause) -> Option<cosmic_rtic::Memory> {
    use core::sync::atomic::{AtomicBool, Ordering};
    use cosmic_rtic::{Kept, Memory};

    // The linker script of cortex-m-rt does not load the section, and its start does not clear it.
    #[unsafe(link_section = ".uninit.cosmic_kept")]
    static KEPT: Kept = Kept::uninitialised();
    static TAKEN: AtomicBool = AtomicBool::new(false);

    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    // SAFETY: it is taken here, once, and stands in the section that is not initialised.
    let mut memory = unsafe { Memory::new(&KEPT) };
    if matches!(cause, ResetCause::PowerOn) {
        memory.clear();
    }
    Some(memory)
}

const LPWRRSTF: u32 = 1 << 31;
const WWDGRSTF: u32 = 1 << 30;
const IWDGRSTF: u32 = 1 << 29;
const SFTRSTF: u32 = 1 << 28;
const PORRSTF: u32 = 1 << 27;
const PINRSTF: u32 = 1 << 26;
const BORRSTF: u32 = 1 << 25;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_flags_as_each_reset_leaves_them() {
        let causes = [
            (0x0E00_0000, ResetCause::PowerOn),
            (0x0600_0000, ResetCause::BrownOut),
            (0x0400_0000, ResetCause::Pin),
            (0x1400_0000, ResetCause::Software),
            (0x2400_0000, ResetCause::Watchdog),
            (0x4400_0000, ResetCause::Watchdog),
            (0x8400_0000, ResetCause::LowPower),
            (0x0000_0003, ResetCause::Unknown),
            // Flags of a power-on that nobody removed.
            (0x2E00_0000, ResetCause::Watchdog),
        ];
        for (flags, expected) in causes {
            assert_eq!(cause(flags), expected, "{flags:08X}");
        }
    }
}
