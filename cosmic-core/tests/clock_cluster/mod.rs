//! Nodes with oscillators on a bus that delivers whole frames; true time in nanoseconds.

use cosmic_core::can::{Frame, TxNode};
use cosmic_core::protocol::{FollowUp, Rank};
use cosmic_core::sync::{ClockEvent, ClockSync, SyncConfig};
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant};

pub(crate) const MILLISECOND: u64 = 1_000_000;
pub(crate) const SECOND: u64 = 1_000 * MILLISECOND;
/// The longest frame at 1 Mbit/s.
const FRAME: u64 = 160_000;

/// The fault hypothesis of the clock synchronisation.
const MOST_MISSED: u8 = 3;

/// What is wrong with every node.
#[derive(Clone, Copy)]
pub(crate) struct Environment {
    /// The span between two sync frames, in nanoseconds.
    pub(crate) period: u64,
    /// The largest deviation of an oscillator from its nominal frequency.
    pub(crate) drift: f64,
    /// The largest change of that, per second.
    pub(crate) wander: f64,
    /// The share of pairs of sync and follow-up of which a receiver misses one or both, but never more
    /// than [`MOST_MISSED`] of a sender in a row.
    pub(crate) loss: f64,
}

/// Pseudo-random numbers (SplitMix64).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    /// -1.0..1.0
    pub(crate) fn signed(&mut self) -> f64 {
        self.next() as f64 / u64::MAX as f64 * 2.0 - 1.0
    }
}

/// Local time as a function of true time: the frequency moves up and down on straight lines.
struct Oscillator {
    limit: f64,
    wander: f64,
    /// True time, local time and relative frequency at the start of the line, and its slope per ns.
    start: u64,
    local: f64,
    frequency: f64,
    slope: f64,
}

impl Oscillator {
    fn local_at(&self, at: u64) -> f64 {
        let span = (at - self.start) as f64;
        self.local + span * (1.0 + self.frequency) + self.slope * span * span / 2.0
    }

    fn next_line(&mut self, at: u64, random: &mut Random) {
        self.local = self.local_at(at);
        self.frequency += self.slope * (at - self.start) as f64;
        self.start = at;
        // At full wander half of the time, where errors are largest.
        let slope = (random.signed() * 2.0).clamp(-1.0, 1.0);
        let inwards = if self.frequency.abs() < self.limit { slope } else { -self.frequency.signum() };
        self.slope = inwards * self.wander / 1e9;
    }
}

pub(crate) struct Node {
    pub(crate) sync: ClockSync,
    pub(crate) up: bool,
    pub(crate) segment: u8,
    pub(crate) events: Vec<ClockEvent>,
    /// Added to the instants in its follow-ups, in nanoseconds.
    pub(crate) lie: i64,
    /// For each sender: pairs missed in a row, and which frames of the present pair are missed.
    missed: Vec<(u8, Missed)>,
    config: SyncConfig,
    oscillator: Oscillator,
}

#[derive(Clone, Copy, Default)]
struct Missed {
    sync: bool,
    follow_up: bool,
}

/// A frame on its way.
#[derive(Clone, Copy)]
struct Flying {
    sender: usize,
    frame: Frame,
    /// When its transmission ends, successful or not.
    ends_at: u64,
    expires_at: u64,
}

pub(crate) struct Cluster {
    pub(crate) now: u64,
    pub(crate) nodes: Vec<Node>,
    pub(crate) environment: Environment,
    /// In nanoseconds, of any node that was synchronised.
    pub(crate) largest_accuracy: u64,
    seed: u64,
    random: Random,
    /// Are frames withdrawn that could not be sent in their lifetime, as the clock asks for?
    pub(crate) frames_expire: bool,
    flying: Vec<Flying>,
    /// Segments were joined; their nodes need not agree before this instant.
    agreed_from: u64,
}

