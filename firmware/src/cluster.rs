//! The example cluster: nodes, channels, calendar. Every image contains the same.
//!
//! | node | publishes | subscribes to |
//! |---|---|---|
//! | sensor | wheel speed, temperature | logbook |
//! | brake | brake force | wheel speed, temperature, suspension |
//! | diagnostics | suspension, logbook | wheel speed, brake force |

use boards::bxcan_rx::{AcceptanceFilter, RxFifo};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{Channel, HardAttributes, Importance, NonRealTimeAttributes, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_core::time::sync::SyncConfig;

/// The bit rate of the bus.
pub const BIT_RATE: BitRate = BitRate::MAX;

/// Measures wheel speed and temperature.
pub const SENSOR: TxNode = tx_node(1);
/// Brakes.
pub const BRAKE: TxNode = tx_node(2);
/// Observes, and keeps the bus busy.
pub const DIAGNOSTICS: TxNode = tx_node(3);

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

/// Hard real-time, every 10 ms, with one omission tolerated.
pub const WHEEL_SPEED: Channel<WheelSpeed> = Channel::hard(
    WHEEL_SPEED_SUBJECT,
    WHEEL_SPEED_SLOT.etag,
    HardAttributes {
        period: WHEEL_SPEED_SLOT.period,
        periodic: WHEEL_SPEED_SLOT.periodic,
        omission_degree: WHEEL_SPEED_SLOT.omission_degree,
    },
);

/// Soft real-time.
pub const TEMPERATURE: Channel<Temperature> = Channel::soft(
    TEMPERATURE_SUBJECT,
    SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(40) },
)
.with_etag(TEMPERATURE_ETAG);

/// Soft real-time.
pub const BRAKE_FORCE: Channel<BrakeForce> = Channel::soft(
    BRAKE_FORCE_SUBJECT,
    SoftAttributes { deadline: Duration::from_millis(4), validity: Duration::from_millis(20) },
)
.with_etag(BRAKE_FORCE_ETAG);

/// Soft real-time, and much of it.
pub const SUSPENSION: Channel<Suspension> = Channel::soft(
    SUSPENSION_SUBJECT,
    SoftAttributes { deadline: Duration::from_millis(2), validity: Duration::from_millis(8) },
)
.with_etag(SUSPENSION_ETAG);

/// Non real-time.
pub const LOGBOOK: Channel<LogEntry> = Channel::non_real_time(
    LOGBOOK_SUBJECT,
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(LOGBOOK_ETAG);

/// The etag of one of the channels.
pub fn etag_of(subject: Subject) -> Option<Etag> {
    ETAGS.iter().find(|(known, _)| *known == subject).map(|(_, etag)| *etag)
}

const ETAGS: [(Subject, Etag); 5] = [
    (WHEEL_SPEED_SUBJECT, WHEEL_SPEED_SLOT.etag),
    (TEMPERATURE_SUBJECT, TEMPERATURE_ETAG),
    (BRAKE_FORCE_SUBJECT, BRAKE_FORCE_ETAG),
    (SUSPENSION_SUBJECT, SUSPENSION_ETAG),
    (LOGBOOK_SUBJECT, LOGBOOK_ETAG),
];

/// When which hard real-time frame may be on the bus.
pub static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BIT_RATE,
        accuracy: Duration::from_micros(50),
        release_jitter: Duration::from_micros(20),
    },
    Duration::from_millis(10),
    &[WHEEL_SPEED_SLOT],
);

/// How the nodes keep their clocks together. Each has its own rank.
///
/// The time-stamps are taken in interrupts, which wait for the calendar task, for a copy of an HRT message
/// buffer, and for the log: at worst 10 µs together.
pub const SYNC: SyncConfig = SyncConfig {
    period: Duration::from_millis(25),
    stamp_error: Duration::from_micros(10),
    ..SyncConfig::DEFAULT
};

/// From the instant at which one node relies on its clock until all do: the first frames of a master may
/// have been missed.
pub const SETTLING: Duration = Duration::from_ticks(3 * SYNC.period.as_ticks());

/// The slot of the wheel speed.
pub const WHEEL_SPEED_SLOT: Slot = Slot {
    etag: etag(100),
    publisher: SENSOR,
    len: 8,
    omission_degree: 1,
    periodic: true,
    period: Duration::from_millis(10),
    phase: Duration::from_millis(2),
};

/// The acceptance filters of a node that takes everything: hard real-time and synchronisation frames into
/// the urgent FIFO, all others into the other one.
///
/// A synchronisation frame is also accepted by filters of the second kind; the first filter counts.
pub const FILTERS: [AcceptanceFilter; 10] = {
    let hard = AcceptanceFilter { fifo: RxFifo::Urgent, id: 0, mask: PRIORITY };
    let mut filters = [hard; 10];
    // The etags of sync and follow-up differ in their lowest bit only.
    let sync = Etag::SYNC.get() as u32;
    filters[1] =
        AcceptanceFilter { fifo: RxFifo::Urgent, id: sync, mask: Etag::BOUND_LAST.get() as u32 & !1 };
    // A priority other than 0 has at least one of its eight bits set.
    let mut bit = 0;
    while bit < 8 {
        let set = 1 << (PRIORITY_SHIFT + bit);
        filters[2 + bit] = AcceptanceFilter { fifo: RxFifo::Other, id: set, mask: set };
        bit += 1;
    }
    filters
};

const PRIORITY_SHIFT: usize = 21;
const PRIORITY: u32 = 0xFF << PRIORITY_SHIFT;

const WHEEL_SPEED_SUBJECT: Subject = subject(0x0001);
const TEMPERATURE_SUBJECT: Subject = subject(0x0002);
const BRAKE_FORCE_SUBJECT: Subject = subject(0x0003);
const SUSPENSION_SUBJECT: Subject = subject(0x0004);
const LOGBOOK_SUBJECT: Subject = subject(0x0005);

const TEMPERATURE_ETAG: Etag = etag(0x3FFF);
const BRAKE_FORCE_ETAG: Etag = etag(0x3FFE);
const SUSPENSION_ETAG: Etag = etag(0x3FFD);
const LOGBOOK_ETAG: Etag = etag(0x3FFC);

/// A subject of the example.
const fn subject(number: u64) -> Subject {
    Subject::new(0xC05A_1C00_0000_0000 | number).unwrap()
}

const fn etag(value: u16) -> Etag {
    Etag::new(value).unwrap()
}

const fn tx_node(value: u8) -> TxNode {
    TxNode::new(value).unwrap()
}
