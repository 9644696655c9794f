//! What the example applications share.
//!
//! An application in `src/bin/` is an RTIC app: it declares its tasks and says which parts of the board
//! each owns. RTIC wants the tasks of an app in one module, so they stand in each of them; what they do
//! stands here, once:
//!
//! | task | priority | does | in |
//! |---|---|---|---|
//! | timer interrupt | 7 | wakes the tasks that wait for an instant | `boards::clock` |
//! | `calendar` | 7 | dispatcher and TTCH: release, withdraw, deliver | [`tasks::calendar`] |
//! | `CAN1_RX0` | 6 | hard real-time frames into their buffers | [`tasks::receive_urgent`] |
//! | `CAN1_TX` | 5 | what became of loaded frames | [`tasks::report_outcomes`] |
//! | `CAN1_RX1` | 4 | other frames into a queue | [`tasks::receive_other`] |
//! | `etch` | 3 | EDF queue, promotion, non real-time queue, delivery to subscribers | [`tasks::etch`] |
//! | application | 1 | publishes, consumes, handles exceptions | `src/bin/`, [`application`] |
//!
//! The calendar task shares the HRT message buffers only, and everybody else holds them for the time of
//! a copy. Interrupts and the calendar hand over to `etch` by queues without locks ([`inbox`]).
#![no_std]

pub mod application;
pub mod cluster;
pub mod inbox;
pub mod node;
pub mod records;
pub mod shared;
pub mod signals;
pub mod start;
pub mod tasks;
