//! One class of events on its way to the bus: a queue and the mailbox that its head is in.

use super::queue::{Queue, Ranked};
use crate::can::{Command, Etag, Frame, Id, Mailbox, Outcome};
use crate::time::Instant;

/// What the owner calls the source of a frame: its number for a channel, or a part of the protocol.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tag(pub u8);

/// Places of each queue that are kept for the services of the node.
pub const RESERVED: usize = 2;

impl Tag {
    /// The services of the node; channels have smaller numbers.
    pub const SERVICES: Self = Self(u8::MAX);

    /// The places of a queue that are not for this source.
    #[inline]
    pub(super) const fn reserve(self) -> usize {
        if self.0 == Self::SERVICES.0 { 0 } else { RESERVED }
    }
}

/// An event on its way to the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Outgoing {
    /// Where it comes from.
    pub tag: Tag,
    /// The frame. Its priority stands for a non real-time event and is replaced for a soft one.
    pub frame: Frame,
    /// It should have been sent by now. Later is an incident, and it is still sent.
    pub deadline: Instant,
    /// It is of no use any more. What is still not sent then is discarded, with an incident.
    pub expires_at: Instant,
}

/// Something went wrong with an event that was handed to the path.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Incident {
    /// Where the event comes from.
    pub tag: Tag,
    /// What went wrong.
    pub kind: IncidentKind,
}

/// What can go wrong with an event on its way to the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum IncidentKind {
    /// It has not been sent by its deadline; it is sent later.
    MissedDeadline,
    /// It expired before it was sent, and has been discarded.
    Expired,
    /// Its channel lost its etag, or the node its TxNode, before it was sent; it has been discarded.
    IdentifierLost,
}

/// The queue has no room for the event; it has been counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Full;

/// An event that has left the node.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sent {
    /// Where it came from.
    pub tag: Tag,
    /// Its frame; that of a soft event without the priority that it had in the end.
    pub frame: Frame,
}

/// Which of the events that have not been sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Unsent {
    /// Those that come from here.
    Of(Tag),
    /// Those that do not come from here.
    OfOthersThan(Tag),
    /// This frame from here.
    Frame(Tag, Frame),
}

impl Unsent {
    fn includes(&self, entry: &Entry) -> bool {
        match self {
            Self::Of(tag) => entry.tag == *tag,
            Self::OfOthersThan(tag) => entry.tag != *tag,
            Self::Frame(tag, frame) => entry.tag == *tag && entry.frame == *frame,
        }
    }
}

/// What became of the event that was in a mailbox.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Departure {
    /// It was sent.
    pub sent: Option<Sent>,
    /// The publisher must be told of this.
    pub incident: Option<Incident>,
}

/// An event on its way, as a lane keeps it: flat, so that it is no larger than it need be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    frame: Frame,
    deadline: Instant,
    expires_at: Instant,
    order: u32,
    tag: Tag,
    report: Report,
    /// Its rank is its deadline; otherwise the priority of its frame.
    by_deadline: bool,
}

/// What the publisher of an event still hears of it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Report {
    /// A missed deadline, and that it expired.
    Deadline,
    /// That it expired. The missed deadline has been reported, or nobody wants to hear of it.
    Expiry,
    /// That its identifier was lost, which is why it expires.
    IdentifierLost,
}

impl Ranked for Entry {
    fn key(&self) -> u64 {
        if self.by_deadline {
            self.deadline.since_epoch().as_ticks()
        } else {
            self.frame.id.priority().get().into()
        }
    }

    fn order(&self) -> u32 {
        self.order
    }
}

impl Entry {
    /// A soft real-time event.
    #[inline]
    pub(super) const fn soft(event: &Outgoing, report: Report, order: u32) -> Self {
        let &Outgoing { tag, frame, deadline, expires_at } = event;
        Self { frame, deadline, expires_at, order, tag, report, by_deadline: true }
    }

    /// A non real-time event.
    #[inline]
    pub(super) const fn non_real_time(event: &Outgoing, order: u32) -> Self {
        let &Outgoing { tag, frame, deadline, expires_at } = event;
        Self { frame, deadline, expires_at, order, tag, report: Report::Deadline, by_deadline: false }
    }

    pub(super) const fn frame(&self) -> &Frame {
        &self.frame
    }

    pub(super) const fn deadline(&self) -> Instant {
        self.deadline
    }

    fn attention_at(&self) -> Instant {
        // An event without deadline can expire, too.
        let expires_at = self.expires_at;
        match self.report {
            Report::Deadline => expires_at.min(self.deadline),
            Report::Expiry | Report::IdentifierLost => expires_at,
        }
    }

