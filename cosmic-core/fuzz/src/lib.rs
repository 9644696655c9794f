//! What the fuzz targets share: a script of frames, calls and pauses, read from the fuzzer's bytes.

use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::time::{Duration, Instant};
use cosmic_core::{NodeUid, Subject};

/// Reads a script from bytes; ends when they do.
pub struct Script<'a> {
    bytes: &'a [u8],
    /// Local time after the step that was read last.
    pub now: Instant,
}

/// One step of a script; the time of it is [`Script::now`].
pub enum Act {
    /// A frame arrives.
    Frame(Frame),
    /// The application makes its call of this number, with this argument.
    Call(u8, u8),
    /// Nothing but time.
    Pause,
}

impl<'a> Script<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, now: Instant::EPOCH }
    }

    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.bytes.split_first()?;
        self.bytes = rest;
        Some(*first)
    }

    fn payload(&mut self) -> Option<Payload> {
        let len = usize::from(self.byte()? % 9).min(self.bytes.len());
        let (data, rest) = self.bytes.split_at(len);
        self.bytes = rest;
        Payload::new(data)
    }

    /// A frame that is near a control message, or any at all.
    pub fn frame(&mut self) -> Option<Frame> {
        let form = self.byte()?;
        let id = if form < 0xC0 {
            let etag = Etag::new(u16::from(form % 26))?;
            let tx_node = self.byte()?;
            let priority = Priority::new(250 | tx_node >> 7);
            Id::new(priority, TxNode::new(tx_node & 0x7F)?, etag)
        } else {
            let raw = [form, self.byte()?, self.byte()?, self.byte()?];
            Id::from_raw(u32::from_be_bytes(raw) & 0x1FFF_FFFF)?
        };
        Some(Frame::new(id, self.payload()?))
    }

    /// A span from nothing to two minutes, in powers of two.
    fn pause(&mut self) -> Option<Duration> {
        let exponent = self.byte()? % 38;
        Some(Duration::from_ticks((1 << exponent) - 1))
    }
}

impl Iterator for Script<'_> {
    type Item = Act;

    fn next(&mut self) -> Option<Act> {
        let kind = self.byte()?;
        let span = self.pause()?;
        self.now = self.now + span;
        match kind {
            0..=191 => self.frame().map(Act::Frame),
            192..=239 => Some(Act::Call(kind - 192, self.byte()?)),
            240.. => Some(Act::Pause),
        }
    }
}

/// Polls until nothing is left, and checks that this ends and that the next wake-up lies ahead.
pub fn drain<Output>(now: Instant, mut poll: impl FnMut() -> Option<Output>, mut each: impl FnMut(Output)) {
    for _ in 0..MOST_OUTPUTS {
        match poll() {
            Some(output) => each(output),
            None => return,
        }
    }
    panic!("poll never ends at {now:?}");
}

/// A machine that asks to be woken in the past would keep its owner busy for ever.
pub fn check_wakeup(now: Instant, wakeup: Instant) {
    assert!(wakeup > now, "wakes at {wakeup:?}, which is not behind {now:?}");
}

/// A UID from a small set, so that the bytes hit the same one again.
pub fn uid(of: u8) -> NodeUid {
    NodeUid::new(u64::from(of % 8) + 1).unwrap()
}

/// A subject from a small set.
pub fn subject(of: u8) -> Subject {
    Subject::new(u64::from(of % 8) + 1).unwrap()
}

/// A TxNode, or none.
pub fn tx_node(of: u8) -> Option<TxNode> {
    TxNode::new(of).filter(|id| *id != TxNode::BROKER)
}

/// More than any machine has to say at one instant.
const MOST_OUTPUTS: usize = 1000;
