//! The event-triggered channel handler: earliest deadline first by the priority field.

use super::lane::{
    Attended, Departure, Entry, Full, Incident, Lane, Outgoing, RESERVED, Report, Tag, Unsent,
};
use crate::calendar::Calendar;
use crate::can::{BitRate, Command, Etag, Frame, Mailbox, Outcome, Payload, Priority};
use crate::time::{Duration, Instant};
use core::num::NonZeroU32;

/// How the remaining time until a deadline becomes a priority.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PriorityMap {
    /// Δt_p in nanoseconds; fits 32 bits, so that the division is one instruction.
    step: NonZeroU32,
}

impl PriorityMap {
    /// The longest Δt_p, so that 249 steps fit in 32 bits of nanoseconds.
    pub const LONGEST_STEP: Duration = Calendar::LONGEST_PRIORITY_STEP;

    /// A map with the step Δt_p; `None` if it is zero or longer than [`PriorityMap::LONGEST_STEP`].
    pub const fn new(step: Duration) -> Option<Self> {
        if step.as_ticks() > Self::LONGEST_STEP.as_ticks() {
            return None;
        }
        match NonZeroU32::new(step.as_ticks() as u32) {
            Some(step) => Some(Self { step }),
            None => None,
        }
    }

    /// Δt_p of one longest frame, which is as fine as it is of use: frames cannot be pre-empted.
    #[allow(clippy::expect_used, reason = "no bit rate is so fast that a frame takes no time")]
    pub const fn of(bit_rate: BitRate) -> Self {
        let step = NonZeroU32::new(bit_rate.longest_frame(Payload::MAX_LEN).as_ticks() as u32);
        Self { step: step.expect("a frame takes time") }
    }

    /// The map that the segment of this calendar was planned for.
    pub const fn of_calendar(calendar: &Calendar) -> Self {
        match Self::new(calendar.priority_step()) {
            Some(map) => map,
            // A calendar has no such step.
            None => Self::of(calendar.segment().bit_rate),
        }
    }

    /// Δt_p.
    pub const fn step(self) -> Duration {
        Duration::from_ticks(self.step.get() as u64)
    }

    /// The priority of an event with this much time left: 1 + remaining / Δt_p, at most 249.
    #[inline]
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "the products fit, as [`Self::LONGEST_STEP`] says, and a step is not zero"
    )]
    pub const fn priority(self, remaining: Duration) -> Priority {
        let least = Priority::SOFT_LEAST_URGENT.get() as u32 - 1;
        let remaining = remaining.as_ticks();
        if remaining >= (least * self.step.get()) as u64 {
            return Priority::SOFT_LEAST_URGENT;
        }
        Priority::new(1 + (remaining as u32 / self.step.get()) as u8)
    }

    /// The priority of an event at `now`, and when it must leave that for the next more urgent one.
    #[inline]
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "a priority is at least one, and the product fits, as [`Self::LONGEST_STEP`] says"
    )]
    fn assign(self, deadline: Instant, now: Instant) -> (Priority, Instant) {
        let priority = self.priority(deadline.saturating_since(now));
        let steps = u32::from(priority.get() - 1);
        if steps == 0 {
            return (priority, Instant::FAR_FUTURE);
        }
        // At exactly `steps` steps before the deadline the quotient is still `steps`. The product fits, as
        // [`Self::LONGEST_STEP`] says.
        let span = Duration::from_ticks((steps * self.step.get()).saturating_sub(1).into());
        (priority, deadline.saturating_sub(span))
    }
}

/// What the owner of an [`Etch`] is to do next.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum EtchStep {
    /// Have the driver carry this out, then poll again.
    Command(Command),
    /// Tell the publisher, then poll again.
    Incident(Incident),
    /// Nothing is to be done before this instant, if nothing is submitted and no outcome comes.
    SleepUntil(Instant),
}

