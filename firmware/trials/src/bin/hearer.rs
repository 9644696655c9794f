//! The hearer, on a NUCLEO-F446RE, whose transceiver is at CAN2: its filters are the other half of CAN1's.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

type Hearer = Trial<(), boards::wiring::NucleoF446Re<boards::wiring::Can2>>;

trials::app!(hearer, Hearer, true, hear, CAN2);
