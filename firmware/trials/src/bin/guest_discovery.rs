//! The guest on an STM32F4DISCOVERY.
#![no_std]
#![no_main]
#![allow(clippy::result_large_err, reason = "RTIC gives back what a task that cannot be spawned was to own")]

use trials::*;

type Guest = Trial<(), boards::wiring::Stm32F4Discovery>;

trials::app!(guest, Guest, true, count, CAN1);
