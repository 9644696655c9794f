//! The worker on a NUCLEO-F446RE, whose transceiver is at CAN2.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

type Worker = Trial<(), boards::wiring::NucleoF446Re<boards::wiring::Can2>>;

trials::app!(worker, Worker, false, work, CAN2);
