//! The calendar dispatcher: from one instant of the calendar to the next.

use super::buffers::{BufferId, HardMailbox, HrtBuffers, LocalSlot, MAILBOX};
use crate::calendar::Calendar;
use crate::can::Command;
use crate::time::{Duration, GlobalClock, GlobalInstant, Instant};

/// What the task of the dispatcher is to do next.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum CalendarStep {
    /// Have the driver carry this out, then poll again.
    Command(Command),
    /// Something in this buffer concerns the event layer: an event has become visible, or a count has
    /// changed. Wake it, then poll again.
    Notify(BufferId),
    /// An instant of the calendar has passed without anything to do, or the next one is due already. Poll again.
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

/// The occurrence of a slot that is under way, or is waited for.
#[derive(Clone, Copy, Debug)]
struct Occurrence {
    ready: GlobalInstant,
    stage: Stage,
    /// Which attachment of the slot this is of.
    attached: u32,
}

impl Occurrence {
    const NONE: Self = Self { ready: GlobalInstant::EPOCH, stage: Stage::Ready, attached: 0 };
}

impl Next {
    const UNKNOWN: Self = Self {
        is_known: false,
        at: 0,
        buffer: 0,
        stage: Stage::Ready,
        accurate: false,
        wake: Instant::EPOCH,
        latest: Instant::EPOCH,
        deadline: GlobalInstant::EPOCH,
        opened: Instant::EPOCH,
    };
}

/// The calendar dispatcher and time-triggered channel handler (TTCH) of a node, for up to `N` slots. See
/// the [module](super) for the loop around it.
///
/// One `poll` handles one instant of one slot, O(1) with at most one frame copied. The first `poll` after
/// that, or after slots or clock have changed, also looks for the next instant: O(N) compares and a
/// conversion of the clock. So this work lies in the time before an instant, not between it and the frame.
#[derive(Clone, Debug)]
pub struct Dispatcher<const N: usize> {
    /// The clock by which the occurrences were found.
    clock: GlobalClock,
    /// Slots from this place on are still to be started again, since the clock was set.
    restarting: usize,
    accuracy: Duration,
    release_jitter: Duration,
    gap: Duration,
    occurrences: [Occurrence; N],
    /// When each of them is due next, apart from the rest so that the earliest is found fast; [`NEVER`]: there is no slot.
    due: [GlobalInstant; N],
    /// The earliest of them.
    next: Next,
    /// The clock is known to be within bound until then, from when that was asked. Asked once for several instants.
    accurate_until: Instant,
    revision: u32,
}

/// The instant that the dispatcher waits for.
#[derive(Clone, Copy, Debug)]
struct Next {
    /// If not, it must be looked for, and the rest is of the last one.
    is_known: bool,
    /// The place of the slot.
    at: u8,
    buffer: u8,
    stage: Stage,
    /// Whether the clock is within bound from now until `latest`.
    accurate: bool,
    /// When it is due, in local time.
    wake: Instant,
    /// Later than this is too late for a release.
    latest: Instant,
    /// When a frame that is released must have been sent.
    deadline: GlobalInstant,
    /// What arrived before this is of no slot, if this is a delivery.
    opened: Instant,
}

impl<const N: usize> Dispatcher<N> {
    /// A task that sleeps longer would not see slots that were attached in the meantime, nor that the
    /// clock was set.
    pub const LONGEST_SLEEP: Duration = Duration::from_millis(20);

    /// A dispatcher for this calendar.
    pub const fn new(calendar: &Calendar) -> Self {
        let segment = calendar.segment();
        Self {
            clock: GlobalClock::unsynchronised(),
            restarting: N,
            accuracy: segment.accuracy,
            release_jitter: segment.release_jitter,
            gap: segment.gap(),
            occurrences: [Occurrence::NONE; N],
            due: [NEVER; N],
            next: Next::UNKNOWN,
            accurate_until: Instant::EPOCH,
            revision: 0,
        }
    }

    /// Handles the earliest instant of the calendar that is due.
    pub fn poll(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        if self.revision != buffers.revision {
            return self.revise(now, buffers);
        }
        if !self.next.is_known {
            return self.find_next(now, buffers);
        }
        if now < self.next.wake {
            return self.sleep(now);
        }
        self.next.is_known = false;
        match self.next.stage {
            Stage::Ready => self.release(now, buffers),
            Stage::Deadline => self.withdraw(now, buffers),
            Stage::Delivery => self.deliver(now, buffers),
        }
    }

