//! What the header defines, as Rust has it.

use std::ffi::c_char;

/// `msg_obj`
#[repr(C)]
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MsgObj {
    /// The subject of its channel.
    pub subject: u64,
    /// Until it should have been sent; 0: as the channel says.
    pub deadline_ns: u64,
    /// Until it is of no use any more; 0: as the channel says.
    pub validity_ns: u64,
    /// When it arrived, by `CLOCK_MONOTONIC`.
    pub received_at_ns: u64,
    /// The TxNode of its publisher.
    pub publisher: u16,
    /// How many of the bytes there are.
    pub length: u16,
    /// 0.
    pub reserved: [u8; 4],
    /// What it says.
    pub data: [u8; DATA_MAX],
}

/// `ups_settings`
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct UpsSettings {
    /// The file that describes the cluster, or null.
    pub cluster: *const c_char,
    /// The UID of the node; 0: one is drawn.
    pub uid: u64,
    /// The TxNode; -1: the broker gives it.
    pub tx_node: i32,
    /// Bits a second; 0: 1 Mbit/s.
    pub bit_rate: u32,
    /// For how long calls wait; 0: 5 s.
    pub patience_ms: u32,
    /// 0.
    pub reserved: u32,
}

/// `ups_quality`
#[repr(C)]
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UpsQuality {
    /// From publication until an event should have been sent.
    pub deadline_ns: u64,
    /// From publication until an event is of no use any more.
    pub validity_ns: u64,
    /// The etag; 0: the broker gives it.
    pub etag: u16,
    /// [`SOFT`], [`NON_REAL_TIME`] or [`MESSAGES`].
    pub channel_class: u8,
    /// 0 the most important, to 4.
    pub importance: u8,
    /// 0.
    pub reserved: u32,
}

/// `ups_counts`
#[repr(C)]
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UpsCounts {
    /// Taken from `ups_publish`.
    pub published: u32,
    /// Not taken.
    pub refused: u32,
    /// Sent.
    pub sent: u32,
    /// Expired before they were sent.
    pub expired: u32,
    /// Put into the queue of a subscription.
    pub delivered: u32,
    /// Dropped because the queue of a subscription was full.
    pub overflowed: u32,
    /// Replaced by a later one.
    pub replaced: u32,
    /// Dropped because they did not carry what the channel says.
    pub malformed: u32,
}

/// `UPS_OK`
pub const OK: i32 = 0;
/// `UPS_ERR_ARGUMENT`
pub const ERR_ARGUMENT: i32 = -1;
/// `UPS_ERR_HANDLE`
pub const ERR_HANDLE: i32 = -2;
/// `UPS_ERR_LINK`
pub const ERR_LINK: i32 = -3;
/// `UPS_ERR_NOT_BOUND`
pub const ERR_NOT_BOUND: i32 = -4;
/// `UPS_ERR_REFUSED`
pub const ERR_REFUSED: i32 = -5;
/// `UPS_ERR_TOO_LONG`
pub const ERR_TOO_LONG: i32 = -6;
/// `UPS_ERR_DEADLINE`
pub const ERR_DEADLINE: i32 = -7;
/// `UPS_ERR_QUEUE_FULL`
pub const ERR_QUEUE_FULL: i32 = -8;
/// `UPS_ERR_TOO_FAST`
pub const ERR_TOO_FAST: i32 = -9;
/// `UPS_ERR_TIMEOUT`
pub const ERR_TIMEOUT: i32 = -10;
/// `UPS_ERR_CLOSED`
pub const ERR_CLOSED: i32 = -11;
/// `UPS_ERR_INTERNAL`
pub const ERR_INTERNAL: i32 = -12;
/// `UPS_SOFT`
pub const SOFT: u8 = 0;
/// `UPS_NON_REAL_TIME`
pub const NON_REAL_TIME: u8 = 1;
/// `UPS_MESSAGES`
pub const MESSAGES: u8 = 2;
/// `UPS_EVENT_MAX`
pub const EVENT_MAX: usize = cosmic_core::can::Payload::MAX_LEN;
/// `UPS_DATA_MAX`
pub const DATA_MAX: usize = cosmic_session::LONGEST_MESSAGE;
/// `UPS_TEXT_MAX`
pub const TEXT_MAX: usize = 4096;
