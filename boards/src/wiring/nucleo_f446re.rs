//! NUCLEO-F446RE: STM32F446RE, clocked with 8 MHz by the ST-Link on the board. The transceiver is at CAN1 (PB8 is D15, PB9
//! is D14), or at CAN2 (PB5 is D4, PB6 is D10), which leaves D14 and D15 to an I2C shield.

use core::marker::PhantomData;

use stm32f4xx_hal::gpio::Pin;

use super::{Can, Can1, Oscillator, Wiring};

/// NUCLEO-F446RE, with its transceiver at CAN1 or [`Can2`](super::Can2).
pub struct NucleoF446Re<C = Can1>(PhantomData<C>);

impl<C: Can> Wiring for NucleoF446Re<C> {
    const OSCILLATOR: Oscillator = Oscillator::clock(8);
    type Can = C;
    /// LD2, green.
    type Led = Pin<'A', 5>;
}
