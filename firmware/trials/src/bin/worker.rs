//! The worker: publishes in each slot of the calendar.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

trials::app!(worker, Trial, false, work, CAN1);
