//! Logs and records, both read by a debug probe through RTT.
//!
//! Up-channel 0 carries defmt logs. Up-channels 1 and 2 carry records of what happened to events, one
//! for the time-triggered half and one for the event-triggered half, so that neither waits for the
//! other.

use rtt_target::UpChannel;

/// The record channels.
pub struct Records {
    /// Written by the time-triggered half.
    pub hard: UpChannel,
    /// Written by the event-triggered half.
    pub other: UpChannel,
}

/// Sets up RTT. Only once, early in `init`.
pub fn start() -> Records {
    let channels = rtt_target::rtt_init! {
        up: {
            0: { size: 2048, mode: rtt_target::ChannelMode::NoBlockSkip, name: "defmt" }
            1: { size: 2048, mode: rtt_target::ChannelMode::NoBlockSkip, name: "records-hard" }
            2: { size: 4096, mode: rtt_target::ChannelMode::NoBlockSkip, name: "records" }
        }
    };
    rtt_target::set_defmt_channel(channels.up.0);
    Records { hard: channels.up.1, other: channels.up.2 }
}
