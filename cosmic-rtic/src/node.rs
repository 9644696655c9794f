//! The event-triggered half of a node together with what it drives.

use core::task::{Poll, Waker};

use cosmic_core::Half as _;
use cosmic_core::Subject;
use cosmic_core::calendar::Slot;
use cosmic_core::can::{Command, ErrorCounters, Mailbox};
use cosmic_core::event_half::{Due, Input, Step};
use cosmic_core::event_layer::{
    AnnounceError, Channel, ChannelCounters, Content, Delivered, Event, Exception, ExceptionKind, Filter,
    Policy, Publication, PublishError, SubscribeError, Subscription,
};
use cosmic_core::protocol::ResetCause;
use cosmic_core::services::{News, Services};
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant};

use crate::board::{Board, BusStatus as _, Filters as _, TxMailbox as _};
use crate::departures::Departures;
use crate::inbox::{Counted, Item, Wake};
use crate::observer::{Observer as _, Observes};
use crate::rejoin::Rejoin;
use crate::sieve::Sieve;
use crate::signal::Signal;
use crate::system::{self, Half, System, Timed as _};

/// The event-triggered half of a node and what it drives: a shared resource of the event task and the
/// application. An application rather uses [`Publisher`](crate::Publisher) and [`Subscriber`](crate::Subscriber),
/// which lock it.
pub struct Node<T: System> {
    /// In the node's [`Storage`](crate::Storage), where it was put together: it is too large to be moved.
    pub(crate) half: &'static mut Half<T>,
    pub(crate) soft: <T::Board as Board>::Soft,
    pub(crate) non_real_time: <T::Board as Board>::NonRealTime,
    pub(crate) status: <T::Board as Board>::Status,
    pub(crate) filters: <T::Board as Board>::Filters,
    pub(crate) errors: ErrorCounters,
    pub(crate) rejoin: Rejoin,
    /// Wakes the event task.
    pub(crate) wake: &'static Wake,
    pub(crate) wake_calendar: &'static Signal,
    pub(crate) sync_period: Duration,
    /// When the clock was first seen to be synchronised, if it is.
    pub(crate) synchronised_since: Option<Instant>,
    /// Who sends messages, and what had been discarded when they were woken last.
    pub(crate) departures: Departures,
    pub(crate) discarded: u32,
    pub(crate) news_waker: Option<Waker>,
    pub(crate) sieve: &'static Sieve,
    pub(crate) observer: T::Observer,
}

impl<T: System> Node<T> {
    /// The services that the node takes part in.
    pub fn services(&self) -> &T::Services {
        self.half.services()
    }

    /// Asks something of the services.
    pub fn ask_services<R>(&mut self, ask: impl FnOnce(&mut T::Services) -> R) -> R {
        self.wake.something_due();
        ask(self.half.services_mut())
    }

    /// Why the node has started: its status tells it, where it has one.
    pub fn set_reset_cause(&mut self, cause: ResetCause) {
        self.half.services_mut().set_reset_cause(cause);
    }

    /// The observer.
    pub fn observer(&mut self) -> &mut T::Observer {
        &mut self.observer
    }

    /// The clock as it is now.
    pub fn clock(&self) -> GlobalClock {
        system::clock::<T>(self.half)
    }

    /// How often the time master sends its time; zero in a cluster without clock synchronisation.
    pub const fn sync_period(&self) -> Duration {
        self.sync_period
    }

    /// The next instant that is `lead` before a slot of the calendar is ready, in local time.
    pub fn before_slot(&self, slot: &Slot, lead: Duration, now: Instant) -> Instant {
        let clock = self.clock();
        let from = clock.to_global(now + lead).since_epoch().as_ticks();
        let phase = slot.phase.as_ticks();
        let period = slot.period.as_ticks().max(1);
        let slots_before = from.checked_sub(phase).map_or(0, |since_phase| since_phase / period + 1);
        let ready = phase + slots_before * period;
        let ready = GlobalInstant::from_epoch(Duration::from_ticks(ready));
        clock.to_local(ready).saturating_sub(lead)
    }

    /// Publishes an event of now on the channel of this subject, and tells the observer.
    ///
    /// # Errors
    /// The event is not sent.
    #[inline]
    pub fn publish<C: Content>(
        &mut self,
        subject: Subject,
        publication: &Publication<C>,
        event: &Event<C>,
    ) -> Result<(), PublishError>
    where
        T::Observer: Observes<C>,
    {
        let now = T::Board::now();
        let result = self.half.publish(now, publication, event).map(|due| self.carry_out(due));
        // There may be more to do than could be done at once, or something to be done later.
        self.wake.something_due();
        self.observer.published(subject, &event.content, now, result);
        result
    }

    /// How many frames of others came that concern nobody here. Wraps.
    pub fn foreign_frames(&self) -> u32 {
        self.half.foreign_frames().wrapping_add(self.sieve.foreign())
    }

    /// What happened on a channel at this node.
    pub fn channel_counters(&self, subject: Subject) -> Option<ChannelCounters> {
        self.half.channel_counters(subject)
    }

    /// How many exceptions of a kind there were. Wraps.
    pub fn exceptions(&self, kind: ExceptionKind) -> u32 {
        self.half.exceptions(kind)
    }

    /// Since when the clock is known to be synchronised: the first call that found it so. `None` if it is not.
    pub(crate) fn synchronised_since(&mut self, now: Instant) -> Option<Instant> {
        let since = self.synchronised_since.unwrap_or(now);
        self.synchronised_since = self.clock().is_synchronised(now).then_some(since);
        self.synchronised_since
    }

