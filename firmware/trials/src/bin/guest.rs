//! The guest: asks for its id.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

trials::app!(guest, Trial, true, count, CAN1);