    #[inline]
    fn sleep(&self, now: Instant) -> CalendarStep {
        CalendarStep::SleepUntil(self.next.wake.min(now + Self::LONGEST_SLEEP))
    }

    /// Looks for the next instant; or says what is to be done before it can be known.
    #[inline(never)]
    fn find_next(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        let (at, due) = self.earliest();
        let (Some(Some(slot)), Some(occurrence)) = (buffers.slots.get(at), self.occurrences.get(at)) else {
            return self.without_slot(at, now);
        };
        let wake = buffers.clock.to_local(due);
        // An instant further away than a period has been slept through.
        if slot.is_far(wake.signed_since(now)) {
            return self.realign(at as u8, now, buffers);
        }
        self.next.wake = wake;
        let latest = wake + self.release_jitter;
        self.next.latest = latest;
        let Occurrence { ready, stage, .. } = *occurrence;
        match stage {
            Stage::Ready => self.next.deadline = ready + slot.deadline,
            Stage::Deadline => {}
            Stage::Delivery => self.next.opened = self.opened(ready, &buffers.clock),
        }
        self.next.is_known = true;
        self.next.at = at as u8;
        self.next.buffer = slot.buffer;
        self.next.stage = stage;
        self.next.accurate = latest <= self.accurate_until || self.is_accurate(now, latest, &buffers.clock);
        if now < wake { self.sleep(now) } else { CalendarStep::Continue }
    }

    /// When the window of an occurrence opens, in local time.
    // Out of line, so that a look at an instant of another stage needs fewer registers.
    #[inline(never)]
    fn opened(&self, ready: GlobalInstant, clock: &GlobalClock) -> Instant {
        clock.to_local(ready.saturating_sub(self.gap))
    }

    /// Returns whether the clock is within bound from now until `latest`, if that is still to come: later than that, nobody
    /// asks. Looks ahead, so that the next few instants need not ask.
    #[cold]
    fn is_accurate(&mut self, now: Instant, latest: Instant, clock: &GlobalClock) -> bool {
        let until = latest + Self::LONGEST_SLEEP;
        if clock.is_accurate(now, until, self.accuracy) {
            self.accurate_until = until;
            return true;
        }
        clock.is_accurate(now.min(latest), latest, self.accuracy)
    }

    /// There is no slot, or the earliest one is just being given up.
    #[cold]
    fn without_slot(&mut self, at: usize, now: Instant) -> CalendarStep {
        match self.due.get_mut(at) {
            Some(due) if *due != NEVER => {
                *due = NEVER;
                CalendarStep::Continue
            }
            _ => CalendarStep::SleepUntil(now + Self::LONGEST_SLEEP),
        }
    }

    /// Loads the fresh event, if all is as it should be.
    // Out of line, like all that `poll` does: then it needs no registers of its own, and calls nothing but jumps there.
    #[inline(never)]
    fn release(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        let punctual = now <= self.next.latest && self.next.accurate && !buffers.inhibited;
        let (_, places, mailbox) = buffers.parts_mut();
        if let Some(Some(buffer)) = places.get_mut(usize::from(self.next.buffer))
            && punctual
            && buffer.fresh
            && buffer.role.publishes
            && *mailbox == HardMailbox::Empty
        {
            *mailbox = HardMailbox::Loaded(self.next.buffer);
            self.enter(Stage::Deadline, self.next.deadline);
            return CalendarStep::Command(Command::Load(MAILBOX, buffer.load()));
        }
        self.pass_over(now, buffers)
    }

    /// There is nothing to release, or it must not be released.
    #[inline(never)]
    fn pass_over(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        let silent = self.must_keep_silent(now, buffers);
        let (slots, places, _) = buffers.parts_mut();
        let Some(Some(slot)) = slots.get(usize::from(self.next.at)) else { return CalendarStep::Continue };
        if now > self.next.latest && slot.is_far(now.signed_since(self.next.wake)) {
            return self.realign(self.next.at, now, buffers);
        }
        let Some(Some(buffer)) = places.get_mut(usize::from(slot.buffer)) else {
            return CalendarStep::Continue;
        };
        self.leave(slot, buffer.role.subscribes);
        buffer.forget_early(self.next.wake.saturating_sub(self.gap));
        // What could not be sent in its slot is stale in the next.
        let fresh = core::mem::take(&mut buffer.fresh);
        if !buffer.role.publishes || !(fresh || slot.periodic) {
            return CalendarStep::Continue;
        }
        buffer.count(|counters| {
            if !fresh {
                &mut counters.unused
            } else if silent {
                &mut counters.inhibited
            } else {
                &mut counters.skipped
            }
        });
        CalendarStep::Notify(BufferId(slot.buffer))
    }

