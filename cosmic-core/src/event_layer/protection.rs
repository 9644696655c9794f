//! Bus protection: the channels of a node are held to their [rates](super::rate), those that the plan does not know wait
//! until they are admitted, and subscribers of periodic ones are told of events that do not come.

use super::attributes::Attributes;
use super::channel::{Entry, Outlet};
use super::declared::{Declared, Listed};
use super::gate::Gate;
use super::layer::EventLayer;
use super::publish::PublishError;
use crate::network::soft::Tag;
use crate::time::{Duration, Instant};
use crate::uid::Subject;

impl<const CHANNELS: usize, const SUBSCRIPTIONS: usize, const EVENTS: usize, D: Listed>
    EventLayer<CHANNELS, SUBSCRIPTIONS, EVENTS, D>
{
    /// Whether this node may publish on a channel from now on. O(CHANNELS).
    pub(crate) fn set_gate(&mut self, subject: Subject, gate: Gate) {
        let Some(tag) = self.tag_of(subject) else { return };
        if let Some(entry) = self.entry_mut(tag.0) {
            entry.gate = gate;
        }
        self.update(tag.0);
    }

    /// Returns whether events of the channel are sent as non real-time ones, though it is a soft real-time one.
    pub(crate) fn is_demoted(&self, tag: Tag) -> bool {
        let entry = self.channels.get(usize::from(tag.0)).and_then(Option::as_ref);
        entry.is_some_and(|entry| entry.gate == Gate::NonRealTime)
    }

    /// Nothing can be published on the channel: but if that is only for its rate, it is charged for one event and opened
    /// for it, until [`close`](Self::close). A channel with a rate is closed otherwise, so that the others need not ask
    /// whether they have one.
    pub(crate) fn open(&mut self, now: Instant, tag: Tag) -> Result<bool, PublishError> {
        self.entry_mut(tag.0).map_or(Ok(false), |entry| entry.open(now))
    }

    /// The event for which the channel was opened has been published, or not.
    pub(crate) fn close(&mut self, tag: Tag) {
        if let Some(entry) = self.entry_mut(tag.0) {
            entry.outlet = Outlet::CLOSED;
        }
    }

    /// The next event of the channel is a frame of a message: charges the whole message with its first, if the
    /// channel has a rate.
    pub(crate) fn charge_message(&mut self, now: Instant, tag: Tag, first: bool) -> Result<(), PublishError> {
        self.entry_mut(tag.0).map_or(Ok(()), |entry| entry.charge_message(now, first))
    }

    /// When an event is overdue, if none comes before. It may be early.
    pub(crate) fn next_overdue(&self) -> Instant {
        if D::RATES { self.first_overdue } else { Instant::FAR_FUTURE }
    }

    /// A channel of which events are overdue, and how many; call until it returns `None`. O(CHANNELS), but O(1)
    /// before [`next_overdue`](Self::next_overdue).
    pub(crate) fn take_overdue(&mut self, now: Instant) -> Option<(Subject, u32)> {
        if !D::RATES || now < self.first_overdue {
            return None;
        }
        let mut entries = self.channels.iter_mut().flatten();
        let found = entries.find_map(|entry| match entry.take_overdue(now) {
            0 => None,
            missed => Some((entry.declared().subject, missed)),
        });
        if found.is_none() {
            let all = self.channels.iter().flatten().map(Entry::overdue_at);
            self.first_overdue = all.fold(Instant::FAR_FUTURE, Instant::min);
        }
        found
    }
}

impl Declared {
    /// Returns whether subscribers are told of events that do not come: those of periodic soft channels.
    pub(super) const fn is_awaited(&self) -> bool {
        matches!((self.rate, &self.attributes), (Some(rate), Attributes::Soft(_)) if rate.is_periodic())
    }

    /// How long a subscriber of a periodic soft channel waits for the next event; `None` for other channels.
    const fn patience(&self) -> Option<Duration> {
        match (self.rate, &self.attributes) {
            (Some(rate), Attributes::Soft(quality)) if rate.is_periodic() => Some(rate.patience(quality)),
            _ => None,
        }
    }
}

impl<D: Listed> Entry<D> {
    /// Opens the outlet of a channel with a rate for one event, which is charged for it. Returns whether it did; or that
    /// the event comes too early.
    fn open(&mut self, now: Instant) -> Result<bool, PublishError> {
        if self.guarded_outlet.is_closed() || !self.outlet.is_closed() {
            return Ok(false);
        }
        if !self.guard.begin() {
            self.charge_event(now)?;
        }
        self.outlet = self.guarded_outlet;
        Ok(true)
    }

    /// The next event is a frame of a message, which is charged as one event, with its first frame.
    pub(super) fn charge_message(&mut self, now: Instant, first: bool) -> Result<(), PublishError> {
        if first {
            self.charge_event(now)?;
        }
        self.guard.prepay();
        Ok(())
    }

    fn charge_event(&mut self, now: Instant) -> Result<(), PublishError> {
        let Some(rate) = self.rate() else { return Ok(()) };
        if self.guard.charge(&rate, now) {
            return Ok(());
        }
        self.counters.too_fast = self.counters.too_fast.wrapping_add(1);
        Err(PublishError::TooFast)
    }

    pub(super) fn refund(&mut self) {
        if let Some(rate) = self.rate() {
            self.guard.refund(&rate);
        }
    }

    /// When the next event of a channel is overdue, if it does not come; [`Instant::FAR_FUTURE`] if none is awaited.
    #[inline(never)]
    pub(super) fn overdue_at(&self) -> Instant {
        let patience = self.declared().patience().unwrap_or(Duration::MAX);
        let ticks = self.awaited_since.since_epoch().as_ticks().saturating_add(patience.as_ticks());
        Instant::from_epoch(Duration::from_ticks(ticks))
    }

    /// How many events have not come by now that should have.
    #[expect(
        clippy::arithmetic_side_effects,
        reason = "an interval is not zero, and all that have passed end by now"
    )]
    pub(super) fn take_overdue(&mut self, now: Instant) -> u32 {
        let Some(rate) = self.rate() else { return 0 };
        let overdue_at = self.overdue_at();
        if now < overdue_at || overdue_at == Instant::FAR_FUTURE {
            return 0;
        }
        let late = now.saturating_since(overdue_at).as_ticks();
        let interval = rate.interval().as_ticks().max(1);
        let more = late / interval;
        // As if each had come, and been as late as it may be.
        self.awaited_since = self.awaited_since + Duration::from_ticks(more * interval + interval);
        u32::try_from(more).unwrap_or(u32::MAX).saturating_add(1)
    }
}
