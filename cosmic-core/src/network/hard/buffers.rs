//! HRT message buffers: what the two halves of a node share.

use super::counters::{Counters, Exceptional};
use crate::can::{Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use crate::network::id_map::IdMap;
use crate::time::{Duration, GlobalClock, Instant};

/// A message buffer: one for each hard real-time channel and publisher that concern this node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BufferId(pub(super) u8);

impl BufferId {
    /// Less than the capacity of the buffers.
    pub(crate) const fn index(self) -> usize {
        self.0 as usize
    }
}

/// What a node has to do with a hard real-time channel.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Role {
    /// It publishes in the slot.
    pub publishes: bool,
    /// It wants what is published in the slot.
    pub subscribes: bool,
}

impl Role {
    /// Only subscribes.
    const SUBSCRIBER: Self = Self { publishes: false, subscribes: true };
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Buffer {
    pub(super) id: Id,
    pub(super) role: Role,
    /// Published last.
    outgoing: Payload,
    /// It has not been loaded yet.
    pub(super) fresh: bool,
    /// Loaded; kept until the outcome is known, for local subscribers.
    in_mailbox: Payload,
    /// Received in the slot that is open, not yet visible.
    pub(super) arriving: Option<(Payload, Instant)>,
    /// Visible, not yet fetched.
    pub(super) visible: Option<Payload>,
    pub(super) window: Duration,
    pub(super) counters: Counters,
    /// The event layer has not seen all exceptional counts yet.
    is_exceptional: bool,
}

/// A slot of the calendar in which this node takes part, as the dispatcher needs it.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalSlot {
    pub(super) buffer: u8,
    pub(super) periodic: bool,
    pub(super) period: Duration,
    pub(super) phase: Duration,
    /// When a frame must have been sent, and when it is delivered, from the ready instant on.
    pub(super) deadline: Duration,
    pub(super) delivery: Duration,
    /// The revision with which it was attached.
    pub(super) attached: u32,
}

