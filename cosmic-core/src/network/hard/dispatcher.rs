//! The calendar dispatcher: from one instant of the calendar to the next.

use super::buffers::{BufferId, HardMailbox, HrtBuffers, LocalSlot, MAILBOX};
use crate::calendar::Calendar;
use crate::can::Command;
use crate::time::{Duration, GlobalInstant, Instant};

/// What the task of the dispatcher is to do next.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Step {
    /// Have the driver carry this out, then poll again.
    Command(Command),
    /// Something in this buffer concerns the event layer: an event has become visible, or a count has
    /// changed. Wake it, then poll again.
    Notify(BufferId),
    /// An instant of the calendar has passed without anything to do. Poll again.
    Continue,
    /// Nothing is due before this instant. Poll again then; earlier does no harm.
    SleepUntil(Instant),
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    /// The next occurrence of the slot has not come.
    Ready,
    /// The frame is in the mailbox, or was.
    Deadline,
    /// The window is closing.
    Delivery,
}

#[derive(Clone, Copy, Debug)]
struct Occurrence {
    ready: GlobalInstant,
    stage: Stage,
    due: GlobalInstant,
    /// Which attachment of the slot this is of.
    attached: u32,
}

/// The calendar dispatcher and time-triggered channel handler (TTCH) of a node, for up to `N` slots. See
/// the [module](super) for the loop around it.
///
/// One `poll` handles one instant of one slot: O(N) compares of due times, and at most one frame copied.
#[derive(Clone, Debug)]
pub struct Dispatcher<const N: usize> {
    accuracy: Duration,
    release_jitter: Duration,
    gap: Duration,
    occurrences: [Option<Occurrence>; N],
    revision: u32,
}

impl<const N: usize> Dispatcher<N> {
    /// A task that sleeps longer would not see slots that were attached in the meantime, nor that the
    /// clock was set.
    pub const LONGEST_SLEEP: Duration = Duration::from_millis(20);

    /// A dispatcher for this calendar.
    pub const fn new(calendar: &Calendar) -> Self {
        let segment = calendar.segment();
        Self {
            accuracy: segment.accuracy,
            release_jitter: segment.release_jitter,
            gap: segment.gap(),
            occurrences: [None; N],
            revision: 0,
        }
    }

