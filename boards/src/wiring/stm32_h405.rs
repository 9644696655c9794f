//! Olimex STM32-H405: STM32F405RG, a crystal of 8 MHz, the transceiver at CAN1.

use stm32f4xx_hal::gpio::Pin;

use super::{Can1, Oscillator, Wiring};

/// Olimex STM32-H405.
pub struct Stm32H405;

impl Wiring for Stm32H405 {
    const OSCILLATOR: Oscillator = Oscillator::crystal(8);
    type Can = Can1;
    /// STAT, which shines when the pin is low.
    type Led = Pin<'C', 12>;
}