impl LocalSlot {
    /// Returns whether an instant of the slot cannot be as far from now as this, in nanoseconds, while the clock
    /// is not set and the dispatcher comes in time.
    #[inline]
    pub(super) const fn is_far(&self, distance: i64) -> bool {
        // Nearly always ahead, by less than a period: found out first, since it takes less.
        distance.cast_unsigned() > self.period.as_ticks()
            && distance.unsigned_abs() > self.period.as_ticks().saturating_add(self.delivery.as_ticks())
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum HardMailbox {
    Empty,
    Loaded(u8),
    Withdrawing(u8),
    /// Loaded, but its buffer is gone.
    Orphaned,
    /// Being withdrawn, and counted already: what becomes of it concerns no buffer.
    Abandoned,
}

/// The message buffers of a node, for up to `N` slots of the calendar; `N` is a power of two.
///
/// Built first, in any order and at any time: [`attach`](Self::attach) and [`detach`](Self::detach), by
/// the event layer. Then, by
///
/// * the event layer: [`publish`](Self::publish), [`take`](Self::take), [`counters`](Self::counters),
///   [`set_clock`](Self::set_clock), [`inhibit`](Self::inhibit);
/// * the receive interrupt: [`on_frame`](Self::on_frame);
/// * the transmit interrupt: [`on_outcome`](Self::on_outcome);
/// * the dispatcher, in [`Dispatcher::poll`](super::Dispatcher::poll).
///
/// All are O(1), but for `attach` and `detach`, which are O(N); the event half makes them in steps.
#[derive(Clone, Debug)]
pub struct HrtBuffers<const N: usize> {
    pub(super) buffers: [Option<Buffer>; N],
    pub(super) by_id: IdMap<8, N>,
    pub(super) slots: [Option<LocalSlot>; N],
    /// Counts changes of `slots` and `clock`, so that the dispatcher sees them.
    pub(super) revision: u32,
    pub(super) mailbox: HardMailbox,
    pub(super) clock: GlobalClock,
    pub(super) inhibited: bool,
}

impl<const N: usize> HrtBuffers<N> {
    /// Buffers of a node that takes part in no slot yet.
    pub const fn new(clock: GlobalClock) -> Self {
        const { assert!(N <= 128, "at most 128 slots concern one node") };
        Self {
            buffers: [None; N],
            by_id: IdMap::new(),
            slots: [None; N],
            revision: 0,
            mailbox: HardMailbox::Empty,
            clock,
            inhibited: false,
        }
    }

    /// Puts an event into the buffer, to be sent in the next slot. An older one that is still there is
    /// replaced and counted; says whether there was one.
    #[inline]
    pub fn publish(&mut self, id: BufferId, payload: Payload) -> bool {
        let Some(buffer) = self.buffer_mut(id.0) else { return false };
        buffer.outgoing = payload;
        let replaced = core::mem::replace(&mut buffer.fresh, true);
        if replaced {
            buffer.counters.replaced = buffer.counters.replaced.wrapping_add(1);
        }
        replaced
    }

    /// Takes back the event that waits for its slot. Returns whether there was one, and the node whose slots the
    /// buffer has.
    pub(crate) fn recall(&mut self, id: BufferId) -> (bool, Option<TxNode>) {
        let Some(buffer) = self.buffer_mut(id.0) else { return (false, None) };
        (core::mem::take(&mut buffer.fresh), Some(buffer.id.tx_node()))
    }

    /// Fetches the event that became visible last, once: the frame that brought it.
    #[inline]
    pub fn take(&mut self, id: BufferId) -> Option<Frame> {
        let buffer = self.buffer_mut(id.0)?;
        Some(Frame::new(buffer.id, buffer.visible.take()?))
    }

    /// What has happened in the slots of this buffer.
    pub fn counters(&self, id: BufferId) -> Option<Counters> {
        Some(self.buffer(id.0)?.counters)
    }

    /// Returns whether something exceptional has been counted since [`take_exceptional`](Self::take_exceptional).
    #[inline]
    pub(crate) fn is_exceptional(&self, id: BufferId) -> bool {
        self.buffer(id.0).is_some_and(|buffer| buffer.is_exceptional)
    }

    /// The channel of a buffer, and what is exceptional of what has happened in its slots.
    pub(crate) fn take_exceptional(&mut self, id: BufferId) -> Option<(Etag, Exceptional)> {
        let buffer = self.buffer_mut(id.0)?;
        buffer.is_exceptional = false;
        Some((buffer.id.etag(), buffer.counters.exceptional()))
    }

    /// The present copy of the clock's parameters.
    #[inline]
    pub const fn clock(&self) -> &GlobalClock {
        &self.clock
    }

    /// A new copy of the clock's parameters.
    pub fn set_clock(&mut self, clock: GlobalClock) {
        self.clock = clock;
        self.revision = self.revision.wrapping_add(1);
    }

    /// Keeps the node silent in all its slots, or lets it speak again; for a node whose calendar is not
    /// that of the segment.
    pub fn inhibit(&mut self, inhibited: bool) {
        self.inhibited = inhibited;
    }

    /// Returns whether the node keeps silent because its calendar is not that of the segment.
    pub const fn is_inhibited(&self) -> bool {
        self.inhibited
    }

    /// The channel of a buffer.
    pub fn etag(&self, id: BufferId) -> Option<Etag> {
        Some(self.buffer(id.0)?.id.etag())
    }

    /// A frame has arrived from the bus. Returns whether it belongs to a buffer of this node that subscribes
    /// to it. Not to one in which this node publishes: no node hears itself, so such a frame is of another
    /// node with the same TxNode, and the event-triggered half must see it.
    ///
    /// The first copy in a window is kept, until its delivery instant. At most one map look-up.
    #[inline]
    pub fn on_frame(&mut self, frame: &Frame, received_at: Instant) -> bool {
        if frame.id.priority() != Priority::HARD {
            return false;
        }
        let Some(at) = self.by_id.get(frame.id.raw()) else { return false };
        match self.buffer_mut(at as u8) {
            Some(buffer) if buffer.role == Role::SUBSCRIBER => {
                buffer.arrived(frame.payload, received_at);
                true
            }
            _ => false,
        }
    }

    /// The HRT mailbox has become empty. Returns the buffer if the event layer must hear of it: the event
    /// was not sent.
    pub fn on_outcome(&mut self, outcome: Outcome, at: Instant) -> Option<BufferId> {
        let (loaded, in_time) = match self.mailbox {
            HardMailbox::Loaded(buffer) => (buffer, true),
            HardMailbox::Withdrawing(buffer) => (buffer, false),
            HardMailbox::Empty => return None,
            HardMailbox::Orphaned | HardMailbox::Abandoned => {
                self.mailbox = HardMailbox::Empty;
                return None;
            }
        };
        self.mailbox = HardMailbox::Empty;
        let buffer = self.buffer_mut(loaded)?;
        if outcome == Outcome::Sent && buffer.role.subscribes {
            buffer.arrived(buffer.in_mailbox, at);
        }
        if outcome == Outcome::Sent && in_time {
            buffer.counters.sent = buffer.counters.sent.wrapping_add(1);
            return None;
        }
        // A frame that was on the wire at its deadline and is sent after all may come too late for some.
        buffer.count(|counters| &mut counters.omitted);
        Some(BufferId(loaded))
    }

    /// The buffer of a channel and publisher, if this node takes part in one of its slots.
    pub fn find(&self, etag: Etag, publisher: TxNode) -> Option<BufferId> {
        self.by_id.get(Id::new(Priority::HARD, publisher, etag).raw()).map(|at| BufferId(at as u8))
    }

    /// What the dispatcher works on, in parts that can be held at once.
    #[inline]
    pub(super) fn parts_mut(
        &mut self,
    ) -> (&[Option<LocalSlot>; N], &mut [Option<Buffer>; N], &mut HardMailbox) {
        (&self.slots, &mut self.buffers, &mut self.mailbox)
    }

    #[inline]
    pub(super) fn buffer(&self, at: u8) -> Option<&Buffer> {
        self.buffers.get(usize::from(at))?.as_ref()
    }

    #[inline]
    pub(super) fn buffer_mut(&mut self, at: u8) -> Option<&mut Buffer> {
        self.buffers.get_mut(usize::from(at))?.as_mut()
    }
}

impl Buffer {
    pub(super) const fn new(id: Id) -> Self {
        Self {
            id,
            role: Role { publishes: false, subscribes: false },
            outgoing: Payload::EMPTY,
            fresh: false,
            in_mailbox: Payload::EMPTY,
            arriving: None,
            visible: None,
            window: Duration::from_ticks(0),
            counters: Counters::NONE,
            is_exceptional: false,
        }
    }

    /// Counts something that the application hears of as an exception.
    pub(super) fn count(&mut self, which: impl FnOnce(&mut Counters) -> &mut u32) {
        let count = which(&mut self.counters);
        *count = count.wrapping_add(1);
        self.is_exceptional = true;
    }

    /// Takes the fresh event, to be sent.
    #[inline]
    pub(super) fn load(&mut self) -> Frame {
        self.fresh = false;
        self.in_mailbox = self.outgoing;
        Frame::new(self.id, self.outgoing)
    }

    #[inline]
    fn arrived(&mut self, payload: Payload, received_at: Instant) {
        match self.arriving {
            Some((kept, first)) if received_at.saturating_since(first) <= self.window => {
                // A retransmission, since some node had rejected the first copy; or no copy at all.
                if kept == payload {
                    self.counters.duplicates = self.counters.duplicates.wrapping_add(1);
                } else {
                    self.count(|counters| &mut counters.contradictory);
                }
            }
            stale => {
                if stale.is_some() {
                    self.counters.untimely = self.counters.untimely.wrapping_add(1);
                }
                self.arriving = Some((payload, received_at));
            }
        }
    }

    /// Gives up what a slot of this buffer was about, since the clock was set; `open`: it had begun. Returns
    /// whether there was anything.
    pub(super) fn give_up(&mut self, open: bool) -> bool {
        let arrived = self.arriving.take().is_some();
        if arrived {
            self.counters.untimely = self.counters.untimely.wrapping_add(1);
        }
        if open && self.role.subscribes {
            self.count(|counters| &mut counters.skipped);
        }
        arrived || open
    }

    /// The window has opened: what arrived before is of no slot, and must not pass for the first copy of what is to
    /// come.
    pub(super) fn forget_early(&mut self, opened: Instant) {
        if self.arriving.take_if(|(_, received_at)| *received_at < opened).is_some() {
            self.counters.untimely = self.counters.untimely.wrapping_add(1);
        }
    }

    /// Makes what arrived since `opened` visible. Says whether there was anything.
    #[inline]
    pub(super) fn deliver(&mut self, opened: Instant) -> bool {
        let Some((payload, received_at)) = &self.arriving else { return false };
        if *received_at < opened {
            self.arriving = None;
            self.counters.untimely = self.counters.untimely.wrapping_add(1);
            return false;
        }
        let before = self.visible.replace(*payload);
        self.arriving = None;
        if before.is_some() {
            self.count(|counters| &mut counters.overrun);
        }
        self.counters.delivered = self.counters.delivered.wrapping_add(1);
        true
    }
}

/// The only mailbox that the time-triggered half uses.
pub(super) const MAILBOX: Mailbox = Mailbox::Hard;
