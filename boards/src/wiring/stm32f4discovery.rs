//! STM32F4DISCOVERY: STM32F407VG, a crystal of 8 MHz, the transceiver at CAN1. PB9 is also the data line of the audio
//! codec's I2C, with a pull-up, which does not disturb CAN.

use stm32f4xx_hal::gpio::Pin;

use super::{Can1, Oscillator, Wiring};

/// STM32F4DISCOVERY.
pub struct Stm32F4Discovery;

impl Wiring for Stm32F4Discovery {
    const OSCILLATOR: Oscillator = Oscillator::crystal(8);
    type Can = Can1;
    /// LD4, green.
    type Led = Pin<'D', 12>;
}