    #[inline(never)]
    fn withdraw(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        let (slots, places, mailbox) = buffers.parts_mut();
        let Some(Some(slot)) = slots.get(usize::from(self.next.at)) else { return CalendarStep::Continue };
        if now > self.next.latest && slot.is_far(now.signed_since(self.next.wake)) {
            return self.realign(self.next.at, now, buffers);
        }
        let buffer = places.get(usize::from(slot.buffer)).and_then(Option::as_ref);
        let subscribes = buffer.is_some_and(|buffer| buffer.role.subscribes);
        self.leave(slot, subscribes);
        if *mailbox == HardMailbox::Loaded(slot.buffer) {
            *mailbox = HardMailbox::Withdrawing(slot.buffer);
            return CalendarStep::Command(Command::Withdraw(MAILBOX));
        }
        CalendarStep::Continue
    }

    #[inline(never)]
    fn deliver(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        let silent = self.must_keep_silent(now, buffers);
        let (slots, places, _) = buffers.parts_mut();
        let Some(Some(slot)) = slots.get(usize::from(self.next.at)) else { return CalendarStep::Continue };
        if now > self.next.latest && slot.is_far(now.signed_since(self.next.wake)) {
            return self.realign(self.next.at, now, buffers);
        }
        self.leave(slot, false);
        let Some(Some(buffer)) = places.get_mut(usize::from(slot.buffer)) else {
            return CalendarStep::Continue;
        };
        if silent {
            buffer.arriving = None;
            buffer.count(|counters| &mut counters.inhibited);
        } else if !buffer.deliver(self.next.opened) {
            if !slot.periodic {
                return CalendarStep::Continue;
            }
            buffer.count(|counters| &mut counters.missed);
        }
        CalendarStep::Notify(BufferId(slot.buffer))
    }

    #[inline]
    fn must_keep_silent(&self, now: Instant, buffers: &HrtBuffers<N>) -> bool {
        let accurate = now <= self.next.latest && self.next.accurate;
        (!accurate && self.is_out_of_bound(now, buffers)) || buffers.inhibited
    }

    #[cold]
    fn is_out_of_bound(&self, now: Instant, buffers: &HrtBuffers<N>) -> bool {
        buffers.clock.accuracy(now) > self.accuracy
    }

    /// Moves a slot on to the next stage of this occurrence.
    #[inline]
    fn enter(&mut self, stage: Stage, due: GlobalInstant) {
        let at = usize::from(self.next.at);
        if let (Some(occurrence), Some(place)) = (self.occurrences.get_mut(at), self.due.get_mut(at)) {
            occurrence.stage = stage;
            *place = due;
        }
    }

    /// Moves a slot on to its delivery, if that concerns this node, or to its next occurrence.
    fn leave(&mut self, slot: &LocalSlot, delivers: bool) {
        let at = usize::from(self.next.at);
        let (Some(occurrence), Some(due)) = (self.occurrences.get_mut(at), self.due.get_mut(at)) else {
            return;
        };
        if delivers {
            occurrence.stage = Stage::Delivery;
            *due = occurrence.ready + slot.delivery;
        } else {
            occurrence.stage = Stage::Ready;
            occurrence.ready = occurrence.ready + slot.period;
            *due = occurrence.ready;
        }
    }

    /// Starts a slot again at its next occurrence, after more than a period has been slept through. What was
    /// under way is given up and counted.
    #[cold]
    fn realign(&mut self, at: u8, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        let today = buffers.clock.to_global(now);
        let (slots, places, mailbox) = buffers.parts_mut();
        let Some(Some(slot)) = slots.get(usize::from(at)) else { return CalendarStep::Continue };
        self.start(at.into(), slot, today);
        if let Some(Some(buffer)) = places.get_mut(usize::from(slot.buffer)) {
            buffer.count(|counters| &mut counters.skipped);
        }
        if *mailbox == HardMailbox::Loaded(slot.buffer) {
            *mailbox = HardMailbox::Withdrawing(slot.buffer);
            return CalendarStep::Command(Command::Withdraw(MAILBOX));
        }
        CalendarStep::Notify(BufferId(slot.buffer))
    }