    pub(crate) fn announce<C: Content>(
        &mut self,
        channel: &'static Channel<C>,
    ) -> Result<Publication<C>, AnnounceError> {
        let publication = self.half.announce(channel)?;
        self.tell_interest();
        self.wake_both();
        Ok(publication)
    }

    pub(crate) fn subscribe<C: Content>(
        &mut self,
        channel: &'static Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError> {
        let subscription = self.half.subscribe(channel, filter, policy)?;
        self.tell_interest();
        self.wake_both();
        self.observer.subscribed(channel.subject(), filter, policy, T::Board::now());
        Ok(subscription)
    }

    pub(crate) fn cancel_publication<C>(&mut self, publication: Publication<C>) {
        for due in self.half.cancel_publication(publication) {
            self.carry_out(due);
        }
        self.wake_both();
    }

    pub(crate) fn cancel_subscription<C: Content>(
        &mut self,
        subject: Subject,
        subscription: Subscription<C>,
    ) {
        self.half.cancel_subscription(subscription);
        self.wake_both();
        self.observer.cancelled(subject, T::Board::now());
    }

    pub(crate) fn poll_next<C: Content>(
        &mut self,
        subject: Subject,
        subscription: &Subscription<C>,
        waker: &Waker,
    ) -> Poll<Delivered<C>>
    where
        T::Observer: Observes<C>,
    {
        let delivered = self.half.poll_next(subscription, waker);
        if let Poll::Ready(event) = &delivered {
            self.observer.delivered(subject, event, T::Board::now());
        }
        delivered
    }

    pub(crate) fn poll_exception(&mut self, waker: &Waker) -> Poll<Exception> {
        let exception = self.half.poll_exception(waker);
        if let Poll::Ready(exception) = &exception {
            self.observer.exception(exception);
        }
        exception
    }

    pub(crate) fn is_bound(&self, subject: Subject) -> bool {
        self.half.services().is_bound(subject)
    }

    pub(crate) fn poll_news(&mut self, waker: &Waker) -> Poll<News> {
        match self.half.services_mut().take_news() {
            Some(news) => Poll::Ready(news),
            None => {
                self.news_waker = Some(waker.clone());
                Poll::Pending
            }
        }
    }

    /// Takes in what an interrupt or the calendar task has handed over. Returns whether something may be due now, or
    /// earlier than was said.
    #[inline]
    pub(crate) fn take_in(&mut self, item: &Item) -> bool {
        let due = self.half.on_input(&item.input, item.at);
        if let Input::Outcome(Mailbox::NonRealTime, _) = item.input {
            self.departures.wake();
        }
        due
    }

    /// Does what is due, and says when something will be, if nothing else happens. `counted` is what has been lost.
    ///
    /// Ends: each turn fills or empties one of two mailboxes, and an emptied one is filled only after its
    /// outcome was taken in.
    pub(crate) fn attend(&mut self, counted: &Counted, now: Instant) -> Instant {
        if counted.lost > 0 {
            self.half.on_input(&Input::Lost(counted.lost), now);
        }
        if counted.overruns > 0 {
            self.half.on_input(&Input::Overrun(counted.overruns), now);
        }
        for _ in 0..counted.times_off {
            self.half.on_input(&Input::BusOff, now);
        }
        let errors = self.status.errors();
        if core::mem::replace(&mut self.errors, errors) != errors {
            self.half.on_input(&Input::Errors(errors), now);
        }
        let mut next = loop {
            match self.half.poll(now) {
                Step::Command(command) => self.execute(command),
                Step::SleepUntil(instant) => break instant,
            }
        };
        if T::Board::REJOINS_ON_REQUEST {
            let (is_off, went_off) = (self.status.is_off(), counted.times_off > 0);
            next = next.min(self.rejoin.attend(now, is_off, went_off, || self.status.ask_to_rejoin()));
        }
        self.tell_interest();
        let discarded = [ExceptionKind::ValidityExpired, ExceptionKind::IdentifierLost]
            .into_iter()
            .fold(0, |sum: u32, kind| sum.wrapping_add(self.half.exceptions(kind)));
        if core::mem::replace(&mut self.discarded, discarded) != discarded {
            self.departures.wake();
        }
        if self.half.services().has_news()
            && let Some(waker) = self.news_waker.take()
        {
            waker.wake();
        }
        self.observer.attended();
        next
    }

    /// Controller and interrupts let through what concerns the node now.
    #[inline(never)]
    fn tell_interest(&mut self) {
        if let Some(interest) = self.half.take_interest() {
            self.sieve.set(&interest);
            // Where nobody gives names, the filters of the plan stay, and this is not in the image.
            if <T::Services as Services>::GIVES_TX_NODE {
                self.filters.set(self.half.wanted());
            }
        }
    }

    /// The calendar task has other slots, and the services more to say.
    pub(crate) fn wake_both(&mut self) {
        self.wake_calendar.raise(1);
        self.wake.something_due();
    }

    #[inline]
    pub(crate) fn carry_out(&mut self, due: Due) {
        if let Some(command) = due.command() {
            self.execute(command);
        }
    }

    #[inline]
    fn execute(&mut self, command: Command) {
        match command {
            Command::Load(Mailbox::Soft, frame) => self.soft.load(&frame),
            Command::Load(Mailbox::NonRealTime, frame) => self.non_real_time.load(&frame),
            Command::Withdraw(Mailbox::Soft) => self.soft.withdraw(),
            Command::Withdraw(Mailbox::NonRealTime) => self.non_real_time.withdraw(),
            // This half has no hard real-time frames; the calendar task owns that mailbox.
            Command::Load(Mailbox::Hard, _) | Command::Withdraw(Mailbox::Hard) => {}
        }
    }
}
