//! Whether somebody watches a node is decided when its image is built: nobody does in what is flashed; with the feature
//! `watched` the judge of `cargo xtask demo --apps` is told what becomes of each event. The program is the same.
//!
//! ```ignore
//! type Observer = (Log, Watcher);
//! // In RTIC's `init`, before the log is started:
//! cosmic_records::open!(4096);
//! // Where the node is started:
//! let observers = (Log, watch::watcher(&plan::CHANNELS));
//! ```

use cosmic_core::plan::ChannelPlan;

/// The observer who writes records, or nobody.
#[cfg(feature = "watched")]
pub type Watcher = crate::Recorder<cosmic_rtt::Channel>;
/// The observer who writes records, or nobody.
#[cfg(not(feature = "watched"))]
pub type Watcher = ();

/// The watcher of a node with these channels; once.
///
/// # Panics
/// If the channel for the records has not been [opened](crate::open), or there is a watcher already.
#[cfg(feature = "watched")]
pub fn watcher(channels: &'static [ChannelPlan]) -> Watcher {
    crate::rtt::recorder(channels).expect("the channel for records has been opened, for one watcher")
}

/// The watcher of a node with these channels: nobody.
#[cfg(not(feature = "watched"))]
pub fn watcher(_channels: &'static [ChannelPlan]) -> Watcher {}

/// Opens the channel for the records with a buffer of so many bytes, once, before the log is started: `open!(4096)`.
#[cfg(all(feature = "watched", target_arch = "arm"))]
#[macro_export]
macro_rules! open {
    ($bytes:expr) => {
        if let Some(buffer) = $crate::cosmic_rtt::cortex_m::singleton!(: [u8; $bytes] = [0; $bytes]) {
            $crate::rtt::open(buffer);
        }
    };
}

/// Opens the channel for the records with a buffer of so many bytes; as nobody watches, there is none.
#[cfg(not(feature = "watched"))]
#[macro_export]
macro_rules! open {
    ($bytes:expr) => {};
}
