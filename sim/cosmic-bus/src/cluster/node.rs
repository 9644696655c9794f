//! A simulated node: the two halves of the core, an application, and what a driver does for them.

use super::clock::{ClockErrors, LocalClock};
use crate::bus::Bus;
use crate::event::{EventKind, StationId};
use crate::frame::WireFrame;
use crate::time::{FAR_FUTURE, VirtualInstant};
use cosmic_core::Delivered;
use cosmic_core::calendar::Calendar;
use cosmic_core::can::{Command, ErrorCounters, Frame, Mailbox, Outcome, TxNode};
use cosmic_core::event_half::{Due, EventHalf, Input, Step, outcome, receive};
use cosmic_core::event_layer::{
    AnnounceError, Channel, Content, Event, Exception, Filter, MessagePublisher, MessageSubscriber, Policy,
    Publication, PublishError, SubscribeError, Subscription,
};
use cosmic_core::network::fragments::Message;
use cosmic_core::network::hard::{self, Dispatcher, HrtBuffers};
use cosmic_core::services::Services;
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant};
use rand_core::Rng;
use rand_pcg::Pcg64Mcg;

/// Slots of the calendar in which a simulated node can take part.
pub const SLOTS: usize = 32;

/// The event-triggered half of a simulated node.
pub type Half<S> = EventHalf<SLOTS, 64, 64, 200, 64, 64, S>;

