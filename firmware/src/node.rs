//! The event-triggered half of a node together with its two mailboxes, and access to what the halves
//! share.

use boards::bxcan_status::{BusStatus, ErrorState};
use boards::bxcan_tx::{NonRealTimeMailbox, SoftMailbox};
use boards::clock;
use cosmic_core::calendar::Slot;
use cosmic_core::can::{Command, ErrorCounters, Mailbox};
use cosmic_core::event_half::{Capacity, Input, Step};
use cosmic_core::event_layer::{
    AnnounceError, Channel, Content, Event, Filter, Policy, Publication, PublishError, SubscribeError,
    Subscription,
};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::ClockService;
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant};
use rtic_sync::signal::SignalWriter;

use crate::cluster::plan::Capacities;
use crate::inbox::Item;
use crate::shared::Locked;

/// What the two halves of a node share.
pub type Buffers = <Capacities as Capacity>::Buffers;
/// The time-triggered half.
pub type Calendar = <Capacities as Capacity>::Dispatcher;
/// The event-triggered half.
pub type Half = <Capacities as Capacity>::Half<ClockService, Locked>;

/// The parts of the node of this plan, which has announced nothing yet.
/// For `init`: the settings of the clock synchronisation are checked here.
pub fn parts(plan: &NodePlan) -> (Half, Calendar) {
    let NodePlan { tx_node, calendar, .. } = *plan;
    let config = defmt::unwrap!(plan.sync, "the plan has no clock synchronisation");
    let clock = ClockService::new(config, calendar, Some(tx_node), clock::now());
    let half = Capacities::half(Some(tx_node), calendar, defmt::unwrap!(clock), Locked);
    (half, Capacities::dispatcher(calendar))
}

/// The event-triggered half and what it drives. A resource of the `etch` task and the application.
pub struct Node {
    half: Half,
    soft: SoftMailbox,
    non_real_time: NonRealTimeMailbox,
    bus: BusStatus,
    is_off: bool,
    errors: ErrorCounters,
    wake_calendar: SignalWriter<'static, ()>,
}

impl Node {
    /// Puts it together. `wake_calendar` wakes the calendar task.
    pub fn new(
        half: Half,
        soft: SoftMailbox,
        non_real_time: NonRealTimeMailbox,
        bus: BusStatus,
        wake_calendar: SignalWriter<'static, ()>,
    ) -> Self {
        Self { half, soft, non_real_time, bus, is_off: false, errors: ErrorCounters::NONE, wake_calendar }
    }

    /// Announces a channel.
    ///
    /// # Errors
    /// Those of [`EventHalf::announce`](cosmic_core::EventHalf::announce).
    pub fn announce<C: Content>(&mut self, channel: &Channel<C>) -> Result<Publication<C>, AnnounceError> {
        let publication = self.half.announce(channel)?;
        self.wake_calendar.write(());
        Ok(publication)
    }

    /// Subscribes to all events of a channel.
    ///
    /// # Errors
    /// Those of [`EventHalf::subscribe`](cosmic_core::EventHalf::subscribe).
    pub fn subscribe<C: Content>(
        &mut self,
        channel: &Channel<C>,
        policy: Policy,
    ) -> Result<Subscription<C>, SubscribeError> {
        let subscription = self.half.subscribe(channel, Filter::ALL, policy)?;
        self.wake_calendar.write(());
        Ok(subscription)
    }

    /// The half itself, to fetch events and handle exceptions.
    pub fn half(&mut self) -> &mut Half {
        &mut self.half
    }

    /// Publishes an event. Wake the `etch` task afterwards.
    ///
    /// # Errors
    /// Those of [`EventHalf::publish`](cosmic_core::EventHalf::publish).
    pub fn publish<C: Content>(
        &mut self,
        now: Instant,
        publication: &Publication<C>,
        event: &Event<C>,
    ) -> Result<(), PublishError> {
        if let Some(command) = self.half.publish(now, publication, event)?.command() {
            self.carry_out(command);
        }
        Ok(())
    }

    /// Takes in what an interrupt or the calendar task has handed over.
    pub fn take_in(&mut self, item: &Item) {
        self.half.on_input(&item.input, item.at);
    }

    /// Does what is due, and says when something will be, if nothing else happens.
    ///
    /// Ends: each turn fills or empties one of two mailboxes, and an emptied one is filled only after its
    /// outcome was taken in.
    pub fn attend(&mut self, now: Instant) -> Instant {
        self.watch_bus(now);
        loop {
            match self.half.poll(now) {
                Step::Command(command) => self.carry_out(command),
                Step::SleepUntil(instant) => return instant,
            }
        }
    }

    /// The clock as it is now.
    pub fn clock(&self) -> GlobalClock {
        self.half.services().clock()
    }

    /// The next instant that is `lead` before a slot of the calendar is ready, in local time.
    pub fn before_slot(&self, slot: &Slot, lead: Duration, now: Instant) -> Instant {
        let clock = self.clock();
        let period = slot.period.as_ticks().max(1);
        let from = clock.to_global(now + lead).since_epoch().as_ticks();
        let since_phase = from.saturating_sub(slot.phase.as_ticks());
        let ready = slot.phase.as_ticks() + (since_phase / period + 1) * period;
        let ready = GlobalInstant::from_epoch(Duration::from_ticks(ready));
        clock.to_local(ready).saturating_sub(lead)
    }

    fn watch_bus(&mut self, now: Instant) {
        let errors = self.bus.errors();
        if core::mem::replace(&mut self.errors, errors) != errors {
            self.half.on_input(&Input::Errors(errors), now);
        }
        let is_off = self.bus.state() == ErrorState::BusOff;
        if is_off && !self.is_off {
            self.half.on_input(&Input::BusOff, now);
        }
        self.is_off = is_off;
    }

    #[inline]
    fn carry_out(&mut self, command: Command) {
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
