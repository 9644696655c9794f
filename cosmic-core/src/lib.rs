//! COSMIC: event channels on the CAN bus.
//!
//! Applications on smart sensors and actuators announce and subscribe to *event channels*, named by a
//! 64-bit subject, and state the quality they need. This crate turns that into CAN identifiers, a
//! time-triggered calendar and an earliest-deadline-first queue.
//!
//! The crate is sans-IO: it never reads a clock and never touches hardware. `now` is a parameter,
//! frames and mailbox commands go in and out as values. It does not allocate, contains no `unsafe`,
//! and all work per call is bounded; the bound is written beside the call.
//!
//! # A channel
//! A [`Channel`](event_layer::Channel) is declared once, as a constant that all nodes share. It has a class:
//!
//! | class | promise | declared with |
//! |---|---|---|
//! | hard real-time | delivered at its instant, under up to k omission faults; needs a slot of the [`calendar`] | `Channel::hard` |
//! | soft real-time | earliest deadline first; discarded when it expires | `Channel::soft` |
//! | non real-time | when the bus is free, in the order of importance | `Channel::non_real_time` |
//!
//! ```
//! use cosmic_core::Subject;
//! use cosmic_core::can::Etag;
//! use cosmic_core::event_layer::{Channel, SoftAttributes};
//! use cosmic_core::time::Duration;
//!
//! const HEAT: Channel<i16> = Channel::soft(
//!     Subject::new(0x2A).unwrap(),
//!     SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
//! )
//! .with_etag(Etag::BOUND_FIRST);
//! ```
//!
//! Without `with_etag`, a [`broker`] tells the etag at run time.
//!
//! # A node
//! A node is two halves that never wait for each other. The *time-triggered half*, a
//! [`Dispatcher`](network::hard::Dispatcher), loads and delivers hard real-time events at the instants of the
//! calendar. The *event-triggered half*, [`EventHalf`], does the rest, and is what the application calls:
//!
//! ```
//! # use cosmic_core::Subject;
//! # use cosmic_core::calendar::{Calendar, Segment};
//! # use cosmic_core::can::{BitRate, Command, Etag, TxNode};
//! # use cosmic_core::event_layer::{Channel, SoftAttributes};
//! # use cosmic_core::network::hard::HrtBuffers;
//! # use cosmic_core::time::{Duration, GlobalClock, Instant};
//! use cosmic_core::{EventHalf, event_half};
//! use cosmic_core::event_layer::{Event, Filter, Policy};
//! # const HEAT: Channel<i16> = Channel::soft(
//! #     Subject::new(0x2A).unwrap(),
//! #     SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
//! # )
//! # .with_etag(Etag::BOUND_FIRST);
//! # static CALENDAR: Calendar = Calendar::checked(
//! #     Segment {
//! #         bit_rate: BitRate::MAX,
//! #         accuracy: Duration::from_micros(5),
//! #         release_jitter: Duration::from_micros(10),
//! #     },
//! #     Duration::from_millis(10),
//! #     &[],
//! # );
//!
//! // One slot, four channels, four subscriptions, eight events that wait, six to be sent of each class.
//! type Node = EventHalf<1, 4, 4, 8, 6, 6>;
//! let node = |number| {
//!     Node::new(TxNode::new(number), &CALENDAR, (), HrtBuffers::new(GlobalClock::free_running()))
//! };
//! let (mut sensor, mut display) = (node(1), node(2));
//! let heat = sensor.announce(&HEAT)?;
//! let subscription = display.subscribe(&HEAT, Filter::ALL, Policy::Latest)?;
//!
//! // Publishing yields a command for the controller: load this frame into this mailbox.
//! let now = Instant::EPOCH;
//! let due = sensor.publish(now, &heat, &Event::new(21))?;
//! let Some(Command::Load(_, frame)) = due.command() else { panic!("the mailbox was free") };
//!
//! // The other node receives it.
//! if let Some(input) = event_half::receive(&frame, now, display.hard_mut()) {
//!     display.on_input(&input, now);
//! }
//! assert_eq!(display.next(&subscription).map(|event| event.content), Some(21));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # A host
//! What runs a node, a *host*, does three things: it hands in [`Input`]s, carries out [commands](can::Command)
//! by means of a [`Controller`](can::Controller) or of a controller's parts, and polls again at an instant.
//! [`event_half`] has the contract. Whatever does not happen as it was promised is told to the application as an
//! [`Exception`](event_layer::Exception).
//!
//! # Where to go from here
//! * [`calendar`]: slots, and what instants they have;
//! * [`services`]: what makes a node one of a cluster: configuration, binding, clock, membership;
//! * [`admission`]: whether a soft channel that the plan does not know still fits;
//! * [`seal`]: what a node believes of others in a cluster whose plan fixes all;
//! * [`can::filter_banks`]: acceptance filters from what a node wants;
//! * `examples/two_nodes.rs`: the above as a program.
//!
//! # Features
//! `defmt` formats the public types for logs; `embedded-can` adds conversions to and from its types. Both are
//! additive, and off.
#![no_std]
#![forbid(unsafe_code)]
// Input never reaches a panic. Where a bound is proven, the exception stands beside it, with its reason.
#![cfg_attr(
    not(test),
    deny(
        clippy::arithmetic_side_effects,
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic
    )
)]

#[cfg(test)]
extern crate std;

pub mod admission;
pub mod broker;
pub mod calendar;
pub mod can;
pub mod client;
pub mod event_half;
pub mod event_layer;
mod explain;
mod jitter;
pub mod membership;
pub mod network;
pub mod plan;
pub mod protocol;
mod ring;
pub mod seal;
pub mod services;
pub mod sync;
pub mod time;
pub mod uid;

pub use event_half::{Capacity, Due, EventHalf, Half, HardAccess, Input, Step};
pub use event_layer::Delivered;
pub use uid::{NodeUid, Subject};