/// What runs on a node. All methods get the node to act on.
pub trait Application<S: Services> {
    /// The node has been powered on: announce, subscribe. Returns when to wake up first.
    fn start(&mut self, node: &mut Access<'_, S>) -> Instant;

    /// The instant has come that was asked for last. Returns the next.
    fn wake(&mut self, node: &mut Access<'_, S>) -> Instant;

    /// Something has happened: events or exceptions may be there to be fetched.
    fn notified(&mut self, node: &mut Access<'_, S>);
}

/// How a node is made, at each power-on.
pub struct NodeConfig<S> {
    /// Its name in the trace.
    pub name: String,
    /// Its fixed id, if it has one.
    pub tx_node: Option<TxNode>,
    /// The calendar in its image.
    pub calendar: &'static Calendar,
    /// What is wrong with its clock.
    pub clock: ClockErrors,
    /// Its services, started at the local time that is given.
    pub services: Box<dyn Fn(Instant) -> S>,
    /// What its time-triggered half knows of global time before the services tell it.
    pub global_clock: GlobalClock,
    /// Its application.
    pub application: Box<dyn Fn() -> Box<dyn Application<S>>>,
}

/// A node as its application sees it.
pub struct Access<'n, S: Services> {
    /// The present local time.
    pub now: Instant,
    /// The present global time by this node's clock.
    pub global: GlobalInstant,
    /// True time, which a real node cannot know: for judging, not for acting.
    pub true_now: VirtualInstant,
    /// The present local time between the ticks of the timer: for judging, too.
    pub exact_now: Instant,
    half: &'n mut Half<S>,
    commands: &'n mut Vec<Command>,
}

impl<S: Services> Access<'_, S> {
    /// As [`EventHalf::announce`].
    ///
    /// # Errors
    /// As there.
    pub fn announce<C: Content>(&mut self, channel: &Channel<C>) -> Result<Publication<C>, AnnounceError> {
        self.half.announce(channel)
    }

    /// As [`EventHalf::subscribe`].
    ///
    /// # Errors
    /// As there.
    pub fn subscribe<C: Content>(
        &mut self,
        channel: &Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError> {
        self.half.subscribe(channel, filter, policy)
    }

    /// As [`EventHalf::publish`].
    ///
    /// # Errors
    /// As there.
    pub fn publish<C: Content>(
        &mut self,
        publication: &Publication<C>,
        event: &Event<C>,
    ) -> Result<(), PublishError> {
        self.commands.extend(self.half.publish(self.now, publication, event)?.command());
        Ok(())
    }

    /// As [`EventHalf::cancel_publication`].
    pub fn cancel_publication<C>(&mut self, publication: Publication<C>) {
        let due = self.half.cancel_publication(publication);
        self.commands.extend(due.into_iter().filter_map(Due::command));
    }

    /// As [`EventHalf::cancel_subscription`].
    pub fn cancel_subscription<C>(&mut self, subscription: Subscription<C>) {
        self.half.cancel_subscription(subscription);
    }

    /// As [`EventHalf::next`].
    pub fn next<C: Content>(&mut self, subscription: &Subscription<C>) -> Option<Delivered<C>> {
        self.half.next(subscription)
    }

    /// As [`EventHalf::send_message`].
    ///
    /// # Errors
    /// As there.
    pub fn send_message<const LEN: usize>(
        &mut self,
        publisher: &mut MessagePublisher<LEN>,
    ) -> Result<(), PublishError> {
        self.commands.extend(self.half.send_message(self.now, publisher)?.command());
        Ok(())
    }

    /// As [`EventHalf::receive_messages`].
    pub fn receive_messages<const PLACES: usize, const LEN: usize>(
        &mut self,
        subscriber: &mut MessageSubscriber<PLACES, LEN>,
        each: impl FnMut(Message<'_>),
    ) {
        self.half.receive_messages(subscriber, self.now, each);
    }

    /// As [`EventHalf::take_exception`].
    pub fn take_exception(&mut self) -> Option<Exception> {
        self.half.take_exception()
    }

    /// The event-triggered half, for its counters and services.
    pub fn half(&mut self) -> &mut Half<S> {
        self.half
    }

    /// The HRT message buffers, for their counters.
    pub fn hard(&mut self) -> &mut HrtBuffers<SLOTS> {
        self.half.hard_mut()
    }
}

/// The parts that a power-on makes anew.
struct Running<S: Services> {
    clock: LocalClock,
    dispatcher: Dispatcher<SLOTS>,
    half: Half<S>,
    application: Box<dyn Application<S>>,
    application_wakes_at: Instant,
    /// What the half was told last.
    errors: ErrorCounters,
}

pub(super) struct Node<S: Services> {
    pub(super) station: StationId,
    config: NodeConfig<S>,
    running: Option<Running<S>>,
    commands: Vec<Command>,
    random: Pcg64Mcg,
    /// When the dispatcher, and when the rest, is to run next.
    pub(super) hard_wakes_at: VirtualInstant,
    pub(super) soft_wakes_at: VirtualInstant,
    /// The earlier of them, as it stands in the cluster's list.
    pub(super) scheduled_at: VirtualInstant,
}

impl<S: Services> Node<S> {
    pub(super) fn new(station: StationId, config: NodeConfig<S>, random: Pcg64Mcg) -> Self {
        Self {
            station,
            config,
            running: None,
            commands: Vec::new(),
            random,
            hard_wakes_at: FAR_FUTURE,
            soft_wakes_at: FAR_FUTURE,
            scheduled_at: FAR_FUTURE,
        }
    }

    pub(super) fn power_on(&mut self, bus: &mut Bus, now: VirtualInstant) {
        let clock = LocalClock::new(self.config.clock, now);
        let services = (self.config.services)(clock.read(now));
        let calendar = self.config.calendar;
        let buffers = HrtBuffers::new(self.config.global_clock);
        self.running = Some(Running {
            clock,
            dispatcher: Dispatcher::new(calendar),
            half: EventHalf::new(self.config.tx_node, calendar, services, buffers),
            application: (self.config.application)(),
            application_wakes_at: Instant::FAR_FUTURE,
            errors: ErrorCounters::NONE,
        });
        self.with_application(now, |application, access| application.start(access));
        self.run_soft(bus, now);
        self.run_hard(bus, now);
    }

    pub(super) fn power_off(&mut self) {
        self.running = None;
        self.hard_wakes_at = FAR_FUTURE;
        self.soft_wakes_at = FAR_FUTURE;
    }

    /// Calls the application with access to the node, if it is on.
    pub(super) fn visit<R>(
        &mut self,
        bus: &mut Bus,
        now: VirtualInstant,
        visitor: impl FnOnce(&mut Access<'_, S>) -> R,
    ) -> Option<R> {
        let result = self.access(now, |_, access| visitor(access));
        self.run_soft(bus, now);
        result
    }

    /// What the interrupts of the controller do.
    pub(super) fn on_event(&mut self, bus: &mut Bus, now: VirtualInstant, kind: &EventKind) {
        let stamp = self.stamp(now);
        let Some(running) = &mut self.running else { return };
        match *kind {
            EventKind::Received(frame) => {
                let Ok(frame) = Frame::try_from(frame) else { return };
                let Some(input) = receive(&frame, stamp, running.half.hard_mut()) else { return };
                running.half.on_input(&input, stamp);
            }
            EventKind::Sent { mailbox } => self.on_outcome(mailbox, Outcome::Sent, stamp),
            EventKind::Withdrawn { mailbox } => self.on_outcome(mailbox, Outcome::Withdrawn, stamp),
            EventKind::ErrorState(state) if state.level() == crate::ErrorLevel::BusOff => {
                running.half.on_input(&Input::BusOff, stamp);
            }
            EventKind::Failed { .. } | EventKind::ErrorState(_) => return,
        }
        self.run_soft(bus, now);
    }

    fn on_outcome(&mut self, mailbox: usize, what: Outcome, at: Instant) {
        let Some(running) = &mut self.running else { return };
        let Some(&mailbox) = Mailbox::ALL.get(mailbox) else { return };
        if let Some(input) = outcome(mailbox, what, at, running.half.hard_mut()) {
            running.half.on_input(&input, at);
        }
    }

    /// The task of the calendar dispatcher.
    pub(super) fn run_hard(&mut self, bus: &mut Bus, now: VirtualInstant) {
        let mut notified = false;
        while let Some(running) = &mut self.running {
            let local = running.clock.read(now);
            match running.dispatcher.poll(local, running.half.hard_mut()) {
                hard::CalendarStep::Command(command) => {
                    self.commands.push(command);
                    self.execute(bus, now);
                }
                hard::CalendarStep::Notify(buffer) => {
                    running.half.on_input(&Input::Notice(buffer), local);
                    notified = true;
                }
                hard::CalendarStep::Continue => {}
                hard::CalendarStep::SleepUntil(instant) => {
                    let wake = running.clock.when(instant).max(now);
                    let delay = draw(&mut self.random, self.config.clock.release_delay);
                    self.hard_wakes_at = wake + delay;
                    break;
                }
            }
        }
        if notified {
            self.run_soft(bus, now);
        }
    }

    /// The tasks below it.
    pub(super) fn run_soft(&mut self, bus: &mut Bus, now: VirtualInstant) {
        self.tell_errors(bus.error_state(self.station), now);
        self.notify(now);
        self.execute(bus, now);
        while let Some(running) = &mut self.running {
            let local = running.clock.read(now);
            if local >= running.application_wakes_at {
                self.with_application(now, |application, access| application.wake(access));
                self.execute(bus, now);
                continue;
            }
            match running.half.poll(local) {
                Step::Command(command) => {
                    self.commands.push(command);
                    self.execute(bus, now);
                }
                Step::SleepUntil(instant) => {
                    let wake = instant.min(running.application_wakes_at);
                    self.soft_wakes_at = match wake {
                        Instant::FAR_FUTURE => FAR_FUTURE,
                        wake => running.clock.when(wake).max(now),
                    };
                    return;
                }
            }
        }
    }

    /// The counters as bxCAN shows them: eight bits each.
    fn tell_errors(&mut self, state: crate::ErrorState, now: VirtualInstant) {
        let Some(running) = &mut self.running else { return };
        let low_byte = |count: u16| count.min(u8::MAX.into()) as u8;
        let errors = ErrorCounters {
            transmit: low_byte(state.transmit_errors),
            receive: low_byte(state.receive_errors),
        };
        if core::mem::replace(&mut running.errors, errors) != errors {
            running.half.on_input(&Input::Errors(errors), running.clock.read(now));
        }
    }

    fn notify(&mut self, now: VirtualInstant) {
        self.access(now, |application, access| application.notified(access));
    }

    fn with_application(
        &mut self,
        now: VirtualInstant,
        call: impl FnOnce(&mut dyn Application<S>, &mut Access<'_, S>) -> Instant,
    ) {
        let next = self.access(now, call);
        if let Some((next, running)) = next.zip(self.running.as_mut()) {
            running.application_wakes_at = next;
        }
    }

    fn access<R>(
        &mut self,
        now: VirtualInstant,
        call: impl FnOnce(&mut dyn Application<S>, &mut Access<'_, S>) -> R,
    ) -> Option<R> {
        let running = self.running.as_mut()?;
        let local = running.clock.read(now);
        let mut access = Access {
            now: local,
            global: running.half.hard().clock().to_global(local),
            true_now: now,
            exact_now: running.clock.exact(now),
            half: &mut running.half,
            commands: &mut self.commands,
        };
        Some(call(running.application.as_mut(), &mut access))
    }

    /// What the driver does with the transmit mailboxes.
    fn execute(&mut self, bus: &mut Bus, now: VirtualInstant) {
        for command in self.commands.drain(..) {
            match command {
                Command::Load(mailbox, frame) => {
                    let loaded = bus.load(now, self.station, mailbox as usize, WireFrame::from(frame));
                    // The core loads a mailbox only when it is empty; anything else is an error of the core.
                    loaded.expect("the mailbox is empty");
                }
                Command::Withdraw(mailbox) => bus.withdraw(now, self.station, mailbox as usize),
            }
        }
    }

    fn stamp(&mut self, now: VirtualInstant) -> Instant {
        let late = draw(&mut self.random, self.config.clock.stamp_delay);
        match &self.running {
            Some(running) => running.clock.read(now + late),
            None => Instant::EPOCH,
        }
    }
}

fn draw(random: &mut Pcg64Mcg, limit: Duration) -> Duration {
    if limit.is_zero() {
        return limit;
    }
    Duration::from_ticks(random.next_u64() % (limit.as_ticks() + 1))
}
