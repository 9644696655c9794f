//! Who watches a node besides the log: nobody in what is flashed. With the feature `observed` the judge of
//! `cargo xtask demo --apps` is told what becomes of each event.

#[cfg(feature = "observed")]
pub use observed::{Watcher, open, watcher};
#[cfg(not(feature = "observed"))]
pub use unobserved::{Watcher, open, watcher};

#[cfg(feature = "observed")]
mod observed {
    use cosmic_records::{Recorder, rtt};

    pub type Watcher = Recorder<cosmic_rtt::Channel>;

    /// Before the log is started.
    pub fn open() {
        let buffer = cortex_m::singleton!(: [u8; 4096] = [0; 4096]).expect("opened once");
        rtt::open(buffer);
    }

    pub fn watcher() -> Watcher {
        rtt::recorder(&crate::plan::CHANNELS).expect("it has been opened")
    }
}

#[cfg(not(feature = "observed"))]
mod unobserved {
    pub type Watcher = ();

    pub fn open() {}

    pub fn watcher() -> Watcher {}
}