/// What went through the path. All counts wrap.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EtchCounters {
    /// Frames sent.
    pub sent: u32,
    /// Events not accepted because the queue was full.
    pub refused: u32,
    /// Deadlines missed.
    pub missed: u32,
    /// Events discarded because they had expired.
    pub expired: u32,
    /// Events discarded because their channel lost its etag, or the node its TxNode.
    pub identifier_lost: u32,
    /// Frames withdrawn to be sent later or under a more urgent identifier.
    pub withdrawn: u32,
}

impl EtchCounters {
    const NONE: Self = Self { sent: 0, refused: 0, missed: 0, expired: 0, identifier_lost: 0, withdrawn: 0 };
}

/// The soft and non real-time path of a node, with room for `SOFT` and `NRT` events, of which
/// [`RESERVED`] places each are kept for [`Tag::SERVICES`]: however many events an application publishes,
/// the clock goes on.
///
/// With `SOFT` zero the node sends nothing in soft real-time, and the code for it is not in its image: each place that
/// asks for [`HAS_SOFT`](Self::HAS_SOFT) is there for that.
///
/// Calls may come in any order: [`submit_soft`](Self::submit_soft) and
/// [`submit_non_real_time`](Self::submit_non_real_time) from the event layer,
/// [`on_outcome`](Self::on_outcome) for every `Load` that was commanded. After each of them, and at the
/// instant it named, [`poll`](Self::poll) until it says [`EtchStep::SleepUntil`].
#[derive(Clone, Debug)]
pub struct Etch<const SOFT: usize, const NRT: usize> {
    map: PriorityMap,
    soft: Lane<SOFT>,
    non_real_time: Lane<NRT>,
    /// The priority under which the soft frame was loaded ends here.
    promotion_at: Instant,
    counters: EtchCounters,
}

impl<const SOFT: usize, const NRT: usize> Etch<SOFT, NRT> {
    /// Whether it sends soft real-time events.
    pub const HAS_SOFT: bool = SOFT > 0;

    /// A path with empty queues and empty mailboxes.
    pub const fn new(map: PriorityMap) -> Self {
        const { assert!(SOFT == 0 || SOFT > RESERVED, "some places are kept for the services") };
        const { assert!(NRT > RESERVED, "some places are kept for the services") };
        Self {
            map,
            soft: Lane::new(Mailbox::Soft),
            non_real_time: Lane::new(Mailbox::NonRealTime),
            promotion_at: Instant::FAR_FUTURE,
            counters: EtchCounters::NONE,
        }
    }

    /// How remaining time becomes priority.
    pub const fn priority_map(&self) -> PriorityMap {
        self.map
    }

    /// What went through.
    pub const fn counters(&self) -> EtchCounters {
        self.counters
    }

    /// Soft and non real-time events that have not been sent.
    #[expect(clippy::arithmetic_side_effects, reason = "two lengths of at most 255")]
    pub fn len(&self) -> usize {
        self.soft.len() + self.non_real_time.len()
    }

    /// Returns whether everything has been sent.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Takes a soft real-time event. On an idle node the command to load it comes back at once; it is
    /// O(1) then and O(log SOFT) otherwise.
    ///
    /// # Errors
    /// [`Full`]; the event is counted and not sent.
    #[inline]
    pub fn submit_soft(&mut self, now: Instant, event: Outgoing) -> Result<Option<Command>, Full> {
        self.submit_soft_entry(now, event, Report::Deadline)
    }

    /// As [`submit_soft`](Self::submit_soft), with the most urgent priority from the start and nobody to
    /// be told of a missed deadline: for clock synchronisation, which load must not starve.
    ///
    /// # Errors
    /// [`Full`]; the frame is counted and not sent.
    pub fn submit_urgent(
        &mut self,
        now: Instant,
        tag: Tag,
        frame: Frame,
        expires_at: Instant,
    ) -> Result<Option<Command>, Full> {
        let outgoing = Outgoing { tag, frame, deadline: now, expires_at };
        self.submit_soft_entry(now, outgoing, Report::Expiry)
    }

