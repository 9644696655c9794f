//! The master: of the time; hosts the broker, too.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

trials::app!(master, Host, false, watch, CAN1);
