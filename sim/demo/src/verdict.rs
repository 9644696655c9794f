//! The verdict: whether everything was as promised, and whether everything that was lost was reported.

use cosmic_bus::VirtualInstant;
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::time::Duration;

use crate::cluster::{Channel, Promise};
use crate::hard::{self, Slots};
use crate::journal::Journal;
use crate::ledger::{Account, Ledger, Life};
use crate::order::{self, Order};
use crate::span::Span;
use crate::violation::{Loss, Violation};

/// The events of a soft or non real-time channel, or of a hard real-time one, in numbers.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Totals {
    /// Events that the publisher's middleware took.
    pub published: usize,
    /// Events that it refused.
    pub refused: usize,
    /// Events whose first copy was sent.
    pub sent: usize,
    /// Events that were not sent by their deadline; hard real-time: not delivered in their slot.
    pub missed: usize,
    /// Events that expired before they were sent.
    pub expired: usize,
    /// Events that were still on their way when the run ended.
    pub under_way: usize,
    /// Hard real-time events that were published before the clocks were synchronised, and not delivered.
    pub settling: usize,
}

/// All that there is to be said of a run.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The life of each event.
    pub ledger: Ledger,
    /// The hard real-time slots.
    pub slots: Slots,
    /// How soft real-time events competed.
    pub order: Order,
    /// The channels in numbers, in the order of the cluster.
    pub totals: Vec<Totals>,
    /// What was not as promised.
    pub violations: Vec<Violation>,
}

impl Verdict {
    /// Judges a run.
    pub fn of(journal: &Journal) -> Self {
        let ledger = Ledger::of(journal);
        let slots = hard::judge(journal, &ledger);
        let order = order::judge(journal, &ledger);
        let mut violations = slots.violations.clone();
        let has_slots = !journal.cluster.calendar.slots().is_empty();
        if has_slots && !slots.occurrences.iter().any(|it| it.fate.is_judged()) {
            violations.push(Violation::NothingJudged { destroyed: destroyed(journal) });
        }
        let digest = journal.cluster.calendar.digest();
        let terms = journal.timeline();
        let other = terms.terms().iter().find(|term| term.calendar_digest != digest);
        violations.extend(other.map(|term| Violation::OtherCalendar { digest: term.calendar_digest }));
        violations.extend(order.inversions.iter().map(|inversion| Violation::OutOfOrder(*inversion)));
        violations.extend(untold_bus_offs(journal, &ledger));
        violations.extend(journal.errors.iter().cloned().map(Violation::Logged));
        let lost = ledger.lost_records.iter();
        violations.extend(lost.map(|(node, count)| Violation::RecordsLost { node: *node, count: *count }));
        if ledger.unknown_events > 0 {
            violations.push(Violation::Invented { count: ledger.unknown_events });
        }
        let books = Books { journal, ledger: &ledger, slots: &slots };
        let totals = ledger.channels.iter().map(|account| books.totals(account, &mut violations)).collect();
        Self { ledger, slots, order, totals, violations }
    }

    /// Returns whether everything was as promised.
    pub fn is_passed(&self) -> bool {
        self.violations.is_empty()
    }
}

/// Attempts that were destroyed, and all.
fn destroyed(journal: &Journal) -> (usize, usize) {
    let attempts = journal.bus.attempts();
    (attempts.iter().filter(|attempt| attempt.has_failed()).count(), attempts.len())
}

/// Bus-offs of nodes without an exception soon after.
fn untold_bus_offs(journal: &Journal, ledger: &Ledger) -> Vec<Violation> {
    let mut violations = Vec::new();
    for (node, station) in &journal.stations {
        for at in journal.bus.bus_offs(*station).filter(|at| *at + NOTIFIED < journal.end) {
            let told = ledger.told.iter().any(|told| {
                (told.node, told.kind) == (*node, ExceptionKind::BusOff)
                    && told.at >= at
                    && told.at <= at + NOTIFIED
            });
            if !told {
                violations.push(Violation::BusOffUntold { node: *node, at });
            }
        }
    }
    violations
}