    /// Handles the earliest instant of the calendar that is due.
    pub fn poll(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> Step {
        let today = buffers.clock.to_global(now);
        if self.revision != buffers.revision {
            self.revise(today, buffers);
        }
        let Some((at, occurrence)) = self.earliest() else {
            return Step::SleepUntil(now + Self::LONGEST_SLEEP);
        };
        let Some(slot) = buffers.slots.get(at).copied().flatten() else { return Step::Continue };
        // An instant further away than a period, either way, is of a clock that has been set since.
        let distance = occurrence.due.signed_since(today).unsigned_abs();
        if distance > slot.period.as_ticks().saturating_add(slot.times.delivery.as_ticks()) {
            return self.realign(at, &slot, today, buffers);
        }
        if occurrence.due > today {
            let wake = buffers.clock.to_local(occurrence.due);
            return Step::SleepUntil(wake.min(now + Self::LONGEST_SLEEP));
        }
        match occurrence.stage {
            Stage::Ready => self.release(at, &slot, occurrence, now, buffers),
            Stage::Deadline => self.withdraw(at, &slot, occurrence, buffers),
            Stage::Delivery => self.deliver(at, &slot, occurrence, now, buffers),
        }
    }

    fn release(
        &mut self,
        at: usize,
        slot: &LocalSlot,
        occurrence: Occurrence,
        now: Instant,
        buffers: &mut HrtBuffers<N>,
    ) -> Step {
        let late = buffers.clock.to_global(now).saturating_since(occurrence.ready) > self.release_jitter;
        let silent = self.must_keep_silent(now, buffers);
        let mailbox_free = buffers.mailbox == HardMailbox::Empty;
        let Some(buffer) = buffers.buffer_mut(slot.buffer) else { return Step::Continue };
        let after = if buffer.role.subscribes { Stage::Delivery } else { Stage::Ready };
        let fresh = buffer.outgoing.is_some();
        if buffer.role.publishes && fresh && !silent && !late && mailbox_free {
            let frame = buffer.load();
            buffers.mailbox = HardMailbox::Loaded(slot.buffer);
            self.enter(at, slot, occurrence, Stage::Deadline);
            return Step::Command(Command::Load(MAILBOX, frame));
        }
        self.enter(at, slot, occurrence, after);
        if !buffer.role.publishes || !(fresh || slot.periodic) {
            return Step::Continue;
        }
        // What could not be sent in its slot is stale in the next.
        buffer.outgoing = None;
        let counters = &mut buffer.counters;
        let count = match () {
            () if !fresh => &mut counters.unused,
            () if silent => &mut counters.inhibited,
            () => &mut counters.skipped,
        };
        *count = count.wrapping_add(1);
        Step::Notify(BufferId(slot.buffer))
    }

    fn withdraw(
        &mut self,
        at: usize,
        slot: &LocalSlot,
        occurrence: Occurrence,
        buffers: &mut HrtBuffers<N>,
    ) -> Step {
        let subscribes = buffers.buffer(slot.buffer).is_some_and(|buffer| buffer.role.subscribes);
        self.enter(at, slot, occurrence, if subscribes { Stage::Delivery } else { Stage::Ready });
        if buffers.mailbox == HardMailbox::Loaded(slot.buffer) {
            buffers.mailbox = HardMailbox::Withdrawing(slot.buffer);
            return Step::Command(Command::Withdraw(MAILBOX));
        }
        Step::Continue
    }

    fn deliver(
        &mut self,
        at: usize,
        slot: &LocalSlot,
        occurrence: Occurrence,
        now: Instant,
        buffers: &mut HrtBuffers<N>,
    ) -> Step {
        let opened = buffers.clock.to_local(occurrence.ready.saturating_sub(self.gap));
        let silent = self.must_keep_silent(now, buffers);
        self.enter(at, slot, occurrence, Stage::Ready);
        let Some(buffer) = buffers.buffer_mut(slot.buffer) else { return Step::Continue };
        if silent {
            buffer.arriving = None;
            buffer.counters.inhibited = buffer.counters.inhibited.wrapping_add(1);
        } else if !buffer.deliver(opened, occurrence.due) {
            if !slot.periodic {
                return Step::Continue;
            }
            buffer.counters.missed = buffer.counters.missed.wrapping_add(1);
        }
        Step::Notify(BufferId(slot.buffer))
    }

    fn must_keep_silent(&self, now: Instant, buffers: &HrtBuffers<N>) -> bool {
        buffers.inhibited || buffers.clock.accuracy(now) > self.accuracy
    }

    /// Moves a slot on to the next stage of this occurrence, or to the next occurrence.
    fn enter(&mut self, at: usize, slot: &LocalSlot, occurrence: Occurrence, stage: Stage) {
        let (ready, due) = match stage {
            Stage::Ready => {
                let next = occurrence.ready + slot.period;
                (next, next)
            }
            // The frame may have been loaded late by the release jitter; it has its full time all the same.
            Stage::Deadline => {
                (occurrence.ready, occurrence.ready + slot.times.deadline + self.release_jitter)
            }
            Stage::Delivery => (occurrence.ready, occurrence.ready + slot.times.delivery),
        };
        if let Some(place) = self.occurrences.get_mut(at) {
            *place = Some(Occurrence { ready, stage, due, ..occurrence });
        }
    }

    /// Starts a slot again at its next occurrence, after the clock has been set. What was under way is
    /// given up and counted.
    fn realign(
        &mut self,
        at: usize,
        slot: &LocalSlot,
        today: GlobalInstant,
        buffers: &mut HrtBuffers<N>,
    ) -> Step {
        self.start(at, slot, today);
        let loaded = buffers.mailbox == HardMailbox::Loaded(slot.buffer);
        if let Some(buffer) = buffers.buffer_mut(slot.buffer) {
            buffer.counters.skipped = buffer.counters.skipped.wrapping_add(1);
        }
        if loaded {
            buffers.mailbox = HardMailbox::Withdrawing(slot.buffer);
            return Step::Command(Command::Withdraw(MAILBOX));
        }
        Step::Notify(BufferId(slot.buffer))
    }

    /// Slots have come or gone: starts the new ones at their next occurrence. O(N).
    fn revise(&mut self, today: GlobalInstant, buffers: &HrtBuffers<N>) {
        self.revision = buffers.revision;
        for (at, slot) in buffers.slots.iter().enumerate() {
            match slot {
                None => self.occurrences[at] = None,
                Some(slot) if self.occurrences[at].is_some_and(|o| o.attached == slot.attached) => {}
                Some(slot) => self.start(at, slot, today),
            }
        }
    }

    /// Waits for the first occurrence of a slot whose ready instant is still to come.
    fn start(&mut self, at: usize, slot: &LocalSlot, today: GlobalInstant) {
        let period = slot.period.as_ticks().max(1);
        let since_phase = today.since_epoch().as_ticks().saturating_sub(slot.phase.as_ticks());
        let count = since_phase.div_ceil(period);
        let ready = GlobalInstant::from_epoch(slot.phase) + Duration::from_ticks(count.wrapping_mul(period));
        if let Some(place) = self.occurrences.get_mut(at) {
            *place = Some(Occurrence { ready, stage: Stage::Ready, due: ready, attached: slot.attached });
        }
    }

    #[inline]
    fn earliest(&self) -> Option<(usize, Occurrence)> {
        let mut earliest: Option<(usize, Occurrence)> = None;
        for (at, occurrence) in self.occurrences.iter().enumerate() {
            if let Some(occurrence) = occurrence {
                if earliest.is_none_or(|(_, first)| occurrence.due < first.due) {
                    earliest = Some((at, *occurrence));
                }
            }
        }
        earliest
    }
}
