//! The runtime of COSMIC for RTIC: everything of a node that is the same whatever its board, its size and its
//! application.
//!
//! An RTIC app declares its tasks itself, since RTIC wants them in one module. Each is one line that runs a part
//! of the node; nothing else of the app knows the middleware's inside:
//!
//! | task | priority | does | part |
//! |---|---|---|---|
//! | timer interrupt | 7 | wakes the tasks that wait for an instant | the board's |
//! | calendar | 7 | dispatcher and TTCH: release, withdraw, deliver | [`Calendar`] |
//! | interrupt of the urgent FIFO | 6 | hard real-time frames into their buffers | [`Urgent`] |
//! | transmit interrupt | 5 | what became of loaded frames | [`Outcomes`] |
//! | status change interrupt | 5 | the controller has left the bus | [`Status`] |
//! | interrupt of the other FIFO | 4 | other frames that may concern the node into a queue | [`Other`] |
//! | events | 3 | EDF queue, promotion, non real-time queue, delivery to subscribers | [`Events`] |
//! | application | 1, 2 | publishes, consumes, handles exceptions | [`Publisher`], [`Subscriber`], [`MessagePublisher`], [`MessageSubscriber`] |
//!
//! Only the order matters: calendar above urgent above the rest, events above the application, and nothing above
//! the calendar. `examples/robot` in the repository is a whole cluster.
//!
//! # What waits for what
//! The [`Node`] is an RTIC resource of the event task and the application. The calendar task does not share it:
//! it shares the HRT message buffers only, which the runtime keeps in the [`Storage`] and locks by a
//! [critical section](Hard) for the time of one copy. Interrupts and the calendar task hand over to the event task
//! by queues without locks. What a full queue or FIFO loses becomes an exception, as does a bus-off.
//!
//! # A node that hangs
//! [`Progress`] feeds a watchdog while both halves of the node and the application go on, and [`Memory`] keeps the last
//! exceptions over a reset. A node that names neither in its [`System`] has nothing of them in its image.
//!
//! # Another board
//! A board implements [`Board`] in its own crate, and is named in a [`System`].
#![no_std]

#[cfg(test)]
extern crate std;

pub mod application;
pub mod board;
mod departures;
mod hard;
mod inbox;
mod kept;
#[cfg(feature = "defmt")]
mod log;
pub mod messages;
mod node;
pub mod observer;
mod rejoin;
mod sieve;
mod signal;
mod spsc;
mod start;
mod supervision;
mod system;
mod tasks;

pub use application::{
    Publisher, Subscriber, Ticker, before_slot, next_exception, next_news, publish_every, publish_in_slots,
    report_exceptions, settled, synchronised,
};
pub use board::Board;
pub use hard::Hard;
pub use inbox::Queued;
pub use kept::{KEPT, Kept, Memory};
#[cfg(feature = "defmt")]
pub use log::Log;
pub use messages::{Message, MessageError, MessagePublisher, MessageSubscriber, publish_message_every};
pub use node::Node;
pub use observer::{CalendarObserver, Observer, Observes};
pub use start::{Parts, Storage, start, start_observed, start_with};
pub use supervision::Progress;
pub use system::{PlannedHost, StartError, System, Timed};
pub use tasks::{Calendar, Events, Other, Outcomes, Status, Urgent};

/// The priority of the calendar task, which is the highest, and of the board's timer interrupt: a timer must not
/// wait for a task that it wakes, and everybody reads the clock.
pub const CALENDAR_PRIORITY: u8 = 7;

/// The priority of the event task. No task above it calls the application or an [`Observer`], so none above it logs.
pub const EVENT_PRIORITY: u8 = 3;

/// Spawns tasks of an RTIC app in its `init`, each once, with what it is handed: `spawn!(events(events), watch());`.
#[macro_export]
macro_rules! spawn {
    ($($task:ident($($part:expr),*)),+ $(,)?) => {
        // There is room for each task once.
        $(::core::assert!($task::spawn($($part),*).is_ok(), "the task is spawned already");)+
    };
}

/// What an application needs, to be imported as a whole.
pub mod prelude {
    pub use crate::{
        Board, Calendar, Events, MessagePublisher, MessageSubscriber, Node, Other, Outcomes, Parts,
        Publisher, Status, Storage, Subscriber, System, Ticker, Urgent, before_slot, next_exception,
        next_news, publish_every, publish_in_slots, publish_message_every, report_exceptions, settled, spawn,
        synchronised,
    };
    pub use cosmic_core::event_layer::{Depth, Policy};
    pub use cosmic_core::time::Duration;
    pub use rtic_core::Mutex;
}
