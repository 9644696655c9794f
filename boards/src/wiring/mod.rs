//! What stands around the chip: a board is one small file.
//!
//! `docs/boards.md` of the repository shows how to add one.

mod can;
mod feather_f405;
mod nucleo_f446re;
mod stm32_h405;
mod stm32f4discovery;

pub use crate::bxcan_status::Recovery;
pub use can::{Can, Can1, Can2, FreePins, FreePinsBesideCan2, PinsOfBoth};
pub use feather_f405::FeatherF405;
pub use nucleo_f446re::NucleoF446Re;
pub use stm32_h405::Stm32H405;
pub use stm32f4discovery::Stm32F4Discovery;

/// What is a board's own.
pub trait Wiring: 'static {
    /// What clocks the chip from outside.
    const OSCILLATOR: Oscillator;
    /// What ends bus-off: a pause that grows, unless a board says otherwise.
    const RECOVERY: Recovery = Recovery::Paced;
    /// The controller that the transceiver is at: [`Can1`] or [`Can2`].
    type Can: Can;
    /// The pin of an LED, for the application.
    type Led;
}

/// The clock from outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Oscillator {
    pub(crate) hertz: u32,
    /// It comes as a clock, and not from a crystal.
    pub(crate) is_clock: bool,
}

impl Oscillator {
    /// A crystal of so many megahertz.
    pub const fn crystal(megahertz: u32) -> Self {
        Self { hertz: megahertz * 1_000_000, is_clock: false }
    }

    /// A clock of so many megahertz at OSC_IN.
    pub const fn clock(megahertz: u32) -> Self {
        Self { hertz: megahertz * 1_000_000, is_clock: true }
    }
}