    #[inline]
    fn submit_soft_entry(
        &mut self,
        now: Instant,
        event: Outgoing,
        report: Report,
    ) -> Result<Option<Command>, Full> {
        if !Self::HAS_SOFT {
            return Err(self.refuse());
        }
        if self.soft.is_idle() && now < event.expires_at {
            self.soft.load_directly(|order| Entry::soft(&event, report, order));
            return Ok(Some(self.load_soft(now, event.deadline, &event.frame)));
        }
        let Outgoing { tag, frame, deadline, expires_at } = event;
        self.queue_soft((tag, report), frame, deadline, expires_at)
    }

    /// In parts, so that an event that is loaded at once need not be put together in memory.
    #[inline(never)]
    fn queue_soft(
        &mut self,
        (tag, report): (Tag, Report),
        frame: Frame,
        deadline: Instant,
        expires_at: Instant,
    ) -> Result<Option<Command>, Full> {
        let event = Outgoing { tag, frame, deadline, expires_at };
        self.soft
            .push(tag.reserve(), |order| Entry::soft(&event, report, order))
            .map(|()| None)
            .map_err(|Full| self.refuse())
    }

    /// Takes a non real-time event; the priority of its frame says how important it is. As
    /// [`submit_soft`](Self::submit_soft) otherwise. An event without a deadline has
    /// [`Instant::FAR_FUTURE`].
    ///
    /// # Errors
    /// [`Full`]; the event is counted and not sent.
    // Its callers are in one function; otherwise the event is copied twice: 160 instructions more.
    #[inline(always)]
    pub fn submit_non_real_time(&mut self, now: Instant, event: Outgoing) -> Result<Option<Command>, Full> {
        if self.non_real_time.is_idle() && now < event.expires_at {
            self.non_real_time.load_directly(|order| Entry::non_real_time(&event, order));
            return Ok(Some(Command::Load(Mailbox::NonRealTime, event.frame)));
        }
        self.queue_non_real_time(&event).map(|()| None)
    }

    /// Takes a non real-time frame of the services, which keeps for ever. It waits in the queue for the next
    /// [`poll`](Self::poll), whether the mailbox is free or not: that is not hurried, and this is small. O(log NRT).
    ///
    /// # Errors
    /// [`Full`]; the frame is counted and not sent.
    pub fn queue_for_services(&mut self, frame: Frame) -> Result<(), Full> {
        let (tag, forever) = (Tag::SERVICES, Instant::FAR_FUTURE);
        let outgoing = Outgoing { tag, frame, deadline: forever, expires_at: forever };
        self.queue_non_real_time(&outgoing)
    }

    #[inline(always)]
    fn queue_non_real_time(&mut self, event: &Outgoing) -> Result<(), Full> {
        let pushed = self.non_real_time.push(event.tag.reserve(), |order| Entry::non_real_time(event, order));
        pushed.map_err(|Full| self.refuse())
    }

    /// Returns whether there is room for another non real-time event.
    #[expect(clippy::arithmetic_side_effects, reason = "lengths of at most 255")]
    pub fn has_room_for_non_real_time(&self) -> bool {
        self.non_real_time.len() + RESERVED < NRT
    }

    /// Returns whether there is room for another urgent frame of the services.
    pub fn has_room_for_urgent(&self) -> bool {
        Self::HAS_SOFT && self.soft.len() < SOFT
    }

    /// Returns whether there is room for another frame of the services in both queues, or in the only one.
    pub fn has_room_for_services(&self) -> bool {
        (!Self::HAS_SOFT || self.soft.len() < SOFT) && self.non_real_time.len() < NRT
    }

    /// Gives up events that have not been sent. O(SOFT² + NRT²); at most one command for each mailbox.
    pub fn recall(&mut self, which: &Unsent) -> [Option<Command>; 2] {
        let soft = if Self::HAS_SOFT { self.soft.recall(which) } else { None };
        [soft, self.non_real_time.recall(which)]
    }

    /// The channel of this source has another etag. What has not been sent goes under the new one, except a
    /// frame that is on the wire already. O(SOFT + NRT).
    pub fn rename(&mut self, tag: Tag, etag: Etag) -> Option<Command> {
        // The events of a channel are all of one class.
        let soft = if Self::HAS_SOFT { self.soft.rename(tag, etag) } else { None };
        let non_real_time = self.non_real_time.rename(tag, etag);
        soft.or(non_real_time)
    }

