//! The two controllers, and the pins of port B that each leaves to the application.

use stm32f4xx_hal::gpio::Pin;
use stm32f4xx_hal::pac;
use stm32f4xx_hal::rcc::{Enable as _, Rcc, Reset as _};

use crate::bxcan::Controller;

/// A CAN controller of the chip, with its pins.
pub trait Can: 'static {
    /// What of the chip it takes.
    type Peripherals;
    /// The pins of port B that it leaves.
    type FreePins;

    /// Gives its pins their function.
    fn wire(pins: PinsOfBoth) -> Self::FreePins;

    /// Switches its clock on, and resets it.
    fn take(peripherals: Self::Peripherals, rcc: &mut Rcc) -> Controller;
}

/// CAN1: receives on PB8, sends on PB9. Its interrupts are CAN1_TX, CAN1_RX0, CAN1_RX1 and CAN1_SCE.
pub struct Can1;

/// CAN2: receives on PB5, sends on PB6. Its interrupts are CAN2_TX, CAN2_RX0, CAN2_RX1 and CAN2_SCE.
pub struct Can2;

impl Can for Can1 {
    type Peripherals = pac::CAN1;
    type FreePins = FreePins;

    fn wire(pins: PinsOfBoth) -> FreePins {
        let PinsOfBoth { pb0, pb1, pb2, pb5, pb6, pb7, pb8, pb9, pb10, pb11 } = pins;
        // The pins keep their function when their types are dropped.
        let _ = (pb8.into_alternate::<9>(), pb9.into_alternate::<9>());
        FreePins { pb0, pb1, pb2, pb5, pb6, pb7, pb10, pb11 }
    }

    fn take(_: pac::CAN1, rcc: &mut Rcc) -> Controller {
        pac::CAN1::enable(rcc);
        pac::CAN1::reset(rcc);
        // SAFETY: the registers of CAN1 are there for good, and its owner was given up for them.
        unsafe { Controller::new(pac::CAN1::ptr().cast_mut().cast()) }
    }
}

impl Can for Can2 {
    type Peripherals = (pac::CAN1, pac::CAN2);
    type FreePins = FreePinsBesideCan2;

    fn wire(pins: PinsOfBoth) -> FreePinsBesideCan2 {
        let PinsOfBoth { pb0, pb1, pb2, pb5, pb6, pb7, pb8, pb9, pb10, pb11 } = pins;
        // As above.
        let _ = (pb5.into_alternate::<9>(), pb6.into_alternate::<9>());
        FreePinsBesideCan2 { pb0, pb1, pb2, pb7, pb8, pb9, pb10, pb11 }
    }

    fn take(_: (pac::CAN1, pac::CAN2), rcc: &mut Rcc) -> Controller {
        // CAN2 reaches its memory, and its filters, through CAN1.
        pac::CAN1::enable(rcc);
        pac::CAN1::reset(rcc);
        pac::CAN2::enable(rcc);
        pac::CAN2::reset(rcc);
        // SAFETY: the registers of both are there for good, and their owners were given up for them.
        unsafe { Controller::second(pac::CAN2::ptr().cast_mut().cast(), pac::CAN1::ptr().cast_mut().cast()) }
    }
}

macro_rules! pins {
    ($(#[$doc:meta])+ $name:ident: $($pin:ident $number:literal)+) => {
        $(#[$doc])+
        #[allow(missing_docs, reason = "the names say which")]
        pub struct $name {
            $(pub $pin: Pin<'B', $number>,)+
        }
    };
}

pins! {
    /// The pins of port B that are neither measuring points nor the debug port's (PB3, PB4).
    PinsOfBoth: pb0 0 pb1 1 pb2 2 pb5 5 pb6 6 pb7 7 pb8 8 pb9 9 pb10 10 pb11 11
}
pins! {
    /// Pins of port B for the application, as they are after a reset, of a board with its transceiver at CAN1.
    FreePins: pb0 0 pb1 1 pb2 2 pb5 5 pb6 6 pb7 7 pb10 10 pb11 11
}
pins! {
    /// The same of a board with its transceiver at CAN2.
    FreePinsBesideCan2: pb0 0 pb1 1 pb2 2 pb7 7 pb8 8 pb9 9 pb10 10 pb11 11
}
