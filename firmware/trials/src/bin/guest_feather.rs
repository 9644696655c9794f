//! The guest on a Feather STM32F405, whose crystal has 12 MHz.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

type Guest = Trial<(), boards::wiring::FeatherF405>;

trials::app!(guest, Guest, true, count, CAN1);
