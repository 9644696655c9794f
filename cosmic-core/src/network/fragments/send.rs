//! The sending side: one message at a time, one frame at a time.

use super::{CRC_LEN, CRC_START, Header, PIECE, continue_crc};
use crate::can::Payload;

/// Why a message was not accepted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StartError {
    /// The message before it is still being sent; try again when [`Fragmenter::is_idle`].
    Busy,
    /// It is longer than the capacity of the fragmenter.
    TooLong,
}

/// Cuts messages of up to `LEN` bytes into frames. One for each channel of messages that a node publishes.
///
/// [`Fragmenter::poll`] gives out a frame; nothing more comes until [`Fragmenter::on_sent`] tells that it
/// was sent, or [`Fragmenter::on_discarded`] that it was not. All work is bounded by one frame, but for
/// the copy of the message in [`Fragmenter::start`].
#[derive(Clone, Debug)]
pub struct Fragmenter<const LEN: usize> {
    content: [u8; LEN],
    len: usize,
    /// Bytes of content and CRC that were given out.
    done: usize,
    crc: u16,
    message: u8,
    sequence: u8,
    state: State,
    discarded: u32,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Idle,
    /// The next frame may be fetched.
    Ready,
    /// A frame is out.
    Waiting {
        last: bool,
    },
}

impl<const LEN: usize> Fragmenter<LEN> {
    /// With no message.
    pub const fn new() -> Self {
        Self {
            content: [0; LEN],
            len: 0,
            done: 0,
            crc: CRC_START,
            message: 0,
            sequence: 0,
            state: State::Idle,
            discarded: 0,
        }
    }

    /// Returns whether a message can be accepted.
    pub fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// Returns whether nothing of the message has been given out.
    pub(crate) const fn is_at_first(&self) -> bool {
        self.sequence == 0 && self.done == 0
    }

    /// Messages of which a frame was discarded, so that nobody received them.
    pub const fn discarded(&self) -> u32 {
        self.discarded
    }

    /// Copies a message, to be sent frame by frame.
    ///
    /// # Errors
    /// If it is too long, or the one before it is not yet sent. Then nothing has changed.
    pub fn start(&mut self, content: &[u8]) -> Result<(), StartError> {
        self.start_with(content.len(), |place| {
            place.copy_from_slice(content);
            content.len()
        })
    }

    /// As [`start`](Self::start), with a message that `write` writes into a place of `room` bytes; it returns how
    /// many it has written.
    ///
    /// # Errors
    /// As there.
    pub fn start_with(
        &mut self,
        room: usize,
        write: impl FnOnce(&mut [u8]) -> usize,
    ) -> Result<(), StartError> {
        if !self.is_idle() {
            return Err(StartError::Busy);
        }
        self.len = write(self.content.get_mut(..room).ok_or(StartError::TooLong)?).min(room);
        self.done = 0;
        self.crc = CRC_START;
        self.sequence = 0;
        self.state = State::Ready;
        Ok(())
    }

    /// The next frame's data, if the one before was sent.
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "lengths of at most 64 KiB, and `done <= upto <= done + PIECE`"
    )]
    pub fn poll(&mut self) -> Option<Payload> {
        if self.state != State::Ready {
            return None;
        }
        let end = if self.len > PIECE { self.len + CRC_LEN } else { self.len };
        let upto = (self.done + PIECE).min(end);
        let last = upto == end;
        let rest = self.content.get(self.done.min(self.len)..upto.min(self.len)).unwrap_or(&[]);
        self.crc = continue_crc(self.crc, rest);
        // What is not content is CRC; its second byte may stand alone in the last frame.
        let crc = self.crc.to_be_bytes().into_iter().skip(self.done.saturating_sub(self.len));
        let header = Header { first: self.done == 0, last, message: self.message, sequence: self.sequence };
        let mut bytes = [0; Payload::MAX_LEN];
        let stream = core::iter::once(header.encode()).chain(rest.iter().copied()).chain(crc);
        for (byte, value) in bytes.iter_mut().zip(stream) {
            *byte = value;
        }
        let payload = Payload::truncated(bytes, 1 + upto - self.done);
        self.done = upto;
        self.sequence = self.sequence.wrapping_add(1);
        self.state = State::Waiting { last };
        Some(payload)
    }

    /// The frame that is out was sent.
    pub fn on_sent(&mut self) {
        match self.state {
            State::Waiting { last: true } => self.finish(),
            State::Waiting { last: false } => self.state = State::Ready,
            State::Idle | State::Ready => {}
        }
    }

    /// The frame that is out was discarded, or the message is not wanted any more. Its rest is not sent;
    /// receivers drop what they have when the next message begins, or after their time-out.
    pub fn on_discarded(&mut self) {
        if !self.is_idle() {
            self.discarded = self.discarded.saturating_add(1);
            self.finish();
        }
    }

    fn finish(&mut self) {
        self.state = State::Idle;
        self.message = self.message.wrapping_add(1);
    }
}

impl<const LEN: usize> Default for Fragmenter<LEN> {
    fn default() -> Self {
        Self::new()
    }
}
