//! Adafruit Feather STM32F405 Express: STM32F405RG, a crystal of 12 MHz, the transceiver at CAN1: PB8 is D9, PB9 is D10.

use stm32f4xx_hal::gpio::Pin;

use super::{Can1, Oscillator, Wiring};

/// Adafruit Feather STM32F405 Express.
pub struct FeatherF405;

impl Wiring for FeatherF405 {
    const OSCILLATOR: Oscillator = Oscillator::crystal(12);
    type Can = Can1;
    /// D13, red.
    type Led = Pin<'C', 1>;
}
