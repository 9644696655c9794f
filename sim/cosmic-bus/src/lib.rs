//! A bit-accurate CAN bus in virtual time.
//!
//! [`Bus`] carries frames between stations: arbitration by identifier, the exact length of each frame
//! with its stuff bits, acknowledgement, error frames, automatic retransmission, error counters, bus-off,
//! and faults drawn from a seed. It is one piece of code under two test beds, the cluster simulation and
//! the emulated microcontrollers.
//!
//! Nothing here reads a clock: the caller gives commands at virtual instants and advances the bus, which
//! appends what happened to the caller's list of [`Event`]s. One seed and one sequence of commands give
//! one sequence of events and one trace, byte for byte.
//!
//! ```
//! use cosmic_bus::{Bus, EventKind, FaultModel, WireFrame};
//! use cosmic_core::can::BitRate;
//! use embedded_can::{Frame as _, StandardId};
//!
//! let mut bus = Bus::new(BitRate::MAX, FaultModel::none());
//! let (sender, receiver) = (bus.attach("sender"), bus.attach("receiver"));
//! let frame = WireFrame::new(StandardId::ZERO, &[]).ok_or("more than eight bytes")?;
//! bus.load(bus.now(), sender, 0, frame)?;
//!
//! let mut events = Vec::new();
//! let end = bus.now() + bus.bit_rate().longest_frame(8);
//! bus.advance(end, &mut events);
//! assert_eq!((events[0].station, events[0].kind), (receiver, EventKind::Received(frame)));
//! assert_eq!(events[0].at.duration_since_epoch().as_micros(), 49);
//! assert_eq!((events[1].station, events[1].kind), (sender, EventKind::Sent { mailbox: 0 }));
//! assert_eq!(events[1].at.duration_since_epoch().as_micros(), 50);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Not in the model: bits below the bit (propagation, resynchronisation: all stations see each bit at the
//! same instant), CAN FD, overload requests by slow receivers. A disturbance is seen by all stations
//! ([`Fault::Inverted`]), or by some in the last but one bit ([`Fault::InconsistentOmission`]), the one
//! place where that makes a difference to who gets the frame. All stations see the end of an error frame at
//! the same bit, and learn of the error there.
#![forbid(unsafe_code)]

mod accounting;
mod bits;
mod bus;
pub mod cluster;
mod confinement;
mod course;
mod event;
mod fault;
mod filter;
mod frame;
mod station;
pub mod time;
pub mod trace;

pub use accounting::{Accounting, TrafficClass};
pub use bits::{Field, Level, WireBits};
pub use bus::Bus;
pub use confinement::{BusOffRecovery, ErrorLevel, ErrorState};
pub use cosmic_core::can::embedded::ForeignFrame;
pub use event::{ErrorCause, Event, EventKind, StationId};
pub use fault::{BitPosition, Chance, Fault, FaultModel, Rule, Transmitter, Victims};
pub use filter::{Filter, Filters};
pub use frame::{Arbitration, WireFrame};
pub use station::{LoadError, MAILBOXES};
pub use time::VirtualInstant;