impl Cluster {
    /// All nodes are candidates, ranked by their number.
    pub(crate) fn new(seed: u64, nodes: usize, environment: Environment) -> Self {
        let mut random = Random(seed);
        let count = nodes;
        let nodes = (0..nodes)
            .map(|number| {
                let config = SyncConfig {
                    rank: Rank::new(number as u8),
                    period: Duration::from_ticks(environment.period),
                    ..SyncConfig::DEFAULT
                };
                let oscillator = Oscillator {
                    limit: environment.drift,
                    wander: environment.wander,
                    start: 0,
                    local: random.below(100 * SECOND) as f64,
                    frequency: random.signed() * environment.drift,
                    slope: 0.0,
                };
                let sync = started(config, number, &oscillator, 0);
                Node {
                    sync,
                    up: true,
                    segment: 0,
                    events: Vec::new(),
                    lie: 0,
                    missed: vec![(0, Missed::default()); count],
                    config,
                    oscillator,
                }
            })
            .collect();
        Self {
            now: 0,
            nodes,
            environment,
            largest_accuracy: 0,
            seed,
            random,
            frames_expire: true,
            flying: Vec::new(),
            agreed_from: 0,
        }
    }

    /// Crash, or start with nothing in memory.
    pub(crate) fn set_up(&mut self, number: usize, up: bool) {
        let node = &mut self.nodes[number];
        if up && !node.up {
            node.sync = started(node.config, number, &node.oscillator, self.now);
        }
        node.up = up;
        if !up {
            self.flying.retain(|flying| flying.sender != number);
        }
    }

    pub(crate) fn join_segments(&mut self) {
        for node in &mut self.nodes {
            node.segment = 0;
        }
        self.agreed_from = self.now + self.environment.period + 10 * MILLISECOND;
    }

    pub(crate) fn masters(&self) -> Vec<usize> {
        (0..self.nodes.len()).filter(|&n| self.nodes[n].up && self.nodes[n].sync.is_master()).collect()
    }

    pub(crate) fn synchronised(&self) -> usize {
        self.nodes.iter().filter(|node| node.up && node.reading(self.now).is_some()).count()
    }

    pub(crate) fn run_for(&mut self, span: u64) {
        self.run_until(self.now + span);
    }

    /// Runs the nodes every millisecond and whenever a frame ends.
    pub(crate) fn run_until(&mut self, end: u64) {
        while self.now < end {
            let tick = self.now - self.now % MILLISECOND + MILLISECOND;
            let frame_end = self.flying.iter().map(|flying| flying.ends_at).min();
            self.now = frame_end.map_or(tick, |at| at.min(tick)).min(end);
            for node in &mut self.nodes {
                if self.now.saturating_sub(node.oscillator.start) > SECOND / 2 {
                    node.oscillator.next_line(self.now, &mut self.random);
                }
            }
            self.deliver();
            self.poll();
            self.check();
        }
    }

    fn deliver(&mut self) {
        while let Some(place) = self.flying.iter().position(|flying| flying.ends_at <= self.now) {
            let flying = self.flying.remove(place);
            let Flying { sender, frame, .. } = flying;
            let segment = self.nodes[sender].segment;
            let acknowledged = (0..self.nodes.len())
                .any(|n| n != sender && self.nodes[n].up && self.nodes[n].segment == segment);
            if !acknowledged {
                // The controller goes on trying.
                if !self.frames_expire || self.now < flying.expires_at {
                    self.flying.push(Flying { ends_at: self.now + FRAME, ..flying });
                }
                continue;
            }
            for number in 0..self.nodes.len() {
                let late = self.random.below(1_001);
                let node = &mut self.nodes[number];
                let missed = node.misses(sender, &frame, self.environment.loss, &mut self.random);
                if !node.up || node.segment != segment {
                    continue;
                }
                let stamp = node.oscillator.local_at(self.now + late) as u64 / 250 * 250;
                let stamp = Instant::from_epoch(Duration::from_ticks(stamp));
                if number == sender {
                    node.sync.on_sent(&frame, stamp);
                } else if !missed {
                    node.sync.on_frame(&frame, stamp);
                }
            }
        }
    }

