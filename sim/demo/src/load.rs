//! The background load: one more station, with the soft and non real-time events of nodes that are not there.
//!
//! It sends just so much that the bus as a whole comes near the load that was asked for: once every
//! millisecond it compares what the bus was busy with so far with what it should have been, and spreads
//! events for the difference over the next millisecond. Its soft real-time events go through the core's own
//! queue, so they compete by deadline like those of any node.

use std::collections::{BTreeMap, VecDeque};

use crate::cluster::Cluster;
use cosmic_bus::{EventKind, VirtualInstant};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::event_layer::Importance;
use cosmic_core::network::soft::{Etch, EtchStep, IncidentKind, Outgoing, PriorityMap, Tag};
use cosmic_core::time::{Duration, Instant};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A share of the capacity of the bus, 0 to 1.
#[derive(Clone, Copy, PartialEq, PartialOrd, Debug)]
pub struct Share(f64);

impl Share {
    /// Nothing.
    pub const NONE: Self = Self(0.0);

    /// `None` outside `0.0..=100.0`.
    pub fn percent(percent: f64) -> Option<Self> {
        (0.0..=100.0).contains(&percent).then_some(Self(percent / 100.0))
    }

    /// In percent.
    pub const fn as_percent(self) -> f64 {
        self.0 * 100.0
    }
}

/// What the background load has done.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct BackgroundLog {
    /// Soft real-time events, and non real-time events, that were to be sent.
    pub published: [u64; 2],
    /// Those that were sent.
    pub sent: [u64; 2],
    /// Soft real-time events that missed their deadline, reported by its queue.
    pub missed: u64,
    /// Soft real-time events that expired, reported by its queue.
    pub expired: u64,
    deadlines: BTreeMap<u32, VirtualInstant>,
}

impl BackgroundLog {
    /// The deadline of the event that a soft real-time frame of the background load carries.
    pub fn deadline(&self, frame: &Frame) -> Option<VirtualInstant> {
        self.deadlines.get(&sequence_of(frame)?).copied()
    }
}

/// The station that makes the load; without a bus, so that any can carry it.
///
/// Call [`plan`](Self::plan) and [`act`](Self::act) when they are due, and [`on_event`](Self::on_event)
/// followed by `act` for what its controller learns. The commands are to be carried out in their order
/// before the next call.
#[derive(Debug)]
pub struct Background {
    target: Share,
    bit_time: Duration,
    random: Pcg64Mcg,
    etch: Etch<SOFT, NON_REAL_TIME>,
    /// Events that were taken and are neither sent nor expired.
    queued: usize,
    arrivals: VecDeque<VirtualInstant>,
    plans_at: VirtualInstant,
    polls_at: Instant,
    sequence: u32,
    /// Names that it sends under.
    tx_nodes: Vec<TxNode>,
    etags: Vec<Etag>,
    log: BackgroundLog,
}

impl Background {
    /// A load that brings a bus of this bit rate to `target` as a whole, with priorities as the nodes have
    /// them. All its choices follow from the seed.
    pub fn new(bit_rate: BitRate, map: PriorityMap, target: Share, seed: u64) -> Self {
        Self {
            target,
            bit_time: bit_rate.bit_time(),
            random: Pcg64Mcg::seed_from_u64(seed ^ SEED),
            etch: Etch::new(map),
            queued: 0,
            arrivals: VecDeque::new(),
            plans_at: VirtualInstant::from_ticks(0),
            polls_at: Instant::FAR_FUTURE,
            sequence: 0,
            tx_nodes: (FIRST_TX_NODE..FIRST_TX_NODE + 64).filter_map(TxNode::new).collect(),
            etags: (FIRST_ETAG..FIRST_ETAG + 4096).filter_map(Etag::new).collect(),
            log: BackgroundLog::default(),
        }
    }

    /// With names that no node and no channel of this cluster has.
    #[must_use]
    pub fn beside(mut self, cluster: &Cluster) -> Self {
        self.tx_nodes.retain(|tx_node| cluster.node(*tx_node).is_none());
        self.etags.retain(|etag| !cluster.etags.contains(etag));
        self
    }

    /// When it acts next by itself.
    pub fn acts_at(&self) -> VirtualInstant {
        let polls_at = VirtualInstant::from_ticks(self.polls_at.since_epoch().as_ticks());
        self.arrivals.front().map_or(polls_at, |arrival| polls_at.min(*arrival))
    }

    /// When [`plan`](Self::plan) is to be called next.
    pub const fn plans_at(&self) -> VirtualInstant {
        self.plans_at
    }

    /// Its controller learnt something. Then [`act`](Self::act).
    pub fn on_event(&mut self, event: &EventKind, at: VirtualInstant) {
        let (mailbox, outcome) = match event {
            EventKind::Sent { mailbox } => (*mailbox, Outcome::Sent),
            EventKind::Withdrawn { mailbox } => (*mailbox, Outcome::Withdrawn),
            _ => return,
        };
        if let Some(mailbox) = Mailbox::ALL.get(mailbox) {
            self.finish(*mailbox, outcome, local(at));
        }
    }

