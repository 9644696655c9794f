//! Logs and records, which a debug probe reads through RTT while the application runs.
//!
//! Up-channel 0 (`defmt`) carries the log. Up-channel 1 (`records`) carries one record of 24 bytes,
//! little-endian, for everything that happened to an event at this node:
//!
//! | bytes | field | published | delivered | exception | refused |
//! |---|---|---|---|---|---|
//! | 0 | kind | 1 | 2 | 3 | 4 |
//! | 1 | detail | 0 | TxNode of the publisher | `ExceptionKind` as a number | 0 |
//! | 2..4 | etag | of the channel | of the channel | of the channel, or 0xFFFF | of the channel |
//! | 4..8 | sequence | of the event | of the event | 0 | of the event |
//! | 8..16 | at | handed to the middleware | taken by the application | noticed | handed over |
//! | 16..24 | visible | as `at` | became visible to the subscriber | as `at` | as `at` |
//!
//! Instants are nanoseconds of the node's local time. An event becomes visible when its frame has been
//! received, and a hard real-time event at its delivery instant.

use cortex_m::singleton;
use cosmic_core::can::Etag;
use cosmic_core::event_half::Delivered;
use cosmic_core::event_layer::{Channel, Exception};
use cosmic_core::time::Instant;
use cosmic_rtt::Channel as UpChannel;

use crate::cluster::{self, Sequenced};

/// The record channel.
pub struct Records {
    channel: UpChannel,
    lost: u32,
}

/// One record.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Record {
    kind: Kind,
    detail: u8,
    etag: Option<Etag>,
    sequence: u32,
    at: Instant,
    visible_at: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    Published = 1,
    Delivered = 2,
    Exception = 3,
    Refused = 4,
}

impl Records {
    /// Sets up RTT for logs and records; once, first thing in `init`. Tasks up to the priority `logs_at_most` may
    /// log.
    pub fn start(logs_at_most: u8) -> Self {
        let records = defmt::unwrap!(singleton!(: [u8; 6144] = [0; 6144]));
        let channel = defmt::unwrap!(cosmic_rtt::channel(c"records", records));
        cosmic_rtt::start!(2048, logs_at_most);
        Self { channel, lost: 0 }
    }

    /// An event was handed to the middleware, which took it or not.
    pub fn published<C: Sequenced>(&mut self, channel: &Channel<C>, sequence: u32, at: Instant, taken: bool) {
        let kind = if taken { Kind::Published } else { Kind::Refused };
        let etag = cluster::etag_of(channel.subject());
        self.write(&Record { kind, detail: 0, etag, sequence, at, visible_at: at });
    }

    /// The application took an event.
    pub fn delivered<C: Sequenced>(&mut self, channel: &Channel<C>, event: &Delivered<C>, at: Instant) {
        self.write(&Record {
            kind: Kind::Delivered,
            detail: event.publisher.get(),
            etag: cluster::etag_of(channel.subject()),
            sequence: event.content.sequence(),
            at,
            visible_at: event.received_at,
        });
    }

    /// The application was told of an exception.
    pub fn exception(&mut self, exception: &Exception) {
        self.write(&Record {
            kind: Kind::Exception,
            detail: exception.kind as u8,
            etag: exception.subject.and_then(cluster::etag_of),
            sequence: 0,
            at: exception.at,
            visible_at: exception.at,
        });
    }

    fn write(&mut self, record: &Record) {
        // Nobody waits for a probe; the channel takes a record whole or not at all.
        if !self.channel.write(&record.encode()) {
            self.lost = self.lost.wrapping_add(1);
            if self.lost.is_power_of_two() {
                defmt::warn!("{} records were lost: nobody reads them fast enough", self.lost);
            }
        }
    }
}

impl Record {
    const LEN: usize = 24;
    const NO_ETAG: u16 = u16::MAX;

    fn encode(&self) -> [u8; Self::LEN] {
        let mut bytes = [0; Self::LEN];
        bytes[0] = self.kind as u8;
        bytes[1] = self.detail;
        bytes[2..4].copy_from_slice(&self.etag.map_or(Self::NO_ETAG, Etag::get).to_le_bytes());
        bytes[4..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.at.since_epoch().as_ticks().to_le_bytes());
        bytes[16..24].copy_from_slice(&self.visible_at.since_epoch().as_ticks().to_le_bytes());
        bytes
    }
}
