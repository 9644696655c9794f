//! The example cluster: contents and channels. Every image contains the same. Identifiers, qualities and
//! the calendar come from the [`plan`].
//!
//! | node | publishes | subscribes to |
//! |---|---|---|
//! | sensor | wheel speed, temperature | logbook |
//! | brake | brake force | wheel speed, temperature, suspension |
//! | diagnostics | suspension, logbook | wheel speed, brake force |

use cosmic_core::event_layer::Channel;

use plan::channels;

cosmic_core::include_plan!();

cosmic_core::content! {
    /// The speed of one wheel.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct WheelSpeed {
        /// Counts the measurements.
        pub sequence: u32,
        /// In millimetres per second.
        pub speed: u16,
        /// Has the sensor found itself in order?
        pub valid: bool,
    }
}

cosmic_core::content! {
    /// The temperature of the brake disc.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct Temperature {
        /// Counts the measurements.
        pub sequence: u32,
        /// In hundredths of a degree Celsius.
        pub centidegrees: i16,
    }
}

cosmic_core::content! {
    /// How hard the brake is applied.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct BrakeForce {
        /// Counts the events.
        pub sequence: u32,
        /// In newton.
        pub force: u16,
        /// The lowest bits of the wheel speed's sequence number that it was computed from.
        pub based_on: u16,
    }
}

cosmic_core::content! {
    /// Where the suspension is and how it moves.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct Suspension {
        /// Counts the measurements.
        pub sequence: u32,
        /// In tenths of a millimetre.
        pub travel: i16,
        /// In millimetres per second.
        pub velocity: i16,
    }
}

cosmic_core::content! {
    /// A line of the logbook.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct LogEntry {
        /// Counts the entries.
        pub sequence: u32,
        /// What is logged.
        pub code: u16,
        /// Its value.
        pub value: u16,
    }
}

/// Hard real-time.
pub const WHEEL_SPEED: Channel<WheelSpeed> = channels::wheel_speed::channel();

/// Soft real-time.
pub const TEMPERATURE: Channel<Temperature> = channels::temperature::channel();

/// Soft real-time.
pub const BRAKE_FORCE: Channel<BrakeForce> = channels::brake_force::channel();

/// Soft real-time, and much of it.
pub const SUSPENSION: Channel<Suspension> = channels::suspension::channel();

/// Non real-time.
pub const LOGBOOK: Channel<LogEntry> = channels::logbook::channel();
