//! What the tasks of a node and the handles of its application share, behind one lock that is held for the time of a
//! call: no await stands between taking and giving it back.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use cosmic_bus::WireFrame;
use cosmic_core::broker;
use cosmic_core::calendar::Calendar;
use cosmic_core::can::{Command, ErrorCounters, Etag, Frame, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::event_half::{Due, Input, Step, outcome, receive};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::services::News;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use tokio::sync::{Notify, broadcast, watch};

use crate::config::{Config, StartError};
use crate::half::{Broker, Half, Hosting, Services};
use crate::link::{Bell, End, LinkCounters, LinkError};
use crate::message_queues::Messages;
use crate::places::{Handover, Places};

pub(crate) struct Shared {
    core: Mutex<Core>,
    /// There is something for the link.
    bell: Bell,
    /// The core wants to be polled earlier than its keeper is going to.
    pub(crate) timer_wake: Notify,
    /// Changes whenever frames have left.
    pub(crate) departures: watch::Sender<u64>,
    /// Changes whenever a wait for a condition is to look again.
    pub(crate) changed: watch::Sender<u64>,
    pub(crate) news: broadcast::Sender<News>,
    start: tokio::time::Instant,
}

/// The middleware, and what it drives.
pub(crate) struct Core {
    pub(crate) half: Box<Half>,
    places: Places,
    pub(crate) messages: Messages,
    pub(crate) counters: LinkCounters,
    pub(crate) is_connected: bool,
    /// Why the link is not connected, as far as it has said.
    pub(crate) link_error: Option<LinkError>,
    /// How often the link has said so.
    failures: u64,
    calendar: &'static Calendar,
    /// The hard real-time event of each publisher and channel that was delivered last.
    hard: HashMap<(Etag, TxNode), (Payload, Instant)>,
    next_wakeup: Instant,
    /// When its keeper polls it.
    polled_at: Instant,
}

impl Shared {
    pub(crate) fn new(config: &Config) -> Result<Self, StartError> {
        let start = tokio::time::Instant::now();
        let now = EARLIEST;
        let broker = config.broker.as_ref().map(|tables| restore(config, tables)).transpose()?;
        let node = cosmic_core::services::NodeConfig {
            // It stamps frames too late to be a master of time.
            clock: cosmic_core::sync::SyncConfig { rank: None, ..config.node.clock },
            ..config.node
        };
        let services = Services::new(&node, config.calendar, broker, now).map_err(StartError::Clock)?;
        let buffers = HrtBuffers::new(GlobalClock::unsynchronised());
        let half = Box::new(Half::new(None, config.calendar, services, buffers));
        let core = Core {
            half,
            places: Places::new(),
            messages: Messages::default(),
            counters: LinkCounters::default(),
            is_connected: false,
            link_error: None,
            failures: 0,
            calendar: config.calendar,
            hard: HashMap::new(),
            next_wakeup: now,
            polled_at: now,
        };
        Ok(Self {
            core: Mutex::new(core),
            bell: Bell::default(),
            timer_wake: Notify::new(),
            departures: watch::Sender::new(0),
            changed: watch::Sender::new(0),
            news: broadcast::Sender::new(NEWS),
            start,
        })
    }

    /// Local time.
    pub(crate) fn now(&self) -> Instant {
        let elapsed = self.start.elapsed().as_nanos();
        EARLIEST + Duration::from_ticks(u64::try_from(elapsed).unwrap_or(u64::MAX / 2))
    }

    /// The instant of tokio's clock; `None` if it will not come.
    fn tokio_instant(&self, instant: Instant) -> Option<tokio::time::Instant> {
        if instant == Instant::FAR_FUTURE {
            return None;
        }
        let since = instant.saturating_since(EARLIEST).as_ticks();
        self.start.checked_add(std::time::Duration::from_nanos(since))
    }

    /// Acts on the core, and then does what is due.
    pub(crate) fn act<R>(&self, act: impl FnOnce(&mut Core, Instant) -> R) -> R {
        let mut core = self.lock();
        let now = self.now();
        let result = act(&mut core, now);
        core.attend(now);
        self.tell(&mut core);
        let is_due = core.places.any_due();
        let is_early = core.next_wakeup < core.polled_at;
        if is_early {
            core.polled_at = core.next_wakeup;
        }
        drop(core);
        if is_due {
            self.bell.ring(self);
        }
        if is_early {
            self.timer_wake.notify_one();
        }
        result
    }

    /// When the core's keeper is to poll it, if it is not woken before. It may be early then: that events come and go
    /// moves the core's own instant all the time, and to follow each time would take a change of tasks for each event.
    pub(crate) fn poll_next_at(&self) -> Option<tokio::time::Instant> {
        let at = self.look(|core| {
            core.polled_at = core.next_wakeup;
            core.polled_at
        });
        self.tokio_instant(at)
    }

    /// Looks at the core only.
    pub(crate) fn look<R>(&self, look: impl FnOnce(&mut Core) -> R) -> R {
        look(&mut self.lock())
    }

    /// What the link is to do next. What has expired by now is withdrawn before.
    fn next_handover(&self, link_withdraws: bool) -> Option<Handover> {
        let mut core = self.lock();
        core.attend(self.now());
        self.tell(&mut core);
        core.places.hand_over(link_withdraws)
    }

    fn tell(&self, core: &mut Core) {
        let mut any = false;
        while let Some(news) = core.half.services_mut().take_news() {
            any = true;
            // Nobody need listen.
            let _ = self.news.send(news);
        }
        let changes = core.counters.control_frames + core.counters.connections + core.failures;
        if any || changes != *self.changed.borrow() {
            self.changed.send_replace(changes);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Core> {
        // Whoever panicked did so in the core, which does not; what it left is looked at as it is.
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Frames have left the link's places, sent or given back.
    fn departed(&self) {
        self.departures.send_modify(|departures| *departures = departures.wrapping_add(1));
    }
}

impl End for Shared {
    fn connected(&self) {
        self.act(|core, _| core.connected());
    }

    fn disconnected(&self, why: &LinkError) {
        self.act(|core, now| core.disconnected(why, now));
        self.departed();
    }

    fn received(&self, frame: &Frame, _: Option<std::time::Duration>) {
        self.act(|core, now| core.receive(frame, now));
    }

    fn foreign(&self, _: Option<&WireFrame>, _: Option<std::time::Duration>) {
        self.look(|core| core.counters.foreign += 1);
    }

    fn malformed(&self) {
        self.look(|core| core.counters.malformed += 1);
    }

    fn lost(&self, frames: u32) {
        self.act(|core, now| {
            core.counters.lost += u64::from(frames);
            core.input(&Input::Lost(frames), now);
        });
    }

    fn bus_off(&self) {
        self.act(|core, now| core.input(&Input::BusOff, now));
    }

    fn errors(&self, errors: ErrorCounters) {
        self.act(|core, now| core.input(&Input::Errors(errors), now));
    }

    fn hand_over(&self, link_withdraws: bool) -> Option<Handover> {
        self.next_handover(link_withdraws)
    }

    fn bell(&self) -> &Bell {
        &self.bell
    }

    fn conclude(&self, mailbox: Mailbox, outcome: Outcome) {
        self.act(|core, now| core.conclude(mailbox, outcome, now));
        self.departed();
    }

    fn unsent(&self) {
        self.look(|core| core.counters.unsent += 1);
    }

    fn connections(&self) -> u64 {
        self.look(|core| core.counters.connections)
    }
}

impl Core {
    /// A frame has arrived.
    pub(crate) fn receive(&mut self, frame: &Frame, at: Instant) {
        self.counters.received += 1;
        if frame.id.etag().is_reserved() {
            self.counters.control_frames += 1;
        }
        if frame.id.priority() == Priority::HARD && frame.id.etag().is_hard() {
            if self.is_first_copy(frame, at) {
                self.half.on_early_frame(frame, at);
            }
        } else if let Some(input) = receive(frame, at, self.half.hard_mut()) {
            self.half.on_input(&input, at);
        }
    }

    /// A copy of a frame that was repeated on the bus arrives in the same slot, with the same content.
    fn is_first_copy(&mut self, frame: &Frame, at: Instant) -> bool {
        let key = (frame.id.etag(), frame.id.tx_node());
        let Some(slot) = self.calendar.slots().iter().find(|slot| (slot.etag, slot.publisher) == key) else {
            // The core counts it.
            return true;
        };
        let window = self.calendar.slot_times(slot).delivery;
        let before = self.hard.insert(key, (frame.payload, at));
        !before.is_some_and(|(payload, then)| payload == frame.payload && at.saturating_since(then) < window)
    }

    /// Carries out what a call of the core asks for.
    pub(crate) fn carry_out(&mut self, due: Due, now: Instant) {
        if let Some(command) = due.command() {
            self.execute(&command, now);
        }
    }

    pub(crate) fn input(&mut self, input: &Input, at: Instant) {
        self.half.on_input(input, at);
    }

    /// The link says what became of a frame that it was handed.
    pub(crate) fn conclude(&mut self, mailbox: Mailbox, what: Outcome, at: Instant) {
        if self.places.conclude(mailbox) {
            if what == Outcome::Sent {
                self.counters.sent += 1;
            }
            self.outcome(mailbox, what, at);
        }
    }

    pub(crate) fn connected(&mut self) {
        self.is_connected = true;
        self.link_error = None;
        self.counters.connections += 1;
    }

    pub(crate) fn disconnected(&mut self, why: &LinkError, at: Instant) {
        self.is_connected = false;
        self.link_error = Some(why.clone());
        self.failures += 1;
        let (again, withdrawn) = self.places.disconnect();
        self.counters.repeated += u64::from(again);
        for mailbox in withdrawn {
            self.outcome(mailbox, Outcome::Withdrawn, at);
        }
    }

    /// Ends: each turn fills or empties a place, and an emptied one is filled from a queue that is finite.
    fn attend(&mut self, now: Instant) {
        loop {
            match self.half.poll(now) {
                Step::Command(command) => self.execute(&command, now),
                Step::SleepUntil(instant) => {
                    // What a message loads leaves its place before the next of its frames.
                    let dues = self.messages.attend(&mut self.half, now);
                    if !dues.is_empty() {
                        dues.into_iter().for_each(|due| self.carry_out(due, now));
                        continue;
                    }
                    self.next_wakeup = instant.min(self.messages.next_wakeup());
                    return;
                }
            }
        }
    }

    fn execute(&mut self, command: &Command, now: Instant) {
        if let Some((mailbox, what)) = self.places.execute(command) {
            self.outcome(mailbox, what, now);
        }
    }

    fn outcome(&mut self, mailbox: Mailbox, what: Outcome, at: Instant) {
        if let Some(input) = outcome(mailbox, what, at, self.half.hard_mut()) {
            self.half.on_input(&input, at);
        }
    }
}

fn restore(config: &Config, tables: &crate::BrokerTables) -> Result<Hosting, StartError> {
    let (mut nodes, mut subjects) = (broker::Nodes::new(), broker::Subjects::new());
    for &(uid, tx_node) in &tables.nodes {
        let entered = nodes.restore(uid, tx_node);
        entered
            .map_err(|why| StartError::BrokerTable(format!("node {uid} with id {}: {why}", tx_node.get())))?;
    }
    for &(subject, etag) in &tables.subjects {
        let entered = subjects.restore(subject, etag);
        entered.map_err(|why| {
            StartError::BrokerTable(format!("subject {subject} with etag {}: {why}", etag.get()))
        })?;
    }
    let broker = Broker::new(config.node.uid, broker::BrokerTiming::DEFAULT, nodes, subjects);
    Ok(Hosting::new(broker, config.node.admission, *config.node.admission_timing))
}

/// Local time at the start of a node: later than any span that is taken from it.
const EARLIEST: Instant = Instant::from_epoch(Duration::from_secs(3_600));

/// News that wait for whoever listens.
const NEWS: usize = 1024;
