//! The PLL, from constants: 168 MHz of the oscillator of the board (RM0090, 7.3.2).
//!
//! The HAL would solve for its factors at each start, which takes 2 KB of flash. Instead it is told that the oscillator runs
//! at the frequency of the core: it sets prescalers and wait states for that, and its drivers calculate with it. Then the
//! core goes over from the oscillator to the PLL.

use stm32f4xx_hal::pac;

/// Hertz.
pub(crate) const CORE: u32 = 168_000_000;

/// What the frequency of an oscillator is divided by, and multiplied with then: the PLL gets 2 MHz, or 1 MHz, and oscillates
/// at twice the frequency of the core. An oscillator that it cannot use does not compile.
pub(crate) const fn factors(hertz: u32) -> (u8, u16) {
    let input = if hertz.is_multiple_of(2 * MEGAHERTZ) { 2 * MEGAHERTZ } else { MEGAHERTZ };
    assert!(
        hertz.is_multiple_of(input) && hertz >= 4 * MEGAHERTZ && hertz <= 50 * MEGAHERTZ,
        "4 to 50 whole MHz"
    );
    ((hertz / input) as u8, (2 * CORE / input) as u16)
}

/// Starts it, and has the core run by it. The oscillator runs, and the HAL has set the clocks. Returns whether the PLL
/// runs.
pub(crate) fn switch_to(rcc: &pac::rcc::RegisterBlock, (divider, multiplier): (u8, u16)) -> bool {
    // SAFETY: the factors are within their ranges: see `factors`, and below.
    rcc.pllcfgr().write(|w| unsafe {
        w.pllsrc().hse().pllm().bits(divider).plln().bits(multiplier).pllp().div2().pllq().bits(Q)
    });
    rcc.cr().modify(|_, w| w.pllon().on());
    if !(0..PATIENCE).any(|_| rcc.cr().read().pllrdy().is_ready()) {
        return false;
    }
    rcc.cfgr().modify(|_, w| w.sw().pll());
    // It runs, so this takes a few cycles.
    (0..PATIENCE).any(|_| rcc.cfgr().read().sws().is_pll())
}

/// So often it is asked whether it runs. It takes 300 µs at most (STM32F405 datasheet, 5.3.10).
const PATIENCE: u32 = 10_000;

const MEGAHERTZ: u32 = 1_000_000;
/// 48 MHz for USB.
const Q: u8 = 7;
const _: () = assert!(2 * CORE <= 432 * MEGAHERTZ && 2 * CORE / Q as u32 == 48 * MEGAHERTZ);