    fn poll(&mut self) {
        for number in 0..self.nodes.len() {
            let node = &mut self.nodes[number];
            if !node.up {
                continue;
            }
            let local = node.local(self.now);
            // A wake-up that is missing in `next_wakeup` shows as work that is never done.
            while node.sync.next_wakeup() <= local
                && let Some(frame) = node.sync.poll(local)
            {
                let frame = node.distorted(frame);
                let ends_at = self.now + self.random.below(400_000) + FRAME;
                let expires_at = self.now + node.sync.frame_lifetime().as_ticks();
                self.flying.push(Flying { sender: number, frame, ends_at, expires_at });
            }
            while let Some(event) = node.sync.poll_event() {
                node.events.push(event);
            }
        }
    }

    /// Nobody is further from its master, or from any other node, than it says.
    fn check(&mut self) {
        let readings: Vec<_> = self.nodes.iter().map(|node| node.reading(self.now)).collect();
        for (number, reading) in readings.iter().enumerate() {
            let Some((time, accuracy)) = *reading else { continue };
            self.largest_accuracy = self.largest_accuracy.max(accuracy);
            for (other, reading) in readings.iter().enumerate().skip(number + 1) {
                let Some((other_time, other_accuracy)) = *reading else { continue };
                let apart = self.nodes[number].segment != self.nodes[other].segment;
                let lied = self.nodes.iter().any(|node| node.lie != 0);
                if apart || lied || self.now < self.agreed_from {
                    continue;
                }
                let distance = (time - other_time).unsigned_abs();
                assert!(
                    // Both readings are rounded.
                    distance <= accuracy + other_accuracy + 4,
                    "seed {}, at {} ns: nodes {number} and {other} are {distance} ns apart, stated {accuracy} and \
                     {other_accuracy}",
                    self.seed,
                    self.now,
                );
            }
        }
    }
}

impl Node {
    fn local(&self, at: u64) -> Instant {
        Instant::from_epoch(Duration::from_ticks(self.oscillator.local_at(at) as u64))
    }

    /// Global time and accuracy in nanoseconds, if it is up and synchronised.
    fn reading(&self, at: u64) -> Option<(i64, u64)> {
        let local = self.local(at);
        let accuracy = self.sync.clock().accuracy(local);
        let known = self.up && accuracy != GlobalClock::UNKNOWN;
        let time = self.sync.clock().to_global(local).signed_since(GlobalInstant::EPOCH);
        known.then_some((time, accuracy.as_ticks()))
    }

    /// Draws with each sync frame whether the pair is missed.
    fn misses(&mut self, sender: usize, frame: &Frame, loss: f64, random: &mut Random) -> bool {
        let (in_a_row, missed) = &mut self.missed[sender];
        if FollowUp::decode(frame).is_some() {
            return missed.follow_up;
        }
        let lost = (random.below(1_000_000) as f64) < loss * 1e6 && *in_a_row < MOST_MISSED;
        let which = random.below(3);
        *missed = Missed { sync: lost && which != 0, follow_up: lost && which != 1 };
        *in_a_row = if lost { *in_a_row + 1 } else { 0 };
        missed.sync
    }

    fn distorted(&self, frame: Frame) -> Frame {
        match FollowUp::decode(&frame) {
            Some(message) if self.lie != 0 => {
                let lie = FollowUp { sent_at: message.sent_at.offset_by(self.lie), ..message };
                lie.encode(frame.id.tx_node())
            }
            _ => frame,
        }
    }
}

fn started(config: SyncConfig, number: usize, oscillator: &Oscillator, at: u64) -> ClockSync {
    let local = Instant::from_epoch(Duration::from_ticks(oscillator.local_at(at) as u64));
    let mut sync = ClockSync::new(config, local).unwrap();
    sync.set_tx_node(TxNode::new(10 + number as u8));
    sync
}
