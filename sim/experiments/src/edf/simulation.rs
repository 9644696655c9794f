//! A message set on the bit-accurate bus, under the core's own event-triggered channel handlers.
//!
//! Every node has an [`Etch`] and its transmit mailboxes. Interrupts and tasks take no time, local clocks are
//! true time, and the bus is free of faults: what is measured is the scheduling alone.

use super::message_set::{INTERMISSION_BITS, MessageSet, Timing};
use super::outcome::{Meter, Run};
use super::{Policy, Releases};
use cosmic_bus::time::{EPOCH, FAR_FUTURE};
use cosmic_bus::{Bus, Event, EventKind, FaultModel, Filters, StationId, VirtualInstant, WireFrame};
use cosmic_core::can::{BitRate, Command, Mailbox, Outcome};
use cosmic_core::network::soft::{Etch, EtchStep, Outgoing, PriorityMap, Tag};
use cosmic_core::time::{Duration, Instant};

/// A queue that holds every message of a set at once.
type Handler = Etch<255, 255>;

struct Node {
    station: StationId,
    handler: Box<Handler>,
    wakes_at: VirtualInstant,
    is_due: bool,
}

/// A message that has been released and not yet sent.
#[derive(Clone, Copy)]
struct Pending {
    deadline: Instant,
    bits: u32,
}

pub(super) struct Simulation<'s> {
    set: &'s MessageSet,
    timings: Vec<Timing>,
    policy: Policy,
    bus: Bus,
    nodes: Vec<Node>,
    /// By message; an earlier release of it has been sent when the next comes, or its deadline was missed.
    pending: Vec<Option<Pending>>,
    meter: Meter,
}

impl<'s> Simulation<'s> {
    /// All nodes are on and idle; `load` is the share of the bus that the messages take.
    pub(super) fn new(set: &'s MessageSet, policy: Policy, load: f64) -> Self {
        let mut bus = Bus::new(BitRate::MAX, FaultModel::none());
        let last = set.messages.iter().map(|message| message.node.get()).max().unwrap_or(0);
        let nodes = (0..=last).map(|number| Node::new(&mut bus, number, policy)).collect();
        // Somebody has to acknowledge.
        let listener = bus.attach("listener");
        bus.set_filters(listener, Filters::accept_none());
        let timings = set.timings(load);
        let pending = vec![None; timings.len()];
        let meter = Meter::new(timings.len());
        Self { set, timings, policy, bus, nodes, pending, meter }
    }

    /// Releases messages and lets time pass until a deadline is missed, or until `end`.
    pub(super) fn run(mut self, mut releases: Releases, end: Instant) -> Run {
        let end = VirtualInstant::from_ticks(end.since_epoch().as_ticks());
        let mut events = Vec::new();
        loop {
            let wake = self.nodes.iter().map(|node| node.wakes_at).min().unwrap_or(FAR_FUTURE);
            let release = virtual_of(releases.next_at());
            let event = self.bus.next_event().unwrap_or(FAR_FUTURE);
            let now = wake.min(release).min(event);
            if now > end {
                break;
            }
            self.bus.advance(now, &mut events);
            let in_time = events.drain(..).all(|event| self.on_event(&event));
            if !in_time || !self.release(&mut releases, now) {
                return self.meter.missed(&self.timings);
            }
            self.run_nodes(now);
        }
        let late = |pending: &Pending| virtual_of(pending.deadline) <= end;
        if self.pending.iter().flatten().any(late) {
            return self.meter.missed(&self.timings);
        }
        self.meter.all_met(&self.timings)
    }

    /// A mailbox has become empty. `false` if its frame was sent too late.
    fn on_event(&mut self, event: &Event) -> bool {
        let (mailbox, outcome) = match event.kind {
            EventKind::Sent { mailbox } => (mailbox, Outcome::Sent),
            EventKind::Withdrawn { mailbox } => (mailbox, Outcome::Withdrawn),
            _ => return true,
        };
        let Some(mailbox) = Mailbox::ALL.get(mailbox) else { return true };
        let Some(node) = self.nodes.get_mut(event.station.index()) else { return true };
        let at = local_of(event.at);
        node.is_due = true;
        let departure = node.handler.on_outcome(*mailbox, outcome, at);
        let Some(sent) = departure.sent else { return true };
        let message = usize::from(sent.tag.0);
        let Some(pending) = self.pending[message].take() else { return true };
        self.meter.sent(message, pending.bits);
        at <= pending.deadline
    }

