//! The receiving side: messages of several publishers and channels at once.

use super::{CRC_LEN, CRC_START, Header, PIECE, SEQUENCE_MASK, continue_crc};
use crate::can::{Etag, Frame, Payload, TxNode};
use crate::time::{Duration, Instant};

/// A complete message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Message<'a> {
    /// The channel.
    pub etag: Etag,
    /// The sender.
    pub publisher: TxNode,
    /// The bytes as they were published.
    pub content: &'a [u8],
}

/// What was delivered and what was dropped. Each stays at its largest value when it gets there.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReassemblyCounters {
    /// Messages delivered.
    pub delivered: u32,
    /// Frames that came twice and were ignored.
    pub duplicates: u32,
    /// Messages dropped because a frame was missing or the next message began.
    pub incomplete: u32,
    /// Messages dropped because nothing more came.
    pub timed_out: u32,
    /// Messages dropped because all places were taken by others.
    pub no_room: u32,
    /// Messages dropped because they are longer than there is room for.
    pub too_long: u32,
    /// Messages dropped because their CRC did not fit.
    pub corrupt: u32,
    /// Frames of messages whose start was missed or that were dropped before.
    pub orphans: u32,
    /// Frames that cannot stem from a fragmenter: empty, or of a wrong length or number.
    pub malformed: u32,
}

/// Puts messages of up to `LEN` bytes together, up to `PLACES` at once.
///
/// Needs a place for each publisher that may be sending a message of more than one frame at one time.
/// Work of each call: a look at each place, and one frame.
#[derive(Clone, Debug)]
pub struct Reassembler<const PLACES: usize, const LEN: usize> {
    places: [Place<LEN>; PLACES],
    /// The last frames of recent messages, to recognise repetitions.
    recent: [Option<(Frame, Instant)>; PLACES],
    next_recent: usize,
    short: Payload,
    time_out: Duration,
    counters: ReassemblyCounters,
}

#[derive(Clone, Debug)]
struct Place<const LEN: usize> {
    progress: Option<Progress>,
    content: [u8; LEN],
}

/// Of a message that has begun.
#[derive(Clone, Copy, Debug)]
struct Progress {
    last_frame: Frame,
    last_at: Instant,
    /// Bytes received, CRC included. Those that would not fit are CRC, or the message is too long.
    len: usize,
    crc: u16,
    message: u8,
    next: u8,
}

impl<const PLACES: usize, const LEN: usize> Reassembler<PLACES, LEN> {
    /// Empty. A message is dropped when none of its frames comes for `time_out`, which should be longer
    /// than the bus is ever kept from non real-time traffic.
    pub const fn new(time_out: Duration) -> Self {
        Self {
            places: [const { Place { progress: None, content: [0; LEN] } }; PLACES],
            recent: [None; PLACES],
            next_recent: 0,
            short: Payload::EMPTY,
            time_out,
            counters: ReassemblyCounters {
                delivered: 0,
                duplicates: 0,
                incomplete: 0,
                timed_out: 0,
                no_room: 0,
                too_long: 0,
                corrupt: 0,
                orphans: 0,
                malformed: 0,
            },
        }
    }

    /// What was delivered and dropped.
    pub const fn counters(&self) -> &ReassemblyCounters {
        &self.counters
    }

