//! Records of what happens to events at a node: what a judge outside needs to say whether everything was as
//! promised. He needs nothing of the contents: an event is known by its channel, its publisher, its instants and a
//! digest of its bytes.
//!
//! | module | is |
//! |---|---|
//! | [`record`] | a record and its bytes; both ends use it |
//! | `recorder` (feature `recorder`) | the observer who writes them, for any content |
//! | `rtt` (feature `rtt`) | where they go: an RTT up-channel beside the log |
//! | [`watch`] | that observer over RTT if the feature `watched` is on, or nobody |
//!
//! A node that is to be judged writes its records into an RTT up-channel named [`CHANNEL`], which a debug probe
//! reads; the emulated cluster reads it in the same way.
//!
//! ```
//! use cosmic_core::can::TxNode;
//! use cosmic_core::time::Instant;
//! use cosmic_records::{Digest, Record, RecordKind};
//!
//! let kind = RecordKind::Published { len: 4, digest: Digest::of(b"fast") };
//! let record = Record { channel: Some(0), at: Instant::EPOCH, kind };
//! assert_eq!(Record::decode(&record.encode()), Ok(record));
//! ```
#![no_std]
#![forbid(unsafe_code)]

pub mod record;
#[cfg(feature = "recorder")]
pub mod recorder;
#[cfg(feature = "rtt")]
pub mod rtt;
pub mod watch;

pub use record::{Digest, Queue, Record, RecordError, RecordKind};
#[cfg(feature = "recorder")]
pub use recorder::{Recorder, Sink};

#[cfg(feature = "watched")]
#[doc(hidden)]
pub use cosmic_rtt;

/// The name of the RTT up-channel that carries records.
pub const CHANNEL: &str = "records";