    /// What has become of it by now, if anything. The caller discards what has expired.
    fn examine(&mut self, now: Instant) -> Option<IncidentKind> {
        if now >= self.expires_at {
            return Some(self.expiry());
        }
        if self.report == Report::Deadline && now >= self.deadline {
            self.report = Report::Expiry;
            return Some(IncidentKind::MissedDeadline);
        }
        None
    }

    /// Why it is discarded when it expires.
    fn expiry(&self) -> IncidentKind {
        match self.report {
            Report::Deadline | Report::Expiry => IncidentKind::Expired,
            Report::IdentifierLost => IncidentKind::IdentifierLost,
        }
    }

    fn lose_identifier(&mut self, now: Instant) {
        // What has expired already stays expired.
        if self.expires_at > now {
            self.expires_at = now;
            self.report = Report::IdentifierLost;
        }
    }

    /// Gives it this etag, if it comes from this source. Returns whether it had another.
    fn rename(&mut self, tag: Tag, etag: Etag) -> bool {
        let id = self.frame.id;
        let old = self.tag == tag && id.etag() != etag;
        if old {
            self.frame.id = Id::new(id.priority(), id.tx_node(), etag);
        }
        old
    }

    fn incident(&self, kind: IncidentKind) -> Incident {
        Incident { tag: self.tag, kind }
    }
}

/// What becomes of the event in a mailbox when it comes back.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum AndThen {
    Requeue,
    Expire,
    Forget,
}

#[derive(Clone, Debug)]
pub(super) struct Lane<const N: usize> {
    mailbox: Mailbox,
    /// The entry that is out of it is in the mailbox.
    queue: Queue<Entry, N>,
    /// A withdrawal of that has been requested.
    withdrawing: Option<AndThen>,
    /// No entry in the queue needs attention before this.
    attention_at: Instant,
}

impl<const N: usize> Lane<N> {
    pub(super) const fn new(mailbox: Mailbox) -> Self {
        let (queue, attention_at) = (Queue::new(), Instant::FAR_FUTURE);
        Self { mailbox, queue, withdrawing: None, attention_at }
    }

    /// Frames that wait or are in the mailbox.
    pub(super) fn len(&self) -> usize {
        self.queue.len()
    }

    /// Returns whether the mailbox is free and nothing goes before a new event.
    #[inline]
    pub(super) fn is_idle(&self) -> bool {
        self.queue.is_empty()
    }

    /// Adds an entry, made of its order; leaves `reserve` places free. The frame in the mailbox comes back to
    /// the queue if it is withdrawn, so it keeps its place there.
    #[expect(clippy::arithmetic_side_effects, reason = "at most 255, and a few places")]
    pub(super) fn push(&mut self, reserve: usize, entry: impl FnOnce(u32) -> Entry) -> Result<(), Full> {
        if self.len() + reserve >= N {
            return Err(Full);
        }
        self.queue.push(|order| {
            let entry = entry(order);
            self.attention_at = self.attention_at.min(entry.attention_at());
            entry
        });
        Ok(())
    }

    /// Puts an entry into the mailbox past the queue; only when the lane [is idle](Self::is_idle).
    #[inline]
    pub(super) fn load_directly(&mut self, entry: impl FnOnce(u32) -> Entry) {
        self.queue.push_out(entry);
    }

    /// Loads the head, if the mailbox is free.
    pub(super) fn load(&mut self) -> Option<&Entry> {
        self.queue.take_out()
    }

    /// Returns whether an event waits that goes before the one in the mailbox.
    pub(super) fn is_overtaken(&self) -> bool {
        match (self.loaded(), self.queue.first()) {
            (Some(loaded), Some(first)) => first.key() < loaded.key(),
            _ => false,
        }
    }

    /// What is in the mailbox and not being withdrawn.
    pub(super) fn loaded(&self) -> Option<&Entry> {
        if self.withdrawing.is_none() { self.queue.out() } else { None }
    }

    /// Asks for the frame in the mailbox, to send it later or under another identifier.
    pub(super) fn withdraw(&mut self) -> Option<Command> {
        self.withdraw_and(AndThen::Requeue)
    }

    fn withdraw_and(&mut self, then: AndThen) -> Option<Command> {
        self.loaded()?;
        self.withdrawing = Some(then);
        Some(Command::Withdraw(self.mailbox))
    }