/// Compares what was lost with what was reported.
struct Books<'j> {
    journal: &'j Journal,
    ledger: &'j Ledger,
    slots: &'j Slots,
}

impl Books<'_> {
    fn totals(&self, account: &Account, violations: &mut Vec<Violation>) -> Totals {
        let lives = || account.events.iter();
        let published = lives().filter(|life| life.taken).count();
        let mut totals = Totals {
            published,
            refused: account.events.len() - published,
            sent: lives().filter(|life| life.sent_at.is_some()).count(),
            ..Totals::default()
        };
        self.check_refused(account.channel, account.refused_by_queue(), violations);
        match account.channel.class {
            Promise::Hard => self.total_hard(account, &mut totals, violations),
            Promise::Soft { .. } => {
                self.total_soft(account, &mut totals, violations);
                self.check_deliveries(account, violations);
            }
            Promise::NonRealTime { .. } => {
                self.total_non_real_time(account, &mut totals, violations);
                self.check_deliveries(account, violations);
            }
        }
        totals
    }

    fn check_refused(&self, channel: &Channel, refused: usize, violations: &mut Vec<Violation>) {
        let reported = self.ledger.count(channel.publisher, channel.etag, ExceptionKind::TransmitQueueFull);
        if refused > reported {
            let (etag, node, what) = (channel.etag, channel.publisher, Loss::Refused);
            violations.push(Violation::Unreported { etag, node, what, lost: refused, reported });
        }
    }

    /// Slots are judged one by one elsewhere; what is left is the settling time.
    fn total_hard(&self, account: &Account, totals: &mut Totals, violations: &mut Vec<Violation>) {
        let channel = account.channel;
        let settled = |life: &&Life| self.slots.settled_at.is_some_and(|at| life.published_at > at);
        let period = self
            .journal
            .cluster
            .calendar
            .slots()
            .iter()
            .find(|slot| (slot.etag, slot.publisher) == (channel.etag, channel.publisher));
        let late = period.map_or(self.journal.end, |slot| {
            (-Span::from(slot.period + slot.period)).after(self.journal.end)
        });
        for (at, life) in account.events.iter().enumerate() {
            let arrived = |node: &TxNode| {
                let expected = self.ledger.subscription(*node, channel.number, life.published_at);
                let is_left = |subscription| account.is_left(at, subscription);
                expected.is_none_or(is_left) || life.deliveries_to(*node).next().is_some()
            };
            if life.sent_at.is_some() && channel.subscribers.iter().all(arrived) {
                continue;
            } else if life.published_at > late {
                totals.under_way += 1;
            } else if settled(&life) {
                totals.missed += 1;
            } else {
                totals.settling += 1;
            }
        }
        let told = |kind| self.ledger.count(channel.publisher, channel.etag, kind);
        let reported = told(ExceptionKind::ClockOutOfBound)
            + told(ExceptionKind::SlotSkipped)
            + told(ExceptionKind::OmissionDegreeExceeded);
        // At each end of the settling time an event may be replaced by the next one before its slot comes.
        if totals.settling > reported + 2 {
            let (etag, node, lost) = (channel.etag, channel.publisher, totals.settling);
            violations.push(Violation::Unreported { etag, node, what: Loss::Settling, lost, reported });
        }
    }

    fn total_soft(&self, account: &Account, totals: &mut Totals, violations: &mut Vec<Violation>) {
        let (end, tolerance) = (self.journal.end, Span::from(TOLERANCE));
        let lives = || account.events.iter().filter(|life| life.taken);
        let over = |at: Option<VirtualInstant>, by| at.is_some_and(|at| by > tolerance.after(at));
        let unsent = |life: &&Life| life.sent_at.is_none();
        totals.expired = lives().filter(unsent).filter(|life| over(life.expires_at, end)).count();
        totals.under_way = lives().filter(unsent).count() - totals.expired;
        let channel = account.channel;
        let told = |kind| self.ledger.count(channel.publisher, channel.etag, kind);
        let check = |what, lost: core::ops::RangeInclusive<usize>, reported, violations: &mut Vec<_>| {
            if !lost.contains(&reported) {
                let (etag, node, lost) = (channel.etag, channel.publisher, *lost.start());
                violations.push(Violation::Unreported { etag, node, what, lost, reported });
            }
        };
        let possibly = totals.expired + totals.under_way;
        // Of what happened just before the end, the application may not have been told yet.
        let recent = (-Span::from(NOTIFIED)).after(end);
        let surely = lives().filter(unsent).filter(|life| over(life.expires_at, recent)).count();
        check(Loss::Expired, surely..=possibly, told(ExceptionKind::ValidityExpired), violations);
        // Who is late by less than the tolerance may count either way.
        let late = |slack: Span, end: VirtualInstant| {
            let late = |life: &&Life| {
                let sent = life.sent_at.unwrap_or(end).min(end);
                life.deadline.is_some_and(|deadline| sent > slack.after(deadline))
            };
            lives().filter(late).count()
        };
        totals.missed = told(ExceptionKind::MissedDeadline);
        check(Loss::Late, late(tolerance, recent)..=late(-tolerance, end), totals.missed, violations);
    }

    /// Non real-time events of a channel are sent in the order in which they were published.
    fn total_non_real_time(&self, account: &Account, totals: &mut Totals, violations: &mut Vec<Violation>) {
        let (etag, node) = (account.channel.etag, account.channel.publisher);
        let end = self.journal.end;
        let last_sent = account.events.iter().rposition(|life| life.sent_at.is_some()).unwrap_or(0);
        let unsent = || account.events.iter().enumerate().filter(|(_, it)| it.taken && it.sent_at.is_none());
        let has_expired = |life: &Life| life.expires_at.is_some_and(|expires| expires < end);
        totals.expired = unsent().filter(|(_, life)| has_expired(life)).count();
        let reported = self.ledger.count(node, etag, ExceptionKind::ValidityExpired);
        if totals.expired > reported {
            let (what, lost) = (Loss::Expired, totals.expired);
            violations.push(Violation::Unreported { etag, node, what, lost, reported });
        }
        let lost = unsent().filter(|(at, life)| !has_expired(life) && *at < last_sent).count();
        totals.under_way = unsent().count() - totals.expired - lost;
        if lost > 0 {
            let what = Loss::Overtaken;
            violations.push(Violation::Unreported { etag, node, what, lost, reported: 0 });
        }
    }

    /// What was sent arrives at each subscriber, or the subscriber is told.
    fn check_deliveries(&self, account: &Account, violations: &mut Vec<Violation>) {
        let channel = account.channel;
        let recent = (-Span::from(NOTIFIED)).after(self.journal.end);
        for node in &channel.subscribers {
            let is_lost = |(at, life): &(usize, &Life)| {
                let Some(sent_at) = life.sent_at.filter(|sent| *sent < recent) else { return false };
                let published_at = life.published_at;
                let Some(subscription) = self.ledger.subscription(*node, channel.number, published_at) else {
                    return false;
                };
                // That a node was bus-off is reported as such.
                life.deliveries_to(*node).next().is_none()
                    && !account.is_left(*at, subscription)
                    && !self.journal.was_off(*node, published_at, sent_at)
            };
            let lost = account.events.iter().enumerate().filter(is_lost).count();
            let told = |kind| self.ledger.count(*node, channel.etag, kind);
            let kinds = [ExceptionKind::QueueFull, ExceptionKind::EventOverwritten, ExceptionKind::Malformed];
            let reported: usize = kinds.into_iter().map(told).sum();
            if lost > reported {
                let (etag, node, what) = (channel.etag, *node, Loss::Undelivered);
                violations.push(Violation::Unreported { etag, node, what, lost, reported });
            }
        }
    }
}

/// How late a node may notice that an instant has passed, or that a frame was sent.
const TOLERANCE: Duration = Duration::from_micros(100);
/// From the end of a frame until the application has taken its event, at worst.
const NOTIFIED: Duration = Duration::from_millis(2);
