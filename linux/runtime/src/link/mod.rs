//! Links: how a node reaches its segment.
//!
//! A [`Link`] carries frames between a [`Port`] of the node and whatever is at the other end, for the time of one
//! connection. The node starts it again when that has ended, after a pause that grows to [`LONGEST_PAUSE`]. Parsers of
//! what comes from outside take a bounded number of bytes and never panic; what they do not understand is counted.

pub mod candump;
pub mod segment;
pub mod slcan;
pub mod socketcan;
pub mod socketcand;

use std::fmt;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use cosmic_core::can::{BitRate, ErrorCounters, Frame, Mailbox, Outcome};
use cosmic_core::event_half::Input;

use crate::shared::Shared;

pub use crate::places::Handover;

/// A way to a segment.
pub trait Link: Send + 'static {
    /// Connects, and carries frames until the connection is lost. Tells the port when it is
    /// [connected](Port::connected).
    fn run(&mut self, port: &Port) -> impl Future<Output = LinkError> + Send;
}

/// Why a link cannot connect, or has lost its connection: one line, with what to do.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LinkError {
    message: String,
    /// Trying again is of no use.
    is_final: bool,
}

impl LinkError {
    /// It is tried again.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), is_final: false }
    }

    /// It is not tried again.
    pub fn last(message: impl Into<String>) -> Self {
        Self { message: message.into(), is_final: true }
    }
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for LinkError {}

/// What a link did.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct LinkCounters {
    /// Frames of COSMIC's kind that have arrived.
    pub received: u64,
    /// Of these, control frames.
    pub control_frames: u64,
    /// Frames that the link has sent, as far as it can tell.
    pub sent: u64,
    /// Frames that the link or the kernel dropped before the node saw them, as far as they tell.
    pub lost: u64,
    /// Frames that COSMIC does not use: standard identifiers, remote frames, errors.
    pub foreign: u64,
    /// Lines or records that mean nothing.
    pub malformed: u64,
    /// Frames that were handed over before the connection broke, and handed over again after it.
    pub repeated: u64,
    /// Frames that went nowhere, since a log cannot be sent to.
    pub unsent: u64,
    /// How often it connected.
    pub connections: u64,
}

/// The node, as its link sees it.
#[derive(Clone)]
pub struct Port {
    shared: Arc<Shared>,
}

impl Port {
    /// The connection stands.
    pub fn connected(&self) {
        self.shared.act(|core, _| core.connected());
    }

    /// A frame has arrived. The node stamps it now.
    pub fn received(&self, frame: &Frame) {
        self.shared.act(|core, now| core.receive(frame, now));
    }

    /// A frame has arrived that COSMIC does not use.
    pub fn foreign(&self) {
        self.shared.look(|core| core.counters.foreign += 1);
    }

    /// Something has arrived that means nothing.
    pub fn malformed(&self) {
        self.shared.look(|core| core.counters.malformed += 1);
    }

    /// So many frames were lost on the way here.
    pub fn lost(&self, frames: u32) {
        if frames > 0 {
            self.shared.act(|core, now| {
                core.counters.lost += u64::from(frames);
                core.input(&Input::Lost(frames), now);
            });
        }
    }

    /// The controller behind the link has left the bus.
    pub fn bus_off(&self) {
        self.shared.act(|core, now| core.input(&Input::BusOff, now));
    }

    /// The error counters of the controller behind the link.
    pub fn errors(&self, errors: ErrorCounters) {
        self.shared.act(|core, now| core.input(&Input::Errors(errors), now));
    }

    /// Waits until there is something to do for a link that cannot withdraw what it was handed: the next frame.
    /// Cancelling the wait loses none.
    pub async fn next_frame(&self) -> (Mailbox, Frame) {
        loop {
            if let Handover::Send(mailbox, frame) = self.next(false).await {
                return (mailbox, frame);
            }
        }
    }

    /// As [`next_frame`](Self::next_frame), for a link that can withdraw.
    pub async fn next_handover(&self) -> Handover {
        self.next(true).await
    }

    async fn next(&self, link_withdraws: bool) -> Handover {
        loop {
            if let Some(handover) = self.shared.hand_over(link_withdraws) {
                return handover;
            }
            self.shared.link_wake.notified().await;
        }
    }

    /// What became of a frame that was handed over. One that was not is ignored.
    pub fn conclude(&self, mailbox: Mailbox, outcome: Outcome) {
        self.shared.act(|core, now| core.conclude(mailbox, outcome, now));
    }

    /// A frame that was handed over went nowhere.
    pub fn unsent(&self) {
        self.shared.look(|core| core.counters.unsent += 1);
    }
}

/// Runs a link, again and again.
pub(crate) async fn keep_connected(mut link: impl Link, shared: Arc<Shared>) {
    let port = Port { shared };
    let mut pause = FIRST_PAUSE;
    let mut told = None;
    loop {
        let connections = port.shared.look(|core| core.counters.connections);
        let error = link.run(&port).await;
        port.shared.act(|core, now| core.disconnected(now));
        if error.is_final {
            tracing::info!("{error}");
            return;
        }
        if port.shared.look(|core| core.counters.connections) > connections {
            (pause, told) = (FIRST_PAUSE, None);
        }
        // Once for each reason, so that a link that is down for days does not fill a log.
        if told.as_ref() != Some(&error) {
            tracing::warn!("{error}; trying again");
            told = Some(error);
        }
        tokio::time::sleep(pause).await;
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

/// How long a link that cannot withdraw takes a frame to be under way: as long as the longest of its length needs. So
/// there is never more than one in the adapter that is not on the bus.
pub(crate) fn time_on_the_bus(frame: &Frame, bit_rate: BitRate) -> Duration {
    Duration::from_nanos(bit_rate.longest_frame(frame.payload.len()).as_ticks())
}

/// Before the second attempt to connect.
pub const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// Before the later ones.
pub const LONGEST_PAUSE: Duration = Duration::from_secs(5);
