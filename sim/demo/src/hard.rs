//! The hard real-time slots of a run, one by one: what the calendar promised and what became of it.
//!
//! The windows come from the calendar in global time, the attempts from the wire, deliveries and exceptions
//! from the records of the nodes. An event is within its *fault hypothesis* if at most k attempts to send it
//! were destroyed in its window, k being the omission degree of the slot. Then it must become visible to
//! each subscriber exactly once, at its delivery instant. Beyond the hypothesis it may be lost, but the publisher
//! must be told of what was not sent, and subscribers of what they did not get. Two things are beyond any
//! hypothesis, too: a node that is bus-off, and a node that has lost the time of the cluster because sync frames
//! were destroyed ([`crate::sync`]). It keeps silent in its slots and says so (exception *clock out of bound*).
//!
//! Until the clocks of all nodes are synchronised, nodes keep silent in their slots and say so (exception
//! *clock out of bound*). That is the settling time; slots in it are not judged one by one, but what was
//! published in it and lost must have been reported as often.

use cosmic_bus::VirtualInstant;
use cosmic_core::calendar::Slot;
use cosmic_core::can::{Frame, Priority, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::{Duration, GlobalInstant};

use crate::bus_log::Ending;
use crate::clock::GlobalTimeline;
use crate::cluster::Channel;
use crate::journal::Journal;
use crate::ledger::{Ledger, Subscribed};
use crate::span::{Span, Spread};
use crate::sync::Syncs;
use crate::violation::Violation;

/// How late a task may see an instant that has come, besides the release jitter of the calendar: the
/// longest time for which tasks and interrupts of lower priority lock what it needs.
pub const TASK_BOUND: Duration = Duration::from_micros(10);

/// The instants of one occurrence of a slot, in true time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Window {
    /// The mailbox is loaded.
    pub ready: VirtualInstant,
    /// Surely on the bus by now, if there was no fault.
    pub latest_start: VirtualInstant,
    /// The last retransmission has ended.
    pub deadline: VirtualInstant,
    /// Subscribers are notified.
    pub delivery: VirtualInstant,
}

/// One occurrence of a slot.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Occurrence {
    /// Of which slot.
    pub slot: &'static Slot,
    /// Its instants.
    pub window: Window,
    /// The attempts in it: indices into the attempts of the bus log.
    pub attempts: Vec<usize>,
    /// How many of them were destroyed.
    pub faulted: u32,
    /// Whether the publisher or a subscriber was bus-off in it, or had lost the time of the cluster.
    pub absent: bool,
    /// Whether its frame was on the bus.
    pub used: bool,
    /// The event that it carried: its number in the account of its channel.
    pub event: Option<usize>,
    /// What became of it.
    pub fate: Fate,
}

/// What became of an occurrence of a slot.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fate {
    /// Not judged: the clocks were not synchronised yet, or nothing had been published on the channel.
    Settling,
    /// Not judged: the cluster had no common time, for its time master had changed or could not be heard.
    NoCommonTime,
    /// Visible to every subscriber at its delivery instant.
    Delivered,
    /// Nothing was there to be sent, which was reported if it had to be.
    Unused,
    /// Lost beyond its fault hypothesis, and reported.
    Lost,
    /// Not as promised.
    Violated,
}

impl Fate {
    /// Returns whether the occurrence was judged.
    pub const fn is_judged(self) -> bool {
        !matches!(self, Self::Settling | Self::NoCommonTime)
    }
}

impl Occurrence {
    /// Returns whether more was lost than the slot is made for.
    pub fn is_beyond_hypothesis(&self) -> bool {
        self.absent || self.faulted > u32::from(self.slot.omission_degree)
    }
}