    /// Does what is due, and appends the commands that its controller is to carry out. `now` does not
    /// decrease from call to call.
    pub fn act(&mut self, now: VirtualInstant, commands: &mut Vec<Command>) {
        while self.arrivals.front().is_some_and(|at| *at <= now) {
            self.arrivals.pop_front();
            commands.extend(self.publish(now));
        }
        loop {
            match self.etch.poll(local(now)) {
                EtchStep::Command(command) => commands.push(command),
                EtchStep::Incident(exception) => self.count(exception.kind),
                EtchStep::SleepUntil(instant) => {
                    self.polls_at = instant;
                    return;
                }
            }
        }
    }

    /// Plans arrivals for what the bus was less busy than it should have been; `busy_bits` is for how many
    /// bit times it was.
    pub fn plan(&mut self, now: VirtualInstant, busy_bits: u64) {
        self.plans_at = now + PLANNED;
        let bit_time = self.bit_time.as_ticks() as f64;
        // By the end of the time that is planned; what is queued will have been sent by then, or will not.
        let wanted = self.target.0 * (self.plans_at.as_ticks() as f64 / bit_time);
        let waiting = (self.queued as f64) * USUAL_FRAME_BITS;
        let missing = wanted - busy_bits as f64 - waiting;
        let longest = MOST_PLANNED.as_ticks() as f64 / bit_time;
        let mut count = missing.clamp(0.0, longest) / USUAL_FRAME_BITS;
        let mut arrivals: Vec<_> = self.arrivals.drain(..).collect();
        while count >= 1.0 || (count > 0.0 && self.draw_share() < count) {
            arrivals.push(now + Duration::from_ticks(self.draw(PLANNED.as_ticks())));
            count -= 1.0;
        }
        arrivals.sort_unstable();
        self.arrivals = arrivals.into();
    }

    /// What it has done so far.
    pub const fn log(&self) -> &BackgroundLog {
        &self.log
    }

    fn finish(&mut self, mailbox: Mailbox, outcome: Outcome, at: Instant) {
        let departure = self.etch.on_outcome(mailbox, outcome, at);
        if departure.sent.is_some() {
            self.queued = self.queued.saturating_sub(1);
            self.log.sent[usize::from(mailbox == Mailbox::NonRealTime)] += 1;
        }
        if let Some(exception) = departure.incident {
            self.count(exception.kind);
        }
    }

    fn count(&mut self, kind: IncidentKind) {
        match kind {
            IncidentKind::MissedDeadline => self.log.missed += 1,
            IncidentKind::Expired => {
                self.log.expired += 1;
                self.queued = self.queued.saturating_sub(1);
            }
            kind => unreachable!("nothing here loses its identifier: {kind:?}"),
        }
    }

    fn publish(&mut self, now: VirtualInstant) -> Option<Command> {
        let is_soft = self.draw_share() < SOFT_SHARE;
        self.log.published[usize::from(!is_soft)] += 1;
        self.sequence = self.sequence.wrapping_add(1);
        let frame = self.frame(is_soft);
        let forever = Instant::FAR_FUTURE;
        let mut event = Outgoing { tag: Tag(0), frame, deadline: forever, expires_at: forever };
        let submitted = if is_soft {
            let span = SHORTEST_DEADLINE + Duration::from_ticks(self.draw(DEADLINES.as_ticks()));
            event.deadline = local(now) + span;
            event.expires_at = event.deadline + VALID_LONGER;
            self.log.deadlines.insert(self.sequence, now + span);
            self.etch.submit_soft(local(now), event)
        } else {
            self.etch.submit_non_real_time(local(now), event)
        };
        match submitted {
            Ok(command) => {
                self.queued += 1;
                command
            }
            // The queue is full: the bus cannot carry more.
            Err(_) => None,
        }
    }

    fn frame(&mut self, is_soft: bool) -> Frame {
        let pick = |number: u64, choices: u64| number % choices.max(1);
        let one = |number: u64, choices: usize| pick(number, choices as u64) as usize;
        let tx_node = self.tx_nodes.get(one(self.random.next_u64(), self.tx_nodes.len())).copied();
        let etag = self.etags.get(one(self.random.next_u64(), self.etags.len())).copied();
        let importance = Importance::new(pick(self.random.next_u64(), 5) as u8);
        let priority = if is_soft {
            Priority::SOFT_LEAST_URGENT
        } else {
            importance.unwrap_or(Importance::LEAST).priority()
        };
        let mut bytes = self.random.next_u64().to_be_bytes();
        bytes[..4].copy_from_slice(&self.sequence.to_be_bytes());
        let len = 4 + pick(self.random.next_u64(), 5) as usize;
        // Of 64 TxNodes and 4096 etags no cluster has all.
        let id = Id::new(priority, tx_node.unwrap_or(TxNode::MAX), etag.unwrap_or(Etag::BOUND_FIRST));
        Frame::new(id, Payload::truncated(bytes, len))
    }

