//! Logs and records, which a debug probe reads through RTT while the application runs.
//!
//! Up-channel 0 (`defmt`) carries the log. Up-channel 1 (`records`) carries a record for everything that happened to
//! an event at this node ([`cosmic_records::record`]).

use cortex_m::singleton;

/// Sets up RTT for logs and records; once, first thing in `init`. Tasks up to the priority `logs_at_most` may log.
pub fn start(logs_at_most: u8) {
    cosmic_records::rtt::open(defmt::unwrap!(singleton!(: [u8; 6144] = [0; 6144])));
    cosmic_rtt::start!(2048, logs_at_most);
}
