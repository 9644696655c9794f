//! Stations without a processor, driven by the host: background load, disturbers.

use std::collections::VecDeque;

use cosmic_bus::{Bus, EventKind, MAILBOXES, StationId, VirtualInstant, WireFrame, time};
use cosmic_core::can::{Frame, Id, Payload};
use cosmic_core::time::Duration;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A station that acts by itself at instants it names, and reacts to what its controller learns.
pub trait Station {
    /// When it acts next; `None` if never. Not before the present.
    fn acts_at(&self) -> Option<VirtualInstant>;
    /// It is that instant. [`Station::acts_at`] must have moved on when this returns.
    fn act(&mut self, port: &mut Port<'_>);
    /// Its controller learnt something.
    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>);
}

/// A station's access to the bus, at the present instant.
#[derive(Debug)]
pub struct Port<'a> {
    bus: &'a mut Bus,
    station: StationId,
}

impl<'a> Port<'a> {
    pub(crate) fn new(bus: &'a mut Bus, station: StationId) -> Self {
        Self { bus, station }
    }

    /// The present instant.
    pub fn now(&self) -> VirtualInstant {
        self.bus.now()
    }

    /// Loads a frame into a mailbox of the station; `false` if it is occupied.
    #[must_use]
    pub fn load(&mut self, mailbox: usize, frame: WireFrame) -> bool {
        self.bus.load(self.bus.now(), self.station, mailbox, frame).is_ok()
    }

    /// Requests the withdrawal of a frame.
    pub fn withdraw(&mut self, mailbox: usize) {
        self.bus.withdraw(self.bus.now(), self.station, mailbox);
    }
}

/// Frames of random content at random instants, which fill a share of the bus.
///
/// Frames come independently of each other: the time between two is uniform between zero and twice its
/// mean. A frame that finds the mailboxes full waits in a queue; the first of the queue goes first.
#[derive(Debug)]
pub struct BackgroundLoad {
    ids: Vec<Id>,
    mean_interval: Duration,
    random: Pcg64Mcg,
    next: VirtualInstant,
    waiting: VecDeque<Frame>,
    free: [bool; MAILBOXES],
    queued: u64,
    sent: u64,
}

/// The length of an extended frame with eight random bytes: 131 bits, about 7 stuff bits of the 23 that it
/// can have, and the intermission.
const MEAN_FRAME_BITS: u32 = 138;

impl BackgroundLoad {
    /// A load that uses `percent` of the capacity of `bus`, with one of the identifiers for each frame.
    /// `None` if the load is none or there is no identifier.
    pub fn new(bus: &Bus, percent: u32, ids: Vec<Id>, seed: u64) -> Option<Self> {
        if percent == 0 || ids.is_empty() {
            return None;
        }
        let mean_interval = bus.bit_rate().bits(MEAN_FRAME_BITS) * 100 / percent;
        let mut load = Self {
            ids,
            mean_interval,
            random: Pcg64Mcg::seed_from_u64(seed),
            next: time::EPOCH,
            waiting: VecDeque::new(),
            free: [true; MAILBOXES],
            queued: 0,
            sent: 0,
        };
        load.next = bus.now() + load.interval();
        Some(load)
    }

    /// Frames that were to be sent so far.
    pub const fn queued(&self) -> u64 {
        self.queued
    }

    /// Frames that were sent so far.
    pub const fn sent(&self) -> u64 {
        self.sent
    }

    fn interval(&mut self) -> Duration {
        let twice_the_mean = 2 * self.mean_interval.as_ticks();
        Duration::from_ticks(self.random.next_u64() % (twice_the_mean + 1))
    }

    fn fill(&mut self, port: &mut Port<'_>) {
        for mailbox in 0..MAILBOXES {
            if !self.free[mailbox] {
                continue;
            }
            let Some(frame) = self.waiting.pop_front() else { return };
            self.free[mailbox] = !port.load(mailbox, frame.into());
        }
    }
}

impl Station for BackgroundLoad {
    fn acts_at(&self) -> Option<VirtualInstant> {
        Some(self.next)
    }

    fn act(&mut self, port: &mut Port<'_>) {
        let chosen = self.random.next_u64() % self.ids.len() as u64;
        let payload = Payload::full(self.random.next_u64().to_le_bytes());
        self.waiting.push_back(Frame::new(self.ids[chosen as usize], payload));
        self.queued += 1;
        let interval = self.interval();
        self.next += interval;
        self.fill(port);
    }

    fn on_event(&mut self, event: &EventKind, port: &mut Port<'_>) {
        let (EventKind::Sent { mailbox } | EventKind::Withdrawn { mailbox }) = event else { return };
        self.free[*mailbox] = true;
        self.sent += u64::from(matches!(event, EventKind::Sent { .. }));
        self.fill(port);
    }
}