    /// The identifiers of these events belong to somebody else now: they are discarded,
    /// and that is reported. One that is on the wire already is sent. O(SOFT + NRT).
    pub fn revoke(&mut self, now: Instant, which: &Unsent) {
        if Self::HAS_SOFT {
            self.soft.revoke(now, which);
        }
        self.non_real_time.revoke(now, which);
    }

    /// A mailbox of this path has become empty.
    pub fn on_outcome(&mut self, mailbox: Mailbox, outcome: Outcome, at: Instant) -> Departure {
        let departure = match mailbox {
            Mailbox::Hard => return Departure::default(),
            Mailbox::Soft if !Self::HAS_SOFT => return Departure::default(),
            Mailbox::Soft => self.soft.on_outcome(outcome, at),
            Mailbox::NonRealTime => self.non_real_time.on_outcome(outcome, at),
        };
        match outcome {
            Outcome::Sent => self.counters.sent = self.counters.sent.wrapping_add(1),
            Outcome::Withdrawn => self.counters.withdrawn = self.counters.withdrawn.wrapping_add(1),
        }
        if let Some(incident) = &departure.incident {
            self.count(incident);
        }
        departure
    }

    /// What is to be done now: at most one withdrawal, load or report a call, O(SOFT + NRT).
    pub fn poll(&mut self, now: Instant) -> EtchStep {
        if let Some(attended) = self.attend(now) {
            return match attended {
                Attended::Command(command) => EtchStep::Command(command),
                Attended::Incident(incident) => {
                    self.count(&incident);
                    EtchStep::Incident(incident)
                }
            };
        }
        if Self::HAS_SOFT
            && let Some(entry) = self.soft.load()
        {
            let (deadline, frame) = (entry.deadline(), *entry.frame());
            return EtchStep::Command(self.load_soft(now, deadline, &frame));
        }
        if let Some(entry) = self.non_real_time.load() {
            return EtchStep::Command(Command::Load(Mailbox::NonRealTime, *entry.frame()));
        }
        let promote = || self.soft.loaded().is_some() && now >= self.promotion_at;
        if Self::HAS_SOFT
            && (promote() || self.soft.is_overtaken())
            && let Some(command) = self.soft.withdraw()
        {
            return EtchStep::Command(command);
        }
        if self.non_real_time.is_overtaken()
            && let Some(command) = self.non_real_time.withdraw()
        {
            return EtchStep::Command(command);
        }
        EtchStep::SleepUntil(self.next_wakeup())
    }

    fn attend(&mut self, now: Instant) -> Option<Attended> {
        if Self::HAS_SOFT
            && self.soft.needs_attention(now)
            && let Some(attended) = self.soft.attend(now)
        {
            return Some(attended);
        }
        if self.non_real_time.needs_attention(now) { self.non_real_time.attend(now) } else { None }
    }

    fn next_wakeup(&self) -> Instant {
        if !Self::HAS_SOFT {
            return self.non_real_time.next_attention();
        }
        let promotion = match self.soft.loaded() {
            Some(_) => self.promotion_at,
            None => Instant::FAR_FUTURE,
        };
        promotion.min(self.soft.next_attention()).min(self.non_real_time.next_attention())
    }

    #[inline]
    fn load_soft(&mut self, now: Instant, deadline: Instant, frame: &Frame) -> Command {
        let (priority, promotion_at) = self.map.assign(deadline, now);
        self.promotion_at = promotion_at;
        Command::Load(Mailbox::Soft, Frame::new(frame.id.with_priority(priority), frame.payload))
    }

    fn refuse(&mut self) -> Full {
        self.counters.refused = self.counters.refused.wrapping_add(1);
        Full
    }

    fn count(&mut self, incident: &Incident) {
        let count = match incident.kind {
            super::IncidentKind::MissedDeadline => &mut self.counters.missed,
            super::IncidentKind::Expired => &mut self.counters.expired,
            super::IncidentKind::IdentifierLost => &mut self.counters.identifier_lost,
        };
        *count = count.wrapping_add(1);
    }
}