    /// Takes a frame of a channel of messages; returns the message that it completes.
    pub fn on_frame(&mut self, frame: &Frame, now: Instant) -> Option<Message<'_>> {
        self.on_time(now);
        let Some((&header, piece)) = frame.payload.as_slice().split_first() else {
            count(&mut self.counters.malformed);
            return None;
        };
        let header = Header::decode(header);
        if !is_well_formed(header, piece) {
            count(&mut self.counters.malformed);
            return None;
        }
        if header.last && self.recent.iter().flatten().any(|(seen, _)| seen == frame) {
            count(&mut self.counters.duplicates);
            return None;
        }
        if header.first {
            return self.on_first(frame, header, now);
        }
        let Some(place) = self.place_of(frame) else {
            count(&mut self.counters.orphans);
            return None;
        };
        self.on_next(place, frame, header, piece, now)
    }

    /// Drops messages of which nothing has come for too long. [`Reassembler::on_frame`] does so, too.
    pub fn on_time(&mut self, now: Instant) {
        for place in &mut self.places {
            let stale = place
                .progress
                .is_some_and(|progress| now.saturating_since(progress.last_at) >= self.time_out);
            if stale {
                place.progress = None;
                count(&mut self.counters.timed_out);
            }
        }
        for recent in &mut self.recent {
            *recent = recent.filter(|(_, at)| now.saturating_since(*at) < self.time_out);
        }
    }

    /// When [`Reassembler::on_time`] has something to do, if no frame comes before.
    pub fn next_wakeup(&self) -> Instant {
        let progress = self.places.iter().filter_map(|place| place.progress);
        progress.map(|progress| progress.last_at + self.time_out).min().unwrap_or(Instant::FAR_FUTURE)
    }

    fn place_of(&self, frame: &Frame) -> Option<usize> {
        self.places.iter().position(|place| {
            place.progress.is_some_and(|progress| same_channel(&progress.last_frame, frame))
        })
    }

    #[expect(clippy::arithmetic_side_effects, reason = "lengths of arrays")]
    fn on_first(&mut self, frame: &Frame, header: Header, now: Instant) -> Option<Message<'_>> {
        let place = self.place_of(frame);
        if let Some(progress) = place.and_then(|place| self.places.get(place)?.progress) {
            if progress.last_frame == *frame {
                count(&mut self.counters.duplicates);
                return None;
            }
            // The publisher has given up the message before, or its end was lost.
            self.drop_message(place, |counters| &mut counters.incomplete);
        }
        if header.last {
            self.remember(frame, now);
            self.short = frame.payload;
            count(&mut self.counters.delivered);
            return Some(message(frame, self.short.as_slice().get(1..).unwrap_or(&[])));
        }
        if PIECE > LEN + CRC_LEN {
            count(&mut self.counters.too_long);
            return None;
        }
        let Some(place) = self.places.iter_mut().find(|place| place.progress.is_none()) else {
            count(&mut self.counters.no_room);
            return None;
        };
        let mut progress = Progress {
            last_frame: *frame,
            last_at: now,
            len: 0,
            crc: CRC_START,
            message: header.message,
            next: 1,
        };
        place.store(&mut progress, frame);
        place.progress = Some(progress);
        None
    }

    #[expect(clippy::arithmetic_side_effects, reason = "at most `LEN + CRC_LEN`, and seven more")]
    fn on_next(
        &mut self,
        number: usize,
        frame: &Frame,
        header: Header,
        piece: &[u8],
        now: Instant,
    ) -> Option<Message<'_>> {
        let place = self.places.get_mut(number)?;
        let mut progress = place.progress?;
        if progress.last_frame == *frame {
            count(&mut self.counters.duplicates);
            return None;
        }
        if header.message != progress.message || header.sequence != progress.next {
            self.drop_message(Some(number), |counters| &mut counters.incomplete);
            count(&mut self.counters.orphans);
            return None;
        }
        if progress.len + piece.len() > LEN + CRC_LEN {
            self.drop_message(Some(number), |counters| &mut counters.too_long);
            return None;
        }
        place.store(&mut progress, frame);
        progress.next = header.sequence.wrapping_add(1) & SEQUENCE_MASK;
        progress.last_frame = *frame;
        progress.last_at = now;
        place.progress = Some(progress);
        if header.last { self.complete(number, &progress, now) } else { None }
    }

    fn complete(&mut self, number: usize, progress: &Progress, now: Instant) -> Option<Message<'_>> {
        // Over a message and its CRC, the CRC is zero.
        if progress.crc != 0 {
            self.drop_message(Some(number), |counters| &mut counters.corrupt);
            return None;
        }
        let frame = progress.last_frame;
        self.remember(&frame, now);
        count(&mut self.counters.delivered);
        let place = self.places.get_mut(number)?;
        place.progress = None;
        Some(message(&frame, place.content.get(..progress.len.saturating_sub(CRC_LEN))?))
    }

    fn drop_message(
        &mut self,
        place: Option<usize>,
        counter: impl FnOnce(&mut ReassemblyCounters) -> &mut u32,
    ) {
        count(counter(&mut self.counters));
        if let Some(place) = place.and_then(|place| self.places.get_mut(place)) {
            place.progress = None;
        }
    }

    #[expect(clippy::arithmetic_side_effects, reason = "a position below `PLACES`")]
    fn remember(&mut self, frame: &Frame, now: Instant) {
        let of_channel =
            self.recent.iter().position(|seen| seen.is_some_and(|(seen, _)| same_channel(&seen, frame)));
        let place = of_channel.unwrap_or_else(|| {
            self.next_recent = (self.next_recent + 1) % PLACES.max(1);
            self.next_recent
        });
        if let Some(recent) = self.recent.get_mut(place) {
            *recent = Some((*frame, now));
        }
    }
}

impl<const LEN: usize> Place<LEN> {
    /// Appends the piece of a frame. What goes beyond the content is CRC, which need not be kept.
    #[expect(clippy::arithmetic_side_effects, reason = "the caller asked for room")]
    fn store(&mut self, progress: &mut Progress, frame: &Frame) {
        let piece = frame.payload.as_slice().get(1..).unwrap_or(&[]);
        let room = self.content.get_mut(progress.len..).unwrap_or(&mut []);
        for (byte, value) in room.iter_mut().zip(piece) {
            *byte = *value;
        }
        progress.len += piece.len();
        progress.crc = continue_crc(progress.crc, piece);
    }
}

fn message<'a>(frame: &Frame, content: &'a [u8]) -> Message<'a> {
    Message { etag: frame.id.etag(), publisher: frame.id.tx_node(), content }
}

/// The importance of a message may change from one frame to the next; its etag and sender do not.
fn same_channel(one: &Frame, other: &Frame) -> bool {
    one.id.etag() == other.id.etag() && one.id.tx_node() == other.id.tx_node()
}

fn is_well_formed(header: Header, piece: &[u8]) -> bool {
    let first = !header.first || header.sequence == 0;
    let full = header.last || piece.len() == PIECE;
    let alone = header.first && header.last;
    // A message of several frames ends with at least one byte of its CRC.
    first && full && (alone || !piece.is_empty())
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