    /// Removes events that have not been sent: from the queue at once, from the mailbox by the command
    /// that is returned. O(N²), and O(N) for one event.
    // Out of line, as it is asked for in several places.
    #[inline(never)]
    pub(super) fn recall(&mut self, which: &Unsent) -> Option<Command> {
        while self.queue.take_where(|entry| which.includes(entry)).is_some() {}
        if !self.queue.out().is_some_and(|loaded| which.includes(loaded)) {
            return None;
        }
        // Once only is the frame asked for.
        let command = self.withdraw();
        self.withdrawing = Some(AndThen::Forget);
        command
    }

    /// The channel of this source has another etag: what has not been sent goes under the new one, as far
    /// as it can still be withdrawn. O(N).
    pub(super) fn rename(&mut self, tag: Tag, etag: Etag) -> Option<Command> {
        for entry in self.queue.waiting_mut() {
            entry.rename(tag, etag);
        }
        let is_old = self.queue.out_mut().is_some_and(|loaded| loaded.rename(tag, etag));
        // What is being withdrawn comes back anyway.
        if is_old { self.withdraw() } else { None }
    }

    /// The identifier of these is not their own any more: they are discarded. O(N).
    #[inline(never)]
    pub(super) fn revoke(&mut self, now: Instant, which: &Unsent) {
        for entry in self.queue.waiting_mut().filter(|entry| which.includes(entry)) {
            entry.lose_identifier(now);
        }
        if let Some(loaded) = self.queue.out_mut()
            && which.includes(loaded)
        {
            match &mut self.withdrawing {
                Some(AndThen::Expire | AndThen::Forget) => {}
                Some(then @ AndThen::Requeue) => {
                    loaded.lose_identifier(now);
                    *then = AndThen::Expire;
                }
                None => loaded.lose_identifier(now),
            }
        }
        // The next call looks through all of them.
        self.attention_at = Instant::EPOCH;
    }

    /// The mailbox has become empty.
    pub(super) fn on_outcome(&mut self, outcome: Outcome, at: Instant) -> Departure {
        let mut departure = Departure::default();
        let Some(loaded) = self.queue.out() else { return departure };
        match (outcome, self.withdrawing.take().unwrap_or(AndThen::Requeue)) {
            (Outcome::Sent, _) => {
                departure.sent = Some(Sent { tag: loaded.tag, frame: loaded.frame });
                if loaded.report == Report::Deadline && at > loaded.deadline {
                    departure.incident = Some(loaded.incident(IncidentKind::MissedDeadline));
                }
            }
            (Outcome::Withdrawn, AndThen::Requeue) => {
                self.attention_at = self.attention_at.min(loaded.attention_at());
                self.queue.put_back();
            }
            (Outcome::Withdrawn, AndThen::Expire) => {
                departure.incident = Some(loaded.incident(loaded.expiry()));
            }
            (Outcome::Withdrawn, AndThen::Forget) => {}
        }
        // Unless it has been put back.
        self.queue.remove_out();
        departure
    }

    /// Returns whether anything is to be reported or discarded by now.
    pub(super) fn needs_attention(&self, now: Instant) -> bool {
        now >= self.next_attention()
    }

    pub(super) fn next_attention(&self) -> Instant {
        self.loaded().map_or(self.attention_at, |loaded| self.attention_at.min(loaded.attention_at()))
    }

    /// Reports or discards one event: O(N). What is discarded from the mailbox is reported when it has
    /// left it.
    pub(super) fn attend(&mut self, now: Instant) -> Option<Attended> {
        if self.withdrawing.is_none()
            && let Some(loaded) = self.queue.out_mut()
        {
            match loaded.examine(now) {
                Some(IncidentKind::Expired | IncidentKind::IdentifierLost) => {
                    return self.withdraw_and(AndThen::Expire).map(Attended::Command);
                }
                Some(kind) => return Some(Attended::Incident(loaded.incident(kind))),
                None => {}
            }
        }
        if now < self.attention_at {
            return None;
        }
        let expired = |entry: &Entry| now >= entry.expires_at;
        if let Some(entry) = self.queue.take_where(expired) {
            return Some(Attended::Incident(entry.incident(entry.expiry())));
        }
        let mut next = Instant::FAR_FUTURE;
        for entry in self.queue.waiting_mut() {
            if let Some(kind) = entry.examine(now) {
                return Some(Attended::Incident(entry.incident(kind)));
            }
            next = next.min(entry.attention_at());
        }
        self.attention_at = next;
        None
    }
}

pub(super) enum Attended {
    Command(Command),
    Incident(Incident),
}