/// All slots of a run.
#[derive(Clone, Debug, Default)]
pub struct Slots {
    /// When the clocks of all nodes were synchronised.
    pub settled_at: Option<VirtualInstant>,
    /// Exceptions *clock out of bound* until then.
    pub settling_exceptions: usize,
    /// The occurrences, in the order of time.
    pub occurrences: Vec<Occurrence>,
    /// Delivery less delivery instant, of all deliveries after settling.
    pub deviation: Spread,
    /// The same without its sign, by subscriber.
    pub jitter: Vec<(TxNode, Slot, Spread)>,
    /// What was not as promised.
    pub violations: Vec<Violation>,
}

/// How far from its delivery instant an event may become visible: earlier by ε, later by ε, release jitter
/// and [`TASK_BOUND`].
pub fn bounds(journal: &Journal) -> (Span, Span) {
    let segment = journal.cluster.calendar.segment();
    (-Span::from(segment.accuracy), Span::from(segment.accuracy + segment.release_jitter + TASK_BOUND))
}

/// Judges a run.
pub fn judge(journal: &Journal, ledger: &Ledger) -> Slots {
    let timeline = journal.timeline();
    let mut slots = Slots::default();
    settle(journal, ledger, &timeline, &mut slots);
    let syncs = Syncs::of(journal);
    let judge = Judge { journal, ledger, timeline: &timeline, syncs, settled_at: slots.settled_at };
    for slot in journal.cluster.calendar.slots() {
        let mut from = 0;
        for window in windows(journal, &timeline, slot) {
            let occurrence = judge.occurrence(slot, window, &mut from, &mut slots);
            slots.occurrences.push(occurrence);
        }
        judge.untimely_attempts(slot, &mut slots);
    }
    slots.occurrences.sort_by_key(|occurrence| occurrence.window.ready);
    slots
}

/// The windows of a slot that lie within the run, from the first sync frame on.
pub fn windows(journal: &Journal, timeline: &GlobalTimeline, slot: &Slot) -> Vec<Window> {
    let Some(first) = timeline.terms().first().and_then(|term| timeline.global(term.from)) else {
        return Vec::new();
    };
    let times = journal.cluster.calendar.slot_times(slot);
    let period = slot.period.as_ticks();
    let skipped = first.since_epoch().as_ticks().saturating_sub(slot.phase.as_ticks()).div_ceil(period);
    let mut ready = GlobalInstant::from_epoch(slot.phase) + Duration::from_ticks(skipped * period);
    let mut windows = Vec::new();
    loop {
        let at = |span| timeline.instant(ready + span);
        let window = (at(Duration::from_ticks(0)))
            .zip(at(times.latest_start))
            .zip(at(times.deadline).zip(at(times.delivery)));
        let Some(((ready_at, latest_start), (deadline, delivery))) = window else { return windows };
        // The application has until the next ready instant to take the event.
        if timeline.instant(ready + slot.period).is_none_or(|next| next > journal.end) {
            return windows;
        }
        windows.push(Window { ready: ready_at, latest_start, deadline, delivery });
        ready = ready + slot.period;
    }
}

/// Finds the end of the settling time: from there on no node says that its clock is out of bound, for five
/// periods at least.
fn settle(journal: &Journal, ledger: &Ledger, timeline: &GlobalTimeline, slots: &mut Slots) {
    let Some(start) = timeline.terms().first().map(|term| term.from) else { return };
    let longest = journal.cluster.calendar.slots().iter().map(|slot| slot.period).max();
    let calm = Span::from(longest.unwrap_or(Duration::from_ticks(0)) * CALM_PERIODS);
    let mut told: Vec<_> =
        ledger.told.iter().filter(|it| it.kind == ExceptionKind::ClockOutOfBound).collect();
    told.sort_by_key(|told| told.at);
    let mut settled_at = start;
    for told in told {
        if Span::between(settled_at, told.at) > calm {
            break;
        }
        settled_at = settled_at.max(told.at);
        slots.settling_exceptions += 1;
    }
    if Span::between(settled_at, journal.end) > calm {
        slots.settled_at = Some(settled_at);
    }
}