    /// Slots have come or gone, or the clock is another one: starts the new slots at their next occurrence,
    /// and all of them if the clock was set; or says what is to be done before that. O(N).
    #[inline(never)]
    fn revise(&mut self, now: Instant, buffers: &mut HrtBuffers<N>) -> CalendarStep {
        self.next.is_known = false;
        if buffers.mailbox == HardMailbox::Orphaned {
            buffers.mailbox = HardMailbox::Abandoned;
            return CalendarStep::Command(Command::Withdraw(MAILBOX));
        }
        let today = buffers.clock.to_global(now);
        // No two clocks that are accurate enough differ by more than the gap.
        let step = today.signed_since(self.clock.to_global(now)).unsigned_abs();
        self.clock = buffers.clock;
        self.accurate_until = Instant::EPOCH;
        if step > self.gap.as_ticks() {
            self.restarting = 0;
        }
        if let Err(step) = self.restart(today, buffers) {
            return step;
        }
        self.revision = buffers.revision;
        for (at, slot) in buffers.slots.iter().enumerate() {
            match slot {
                Some(slot) if self.follows(at, slot) => {}
                Some(slot) => self.start(at, slot, today),
                None => {
                    if let Some(due) = self.due.get_mut(at) {
                        *due = NEVER;
                    }
                }
            }
        }
        self.find_next(now, buffers)
    }

    /// Starts the slots again that are left, as long as nothing must be said about one of them: their old
    /// instants may lie far in the future, or in the past.
    #[expect(clippy::arithmetic_side_effects, reason = "below `N`")]
    fn restart(&mut self, today: GlobalInstant, buffers: &mut HrtBuffers<N>) -> Result<(), CalendarStep> {
        while self.restarting < N {
            abandon(buffers)?;
            let at = self.restarting;
            self.restarting += 1;
            let (slots, places, _) = buffers.parts_mut();
            let Some(Some(slot)) = slots.get(at) else { continue };
            let under_way = self.occurrences.get(at).is_some_and(|it| it.stage != Stage::Ready);
            let open = under_way && self.follows(at, slot);
            self.start(at, slot, today);
            if let Some(Some(buffer)) = places.get_mut(usize::from(slot.buffer))
                && buffer.give_up(open)
            {
                return Err(CalendarStep::Notify(BufferId(slot.buffer)));
            }
        }
        Ok(())
    }

    /// Waits for the first occurrence of a slot whose ready instant is still to come.
    fn start(&mut self, at: usize, slot: &LocalSlot, today: GlobalInstant) {
        let period = slot.period.as_ticks().max(1);
        let since_phase = today.since_epoch().as_ticks().saturating_sub(slot.phase.as_ticks());
        let count = since_phase.div_ceil(period);
        let ready = GlobalInstant::from_epoch(slot.phase) + Duration::from_ticks(count.wrapping_mul(period));
        if let (Some(occurrence), Some(due)) = (self.occurrences.get_mut(at), self.due.get_mut(at)) {
            *occurrence = Occurrence { ready, stage: Stage::Ready, attached: slot.attached };
            *due = ready;
        }
    }

    /// Returns whether the occurrence in this place is one of the slot that is there now.
    fn follows(&self, at: usize, slot: &LocalSlot) -> bool {
        let is_due = self.due.get(at).is_some_and(|due| *due != NEVER);
        is_due && self.occurrences.get(at).is_some_and(|it| it.attached == slot.attached)
    }

    /// The first of those that are due first.
    #[inline]
    fn earliest(&self) -> (usize, GlobalInstant) {
        let mut earliest = (0, NEVER);
        for (at, due) in self.due.iter().enumerate() {
            if *due < earliest.1 {
                seldom();
                earliest = (at, *due);
            }
        }
        earliest
    }
}

/// Says that a branch is seldom taken: without, all that it changes is chosen by conditional moves, every time.
#[cold]
#[inline(always)]
const fn seldom() {}

/// When a place without a slot is due.
const NEVER: GlobalInstant = GlobalInstant::FAR_FUTURE;

#[cfg(test)]
mod tests;

/// Withdraws a frame whose slot the clock has left. Even if it is sent, it is of no slot any more.
fn abandon<const N: usize>(buffers: &mut HrtBuffers<N>) -> Result<(), CalendarStep> {
    let (HardMailbox::Loaded(at) | HardMailbox::Withdrawing(at)) = buffers.mailbox else { return Ok(()) };
    let requested = core::mem::replace(&mut buffers.mailbox, HardMailbox::Abandoned);
    if let Some(buffer) = buffers.buffer_mut(at) {
        buffer.count(|counters| &mut counters.omitted);
    }
    match requested {
        HardMailbox::Loaded(_) => Err(CalendarStep::Command(Command::Withdraw(MAILBOX))),
        _ => Ok(()),
    }
}
