//! Records into an RTT up-channel beside the log (`cosmic-rtt`).
//!
//! A probe reads once which channels there are, so that this one is opened before the log is started. The node, with
//! its observer, comes later.

use core::cell::Cell;

use cosmic_core::plan::ChannelPlan;
use cosmic_rtt::Channel;
use critical_section::Mutex;

use crate::record::Record;
use crate::recorder::{Recorder, Sink};

impl Sink for Channel {
    fn write(&mut self, record: &[u8; Record::LEN]) -> bool {
        Channel::write(self, record)
    }
}

/// Between [`open`] and [`recorder`].
static OPENED: Mutex<Cell<Option<Channel>>> = Mutex::new(Cell::new(None));

/// Opens the channel, before the log is started.
#[cfg(target_arch = "arm")]
pub fn open(buffer: &'static mut [u8]) {
    let channel = cosmic_rtt::channel(c"records", buffer);
    critical_section::with(|key| OPENED.borrow(key).set(channel));
}

/// The observer who writes into the channel that was [opened](open); once.
pub fn recorder<C>(channels: &'static [ChannelPlan]) -> Option<Recorder<Channel, C>> {
    let channel = critical_section::with(|key| OPENED.borrow(key).take())?;
    Some(Recorder::new(channel, channels))
}