struct Judge<'j> {
    journal: &'j Journal,
    ledger: &'j Ledger,
    timeline: &'j GlobalTimeline,
    syncs: Syncs,
    settled_at: Option<VirtualInstant>,
}

impl Judge<'_> {
    fn occurrence(
        &self,
        slot: &'static Slot,
        window: Window,
        from: &mut usize,
        slots: &mut Slots,
    ) -> Occurrence {
        let attempts = self.attempts_in(slot, &window, from);
        let log = self.journal.bus.attempts();
        let faulted = attempts.iter().filter(|at| log[**at].has_failed()).count() as u32;
        let used = !attempts.is_empty();
        let event = attempts.first().and_then(|at| self.ledger.event_of(log[*at].load?));
        let channel = self.journal.cluster.channel_of(slot.etag, slot.publisher);
        let subscribers = channel.into_iter().flat_map(|channel| {
            let listens = |node: &&TxNode| self.subscription(**node, channel, &window).is_some();
            channel.subscribers.iter().filter(listens)
        });
        let absent = subscribers.chain([&slot.publisher]).any(|node| self.was_absent(*node, slot, &window));
        let fate = Fate::Settling;
        let mut occurrence = Occurrence { slot, window, attempts, faulted, absent, used, event, fate };
        if self.is_judged(slot, &window) && !self.syncs.give_common_time(self.timeline, window.ready) {
            occurrence.fate = Fate::NoCommonTime;
        } else if self.is_judged(slot, &window) {
            occurrence.fate =
                if used { self.carried(&occurrence, slots) } else { self.empty(&occurrence, slots) };
        }
        occurrence
    }

    /// A node that was not synchronised spoke of slots at instants of its own, so the first whole period
    /// behind the settling time is left out.
    fn is_judged(&self, slot: &Slot, window: &Window) -> bool {
        let first = self.ledger.account(slot.etag, slot.publisher).and_then(|account| account.events.first());
        let announced = first.is_some_and(|life| life.published_at < window.ready);
        announced && self.settled_at.is_some_and(|settled| window.ready > settled + slot.period)
    }

    /// The attempts to send the slot's frame that started in its window; early or late by ε.
    fn attempts_in(&self, slot: &Slot, window: &Window, from: &mut usize) -> Vec<usize> {
        let segment = self.journal.cluster.calendar.segment();
        let first = (-Span::from(segment.accuracy)).after(window.ready);
        let last = Span::from(segment.gap()).after(window.deadline);
        let log = self.journal.bus.attempts();
        *from += log[*from..].partition_point(|attempt| attempt.start < first);
        let within = log[*from..].iter().enumerate().take_while(|(_, attempt)| attempt.start <= last);
        let ours = within.filter(|(_, attempt)| attempt.frame().is_some_and(|frame| belongs(slot, &frame)));
        ours.map(|(at, _)| *from + at).collect()
    }

    /// Nothing was sent. If nothing had been published either, that is the application's affair.
    fn empty(&self, occurrence: &Occurrence, slots: &mut Slots) -> Fate {
        let Occurrence { slot, window, .. } = occurrence;
        let told = |kind| self.was_told(slot.publisher, slot, window, kind);
        if !slot.periodic || told(ExceptionKind::NothingPublished) {
            return Fate::Unused;
        }
        let reasons = [
            ExceptionKind::SlotSkipped,
            ExceptionKind::ClockOutOfBound,
            ExceptionKind::OmissionDegreeExceeded,
        ];
        let reason = reasons.into_iter().find(|kind| told(*kind));
        if reason.is_some() && self.was_absent(slot.publisher, slot, window) {
            return Fate::Lost;
        }
        slots.violations.push(Violation::NotSent { ready: window.ready, etag: slot.etag, reason });
        Fate::Violated
    }

    /// The subscription by which a node must get the event of a window.
    fn subscription(&self, node: TxNode, channel: &Channel, window: &Window) -> Option<&Subscribed> {
        let early = Span::from(self.journal.cluster.calendar.segment().accuracy);
        self.ledger.subscription(node, channel.number, (-early).after(window.ready))
    }

    fn subscriptions(&self, node: TxNode, channel: &Channel) -> usize {
        let all = self.ledger.subscriptions.iter();
        all.filter(|it| (it.node, it.channel) == (node, channel.number)).count()
    }

    fn carried(&self, occurrence: &Occurrence, slots: &mut Slots) -> Fate {
        let slot = occurrence.slot;
        let before = slots.violations.len();
        let Some(account) = self.ledger.account(slot.etag, slot.publisher) else { return Fate::Violated };
        let channel = account.channel;
        let life = occurrence.event.and_then(|event| account.events.get(event));
        let in_time = |at: &usize| {
            let attempt = &self.journal.bus.attempts()[*at];
            attempt.ending == Ending::Sent && attempt.end <= occurrence.window.delivery
        };
        let was_sent = occurrence.attempts.iter().any(in_time);
        let mut everywhere = true;
        for subscriber in &channel.subscribers {
            let Some(subscription) = self.subscription(*subscriber, channel, &occurrence.window) else {
                continue;
            };
            let off = self.was_absent(*subscriber, slot, &occurrence.window);
            let left = |event| account.is_left(event, subscription) && was_sent && !off;
            let deliveries: Vec<_> =
                life.into_iter().flat_map(|life| life.deliveries_to(*subscriber)).collect();
            match deliveries.as_slice() {
                [delivery] => self.visible(occurrence, *subscriber, delivery.visible_at, slots),
                [] if occurrence.event.is_some_and(left) => {}
                [] => {
                    everywhere = false;
                    self.missed(occurrence, *subscriber, slots);
                }
                several if several.len() <= self.subscriptions(*subscriber, channel) => {}
                several => slots.violations.push(Violation::Duplicate {
                    ready: occurrence.window.ready,
                    etag: slot.etag,
                    subscriber: *subscriber,
                    times: several.len(),
                }),
            }
        }
        if !was_sent {
            self.publisher_must_know(occurrence, slots);
        }
        if slots.violations.len() > before {
            Fate::Violated
        } else if everywhere {
            Fate::Delivered
        } else {
            Fate::Lost
        }
    }

    fn visible(&self, occurrence: &Occurrence, subscriber: TxNode, at: VirtualInstant, slots: &mut Slots) {
        let slot = occurrence.slot;
        let off = Span::between(occurrence.window.delivery, at);
        slots.deviation.add(off);
        let place = slots.jitter.iter_mut().find(|(node, of, _)| (*node, of) == (subscriber, slot));
        match place {
            Some((_, _, spread)) => spread.add(off.abs()),
            None => {
                let mut spread = Spread::default();
                spread.add(off.abs());
                slots.jitter.push((subscriber, *slot, spread));
            }
        }
        let (early, late) = bounds(self.journal);
        if off < early || off > late {
            let ready = occurrence.window.ready;
            slots.violations.push(Violation::OffInstant { ready, etag: slot.etag, subscriber, off });
        }
    }

    fn missed(&self, occurrence: &Occurrence, subscriber: TxNode, slots: &mut Slots) {
        let Occurrence { slot, window, faulted, .. } = occurrence;
        let (ready, etag) = (window.ready, slot.etag);
        let told = |kind| self.was_told(subscriber, slot, window, kind);
        let absent = [subscriber, slot.publisher].iter().any(|node| self.was_absent(*node, slot, window));
        if OVERRUN.into_iter().any(told) {
            // It was there; the application was not fast enough.
        } else if *faulted <= u32::from(slot.omission_degree) && !absent {
            let faulted = *faulted;
            slots.violations.push(Violation::NotDelivered { ready, etag, subscriber, faulted });
        } else if slot.periodic && !LOST_AT_SUBSCRIBER.into_iter().any(told) {
            let (node, kind) = (subscriber, ExceptionKind::MissedEvent);
            slots.violations.push(Violation::Silence { ready, etag, node, kind });
        }
    }

    fn publisher_must_know(&self, occurrence: &Occurrence, slots: &mut Slots) {
        let Occurrence { slot, window, .. } = occurrence;
        let kind = ExceptionKind::OmissionDegreeExceeded;
        if !self.was_told(slot.publisher, slot, window, kind) {
            let (ready, etag, node) = (window.ready, slot.etag, slot.publisher);
            slots.violations.push(Violation::Silence { ready, etag, node, kind });
        }
    }

    /// Returns whether the node was bus-off at some time in the window, or kept silent in it for want of a clock,
    /// and had reason to.
    fn was_absent(&self, node: TxNode, slot: &Slot, window: &Window) -> bool {
        let silent = || {
            let said = [ExceptionKind::ClockOutOfBound, ExceptionKind::SlotSkipped].into_iter();
            said.into_iter().any(|kind| self.was_told(node, slot, window, kind))
        };
        self.journal.was_off(node, window.ready, window.delivery)
            || (silent() && self.syncs.were_disturbed(self.journal, node, window.delivery))
    }

    /// Returns whether the node was told of this between the ready instant and half a period after the
    /// delivery instant. One that does not know the time does not know either when the slot is, but tells once in each of
    /// its periods: that may be anywhere in the slot's.
    fn was_told(&self, node: TxNode, slot: &Slot, window: &Window, kind: ExceptionKind) -> bool {
        let accuracy = self.journal.cluster.calendar.segment().accuracy;
        let from = (-Span::from(accuracy)).after(window.ready);
        let mut until = window.delivery + (slot.period / 2);
        if kind == ExceptionKind::ClockOutOfBound {
            until = until.max(window.ready + (slot.period + accuracy));
        }
        self.ledger.told.iter().any(|told| {
            (told.node, told.etag, told.kind) == (node, Some(slot.etag), kind)
                && told.at >= from
                && told.at <= until
        })
    }

    /// Frames of the slot that were on the bus outside all of its windows.
    fn untimely_attempts(&self, slot: &'static Slot, slots: &mut Slots) {
        let Some(settled) = self.settled_at else { return };
        let claimed: std::collections::BTreeSet<usize> = slots
            .occurrences
            .iter()
            .filter(|it| it.slot == slot)
            .flat_map(|it| it.attempts.clone())
            .collect();
        let last = windows(self.journal, self.timeline, slot).last().map(|window| window.delivery);
        for (at, attempt) in self.journal.bus.attempts().iter().enumerate() {
            let ours = attempt.frame().is_some_and(|frame| belongs(slot, &frame));
            let judged = attempt.start > settled && last.is_some_and(|last| attempt.start < last);
            let judged = judged && self.syncs.give_common_time(self.timeline, attempt.start);
            if ours && judged && attempt.ending != Ending::Open && !claimed.contains(&at) {
                slots.violations.push(Violation::OutsideSlot { at: attempt.start, etag: slot.etag });
            }
        }
    }
}

fn belongs(slot: &Slot, frame: &Frame) -> bool {
    let id = frame.id;
    (id.priority(), id.tx_node(), id.etag()) == (Priority::HARD, slot.publisher, slot.etag)
}

/// By each of these a subscriber learns that its application was too slow for an event.
const OVERRUN: [ExceptionKind; 2] = [ExceptionKind::QueueFull, ExceptionKind::EventOverwritten];
/// By each of these a subscriber learns that it did not get an event.
const LOST_AT_SUBSCRIBER: [ExceptionKind; 3] =
    [ExceptionKind::MissedEvent, ExceptionKind::ClockOutOfBound, ExceptionKind::SlotSkipped];
/// After so many periods without an exception the clocks are taken for synchronised.
const CALM_PERIODS: u32 = 5;