    fn draw(&mut self, limit: u64) -> u64 {
        self.random.next_u64() % limit
    }

    fn draw_share(&mut self) -> f64 {
        (self.random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// The number of an event of the background load: its content begins with it.
fn sequence_of(frame: &Frame) -> Option<u32> {
    frame.payload.as_slice().first_chunk().map(|bytes| u32::from_be_bytes(*bytes))
}

/// The background load is on no node: its local time is true time.
fn local(at: VirtualInstant) -> Instant {
    Instant::from_epoch(Duration::from_ticks(at.as_ticks()))
}

const SOFT: usize = 64;
const NON_REAL_TIME: usize = 64;
/// The rest is non real-time.
const SOFT_SHARE: f64 = 0.5;
const PLANNED: Duration = Duration::from_millis(1);
/// After a time in which the bus could not carry the load, no more than this is made up for.
const MOST_PLANNED: Duration = Duration::from_millis(2);
/// A frame of 4 to 8 bytes with its stuff bits and intermission, about.
const USUAL_FRAME_BITS: f64 = 122.0;
const SHORTEST_DEADLINE: Duration = Duration::from_millis(1);
const DEADLINES: Duration = Duration::from_millis(19);
const VALID_LONGER: Duration = Duration::from_millis(20);
/// Those of nodes and channels are taken out.
const FIRST_TX_NODE: u8 = 0x20;
const FIRST_ETAG: u16 = 0x2000;
/// So that the bus, which has the same seed, draws other numbers.
const SEED: u64 = 0x6261_636b_6772_6e64;

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_bus::{Bus, FaultModel, StationId, WireFrame};

    /// Lets the background load run alone.
    fn run(target: Share, seed: u64, until: VirtualInstant) -> (Bus, BackgroundLog) {
        let mut bus = Bus::new(BitRate::MAX, FaultModel::none());
        let station = bus.attach("background");
        // Somebody must acknowledge.
        bus.attach("listener");
        let mut background = Background::new(BitRate::MAX, PriorityMap::of(BitRate::MAX), target, seed);
        let (mut events, mut commands) = (Vec::new(), Vec::new());
        while bus.now() < until {
            let next = background.plans_at().min(background.acts_at()).min(until);
            let next = bus.next_event().map_or(next, |event| event.min(next));
            bus.advance(next, &mut events);
            for event in events.drain(..).filter(|event| event.station == station) {
                background.on_event(&event.kind, event.at);
            }
            if background.plans_at() <= next {
                background.plan(next, bus.accounting().busy_bits());
            }
            background.act(next, &mut commands);
            carry_out(&mut bus, station, &mut commands);
        }
        (bus, background.log)
    }

    fn carry_out(bus: &mut Bus, station: StationId, commands: &mut Vec<Command>) {
        let now = bus.now();
        for command in commands.drain(..) {
            match command {
                Command::Load(mailbox, frame) => {
                    bus.load(now, station, mailbox as usize, WireFrame::from(frame)).unwrap();
                }
                Command::Withdraw(mailbox) => bus.withdraw(now, station, mailbox as usize),
            }
        }
    }

    fn load(bus: &Bus) -> f64 {
        bus.accounting().busy_bits() as f64 * 1e5 / bus.now().as_ticks() as f64
    }

    #[test]
    fn the_load_that_was_asked_for_is_reached() {
        for percent in [10.0, 60.0, 95.0] {
            let (bus, log) =
                run(Share::percent(percent).unwrap(), 3, VirtualInstant::from_ticks(2_000_000_000));
            assert!((load(&bus) - percent).abs() < 0.5, "{percent}: {}", load(&bus));
            assert!(log.sent[0] > 0 && log.sent[1] > 0);
            assert_eq!((log.missed, log.expired), (0, 0));
        }
    }

    #[test]
    fn a_full_bus_is_full_and_nothing_else() {
        let (bus, _) = run(Share::percent(100.0).unwrap(), 3, VirtualInstant::from_ticks(1_000_000_000));
        assert!(load(&bus) > 98.0, "{}", load(&bus));
    }

    #[test]
    fn the_seed_decides() {
        let until = VirtualInstant::from_ticks(100_000_000);
        let share = Share::percent(50.0).unwrap();
        assert_eq!(run(share, 1, until).1, run(share, 1, until).1);
        assert_ne!(run(share, 1, until).1, run(share, 2, until).1);
        assert_eq!(run(Share::NONE, 1, until).1.published, [0, 0]);
    }
}
