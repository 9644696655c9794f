//! The hard real-time path: calendar dispatcher, TTCH and HRT message buffers.
//!
//! The time-triggered half of a node is the [`Dispatcher`], which belongs to the task of the highest
//! priority and is shared with nobody. It sleeps from one instant of the calendar to the next, and at
//! each says what to do, a [`CalendarStep`]:
//!
//! ```text
//! loop {
//!     match buffers.lock(|buffers| dispatcher.poll(now(), buffers)) {
//!         CalendarStep::Command(command) => hard_mailbox.execute(command),
//!         CalendarStep::Notify(buffer) => wake the event layer,
//!         CalendarStep::Continue => {}
//!         CalendarStep::SleepUntil(instant) => delay_until(instant).await,
//!     }
//! }
//! ```
//!
//! The [`HrtBuffers`] are all that the two halves share: one message buffer for each hard real-time
//! channel and publisher, the state of the HRT mailbox, and a copy of the clock's parameters. Every call
//! that another task than the dispatcher's makes copies at most one event in or out. So the dispatcher is
//! never kept waiting for longer than that.
//!
//! What the dispatcher notices (an omission, a missed event, a clock out of bound) it counts in the
//! buffer concerned, and marks it. The event layer then compares the counts with those it saw before and raises
//! the exceptions; none can be lost on the way.

mod attach;
mod buffers;
mod counters;
mod dispatcher;

pub use attach::{Attach, AttachError};
pub(crate) use attach::{Attaching, Detaching};
pub use buffers::{BufferId, HrtBuffers, Role};
pub use counters::Counters;
pub(crate) use counters::Exceptional;
pub use dispatcher::{CalendarStep, Dispatcher};
