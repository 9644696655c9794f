//! Messages of several frames, put together as their subscribers do.
//!
//! Which channels carry messages only the plan says: a frame of a message looks like any event.

use cosmic_core::can::{Etag, Frame, TxNode};
use cosmic_core::network::fragments::{MAX_MESSAGE_LEN, Reassembler, ReassemblyCounters};
use cosmic_core::time::{Duration, Instant};

use crate::digits::hex_text;
use crate::snapshot::MessagesView;

/// The messages that are on their way, and the last whole one.
#[derive(Clone, Debug)]
pub(crate) struct Messages {
    reassembler: Box<Reassembler<PLACES, MAX_MESSAGE_LEN>>,
    /// The message that the last frame has completed.
    whole: Option<Whole>,
}

/// A message.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Whole {
    pub(crate) etag: Etag,
    pub(crate) tx_node: TxNode,
    pub(crate) at: Instant,
    pub(crate) content: Vec<u8>,
}

impl Whole {
    /// Its bytes, hexadecimal.
    pub(crate) fn data(&self) -> String {
        hex_text(&self.content)
    }
}

impl Messages {
    pub(crate) fn new() -> Self {
        Self { reassembler: Box::new(Reassembler::new(TIME_OUT)), whole: None }
    }

    /// Another frame comes, of whatever channel.
    pub(crate) fn forget_whole(&mut self) {
        self.whole = None;
    }

    /// Takes a frame of a channel of messages; returns the message that it completes. Linear in [`PLACES`].
    pub(crate) fn on_frame(&mut self, frame: &Frame, at: Instant) -> Option<&Whole> {
        let message = self.reassembler.on_frame(frame, at)?;
        let (etag, tx_node, content) = (message.etag, message.publisher, message.content.to_vec());
        self.whole = Some(Whole { etag, tx_node, at, content });
        self.whole.as_ref()
    }

    pub(crate) const fn whole(&self) -> Option<&Whole> {
        self.whole.as_ref()
    }

    pub(crate) fn view(&self) -> MessagesView {
        let ReassemblyCounters {
            delivered,
            duplicates: _,
            incomplete,
            timed_out,
            no_room,
            too_long,
            corrupt,
            orphans,
            malformed,
        } = *self.reassembler.counters();
        let dropped = [incomplete, timed_out, no_room, too_long, corrupt];
        let stray = [orphans, malformed];
        MessagesView {
            whole: delivered.into(),
            dropped: dropped.into_iter().map(u64::from).sum(),
            stray_frames: stray.into_iter().map(u64::from).sum(),
        }
    }
}

/// So many messages of several frames may be on their way at once.
const PLACES: usize = 32;
/// A message of which nothing has come for so long is given up, as a node does.
const TIME_OUT: Duration = Duration::from_secs(2);
