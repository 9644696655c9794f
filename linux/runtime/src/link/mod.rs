//! Links: how a node reaches its segment.
//!
//! A [`Link`] carries frames between a [`Port`] of the node and whatever is at the other end, for the time of one
//! connection. The node starts it again when that has ended, after a pause that grows to [`LONGEST_PAUSE`]. Parsers of
//! what comes from outside take a bounded number of bytes and never panic; what they do not understand is counted.

mod address;
mod bell;
pub mod candump;
pub mod segment;
pub mod slcan;
pub mod socketcan;
pub mod socketcand;

use std::fmt;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_core::can::{BitRate, ErrorCounters, Frame, Mailbox, Outcome};

pub use crate::places::Handover;
pub use address::{ADDRESSES, AnyLink, LinkAddress};
pub(crate) use bell::Bell;

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

    /// Returns whether it is not tried again.
    pub const fn is_final(&self) -> bool {
        self.is_final
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

/// What is at this end of a link: a node, or a [`Tap`](crate::Tap).
pub(crate) trait End: Send + Sync {
    fn connected(&self);
    fn disconnected(&self, why: &LinkError);
    /// `stamp`: when, by the clock of the link, if it has one.
    fn received(&self, frame: &Frame, stamp: Option<Duration>);
    fn foreign(&self, frame: Option<&WireFrame>, stamp: Option<Duration>);
    fn malformed(&self);
    fn lost(&self, frames: u32);
    fn bus_off(&self);
    fn errors(&self, errors: ErrorCounters);
    fn hand_over(&self, link_withdraws: bool) -> Option<Handover>;
    /// Rung when there may be something to hand over.
    fn bell(&self) -> &Bell;
    fn conclude(&self, mailbox: Mailbox, outcome: Outcome);
    fn unsent(&self);
    /// How often it was connected.
    fn connections(&self) -> u64;
}

/// The node, as its link sees it.
#[derive(Clone)]
pub struct Port {
    end: Arc<dyn End>,
}

impl Port {
    /// The connection stands.
    pub fn connected(&self) {
        self.end.connected();
    }

    /// A frame has arrived. The node stamps it now.
    pub fn received(&self, frame: &Frame) {
        self.end.received(frame, None);
    }

    /// A frame has arrived that the link has stamped by a clock of its own, which goes on for as long as the connection
    /// stands. A node stamps it now, for its time-outs are by its own clock; a [`Tap`](crate::Tap) keeps the stamp.
    pub fn received_at(&self, frame: &Frame, stamp: Duration) {
        self.end.received(frame, Some(stamp));
    }

    /// A frame has arrived that COSMIC does not use.
    pub fn foreign(&self) {
        self.end.foreign(None, None);
    }

    /// As [`foreign`](Self::foreign), for a link that knows what it was, and when.
    pub fn foreign_at(&self, frame: &WireFrame, stamp: Duration) {
        self.end.foreign(Some(frame), Some(stamp));
    }

    /// Something has arrived that means nothing.
    pub fn malformed(&self) {
        self.end.malformed();
    }

    /// So many frames were lost on the way here.
    pub fn lost(&self, frames: u32) {
        if frames > 0 {
            self.end.lost(frames);
        }
    }

    /// The controller behind the link has left the bus.
    pub fn bus_off(&self) {
        self.end.bus_off();
    }

    /// The error counters of the controller behind the link.
    pub fn errors(&self, errors: ErrorCounters) {
        self.end.errors(errors);
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
            if let Some(handover) = self.end.hand_over(link_withdraws) {
                return handover;
            }
            self.end.bell().rung().await;
        }
    }

    /// From now on this writes what is due, and at once what is due already; until what is returned is dropped.
    fn leave(&self, outgoing: Box<dyn bell::Outgoing>) -> bell::Left<'_> {
        let left = self.end.bell().leave(outgoing);
        self.ring();
        left
    }

    /// There may be something to send, and room for it.
    fn ring(&self) {
        self.end.bell().ring(&*self.end);
    }

    /// What became of a frame that was handed over. One that was not is ignored.
    pub fn conclude(&self, mailbox: Mailbox, outcome: Outcome) {
        self.end.conclude(mailbox, outcome);
    }

    /// A frame that was handed over went nowhere.
    pub fn unsent(&self) {
        self.end.unsent();
    }
}

/// Runs a link, again and again.
pub(crate) async fn keep_connected(mut link: impl Link, end: Arc<dyn End>) {
    let port = Port { end };
    let mut pause = FIRST_PAUSE;
    let mut told = None;
    loop {
        let connections = port.end.connections();
        let error = link.run(&port).await;
        port.end.disconnected(&error);
        if error.is_final {
            tracing::info!("{error}");
            return;
        }
        if port.end.connections() > connections {
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
