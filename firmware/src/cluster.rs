//! The example cluster: contents and channels. Every image contains the same. Identifiers, qualities and
//! the calendar come from the [`plan`].
//!
//! | node | publishes | subscribes to |
//! |---|---|---|
//! | sensor | wheel speed, temperature | logbook |
//! | brake | brake force | wheel speed, temperature, suspension |
//! | diagnostics | suspension, logbook | wheel speed, brake force |

use boards::bxcan::BANKS;
use cosmic_core::Subject;
use cosmic_core::calendar::Slot;
use cosmic_core::can::Etag;
use cosmic_core::can::filter_banks::{Fifo, FilterBanks, FilterBanksError, Wanted};
use cosmic_core::event_layer::{Channel, Content};
use cosmic_core::time::Duration;
use cosmic_core::time::sync::SyncConfig;
use heapless::Vec;

use plan::channels::{brake_force, logbook, suspension, temperature, wheel_speed};

/// What `cosmic-plan` has made of the description of the cluster.
pub mod plan {
    include!(env!("COSMIC_PLAN_FILE"));
}

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

macro_rules! sequenced {
    ($($content:ty),+) => {$(
        impl crate::records::Sequenced for $content {
            #[inline]
            fn sequence(&self) -> u32 {
                self.sequence
            }
        }
    )+};
}
sequenced!(WheelSpeed, Temperature, BrakeForce, Suspension, LogEntry);

/// Hard real-time.
pub const WHEEL_SPEED: Channel<WheelSpeed> =
    Channel::hard(wheel_speed::SUBJECT, wheel_speed::ETAG, wheel_speed::ATTRIBUTES);

/// Soft real-time.
pub const TEMPERATURE: Channel<Temperature> =
    Channel::soft(temperature::SUBJECT, temperature::ATTRIBUTES).with_etag(temperature::ETAG);

/// Soft real-time.
pub const BRAKE_FORCE: Channel<BrakeForce> =
    Channel::soft(brake_force::SUBJECT, brake_force::ATTRIBUTES).with_etag(brake_force::ETAG);

/// Soft real-time, and much of it.
pub const SUSPENSION: Channel<Suspension> =
    Channel::soft(suspension::SUBJECT, suspension::ATTRIBUTES).with_etag(suspension::ETAG);

/// Non real-time.
pub const LOGBOOK: Channel<LogEntry> =
    Channel::non_real_time(logbook::SUBJECT, logbook::ATTRIBUTES).with_etag(logbook::ETAG);

// The plan was made for contents of at most these lengths.
const _: () = {
    assert!(WheelSpeed::LEN <= wheel_speed::LENGTH);
    assert!(Temperature::LEN <= temperature::LENGTH);
    assert!(BrakeForce::LEN <= brake_force::LENGTH);
    assert!(Suspension::LEN <= suspension::LENGTH);
    assert!(LogEntry::LEN <= logbook::LENGTH);
};

/// The etag of one of the channels.
pub fn etag_of(subject: Subject) -> Option<Etag> {
    ETAGS.iter().find(|(known, _)| *known == subject).map(|(_, etag)| *etag)
}

const ETAGS: [(Subject, Etag); 5] = [
    (wheel_speed::SUBJECT, wheel_speed::ETAG),
    (temperature::SUBJECT, temperature::ETAG),
    (brake_force::SUBJECT, brake_force::ETAG),
    (suspension::SUBJECT, suspension::ETAG),
    (logbook::SUBJECT, logbook::ETAG),
];

/// How the nodes keep their clocks together. Each has its own rank.
///
/// The time-stamps are taken in interrupts, which wait for the calendar task, for a copy of an HRT message
/// buffer, and for the log: at worst 10 µs together.
pub const SYNC: SyncConfig = SyncConfig {
    period: plan::SYNC_PERIOD,
    stamp_error: SyncConfig::stamp_error_for(plan::SEGMENT.bit_rate, Duration::from_micros(10)),
    ..SyncConfig::DEFAULT
};

/// From the instant at which one node relies on its clock until all do: the first frames of a master may
/// have been missed.
pub const SETTLING: Duration = Duration::from_ticks(3 * SYNC.period.as_ticks());

/// The slot of the wheel speed.
pub const WHEEL_SPEED_SLOT: Slot = wheel_speed::SLOT;

/// The acceptance filters of a node that subscribes to these subjects: its channels, and synchronisation.
/// Frames that do not concern it cost it nothing.
///
/// # Errors
/// If the node wants more than there is room for.
pub fn filters(subscribes: &[Subject]) -> Result<FilterBanks<BANKS>, FilterBanksError> {
    let mut wanted: Vec<Wanted, WANTED> = Vec::new();
    let mut want = |wish| wanted.push(wish).map_err(|_| FilterBanksError::TooManyWanted);
    want(Wanted::etag(Fifo::Urgent, Etag::SYNC))?;
    want(Wanted::etag(Fifo::Urgent, Etag::FOLLOW_UP))?;
    for etag in subscribes.iter().filter_map(|subject| etag_of(*subject)) {
        if !etag.is_hard() {
            want(Wanted::etag(Fifo::Other, etag))?;
        }
        for slot in plan::SLOTS.iter().filter(|slot| slot.etag == etag) {
            want(Wanted::hard(etag, slot.publisher))?;
        }
    }
    FilterBanks::plan::<WANTED>(&wanted)
}

/// Wishes of a node for frames.
const WANTED: usize = 24;
