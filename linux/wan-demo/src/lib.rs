//! The demo of the gateway: two segments of flashed images in real time, two gateways, a way between them that is slow
//! and is cut, applications on Linux beside them.

pub mod bed;
pub mod between;
pub mod channels;
pub mod commands;
pub mod failed;
pub mod gateway;
pub mod ground;
pub mod page;
pub mod picture;
pub mod report;
pub mod round_trips;
pub mod served;