    /// Releases what is due. `false` if the release before has not been sent.
    fn release(&mut self, releases: &mut Releases, now: VirtualInstant) -> bool {
        while let Some((message, count, _)) = releases.pop(local_of(now), &self.timings) {
            if self.pending[message].is_some() {
                return false;
            }
            self.submit(message, count, now);
        }
        true
    }

    fn submit(&mut self, message: usize, count: u64, now: VirtualInstant) {
        let description = &self.set.messages[message];
        let deadline = self.timings[message].deadline_of(local_of(now));
        let frame = description.frame(count, description.rank);
        let outgoing = Outgoing { tag: Tag(message as u8), frame, deadline, expires_at: Instant::FAR_FUTURE };
        self.pending[message] = Some(Pending { deadline, bits: 0 });
        let node = &mut self.nodes[usize::from(description.node.get())];
        node.is_due = true;
        let submitted = match self.policy {
            Policy::DeadlineMonotonic => node.handler.submit_non_real_time(local_of(now), outgoing),
            _ => node.handler.submit_soft(local_of(now), outgoing),
        };
        // There is room for every message of the set; one that were refused would miss its deadline.
        if let Ok(Some(command)) = submitted {
            let station = node.station;
            self.execute(station, command, now);
        }
    }

    fn run_nodes(&mut self, now: VirtualInstant) {
        for at in 0..self.nodes.len() {
            let node = &mut self.nodes[at];
            if !core::mem::take(&mut node.is_due) && node.wakes_at > now {
                continue;
            }
            loop {
                let node = &mut self.nodes[at];
                match node.handler.poll(local_of(now)) {
                    EtchStep::Command(command) => {
                        let station = node.station;
                        self.execute(station, command, now);
                    }
                    // The judge looks at the bus.
                    EtchStep::Incident(_) => {}
                    EtchStep::SleepUntil(instant) => {
                        node.wakes_at = virtual_of(instant);
                        break;
                    }
                }
            }
        }
    }

    fn execute(&mut self, station: StationId, command: Command, now: VirtualInstant) {
        match command {
            Command::Load(mailbox, frame) => {
                let message = super::message_set::number_of(frame.id.etag());
                let frame = WireFrame::from(frame);
                if let Some(pending) = &mut self.pending[message] {
                    pending.bits = frame.bit_count() + INTERMISSION_BITS;
                }
                let loaded = self.bus.load(now, station, mailbox as usize, frame);
                // The core loads a mailbox only when it is empty; anything else is an error of the core.
                loaded.expect("the mailbox is empty");
            }
            Command::Withdraw(mailbox) => self.bus.withdraw(now, station, mailbox as usize),
        }
    }
}

impl Node {
    fn new(bus: &mut Bus, number: u8, policy: Policy) -> Self {
        let station = bus.attach(format!("node {number}"));
        bus.set_filters(station, Filters::accept_none());
        let map = match policy {
            Policy::Mapped { step } => PriorityMap::new(step),
            Policy::DeadlineMonotonic | Policy::Ideal => None,
        };
        let handler = Etch::new(map.unwrap_or(PriorityMap::of(BitRate::MAX)));
        Self { station, handler: Box::new(handler), wakes_at: FAR_FUTURE, is_due: false }
    }
}

fn local_of(at: VirtualInstant) -> Instant {
    Instant::from_epoch(Duration::from_ticks(at.as_ticks()))
}

fn virtual_of(at: Instant) -> VirtualInstant {
    match at {
        Instant::FAR_FUTURE => FAR_FUTURE,
        at => EPOCH + at.since_epoch(),
    }
}
