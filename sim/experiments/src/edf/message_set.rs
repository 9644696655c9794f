//! Random sets of periodic messages.

use crate::random::Random;
use anyhow::bail;
use cosmic_bus::WireFrame;
use cosmic_commands::experiment::{Deadlines, Lengths, Shape};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::time::{Duration, Instant};

/// A periodic message.
#[derive(Clone, Debug)]
pub(super) struct PeriodicMessage {
    pub(super) node: TxNode,
    etag: Etag,
    len: usize,
    /// At the load that was drawn, in nanoseconds.
    period: f64,
    /// Of the period, to 1.
    deadline: f64,
    /// When it is first released with random offsets, as a share of the period.
    offset: f64,
    contents: u64,
    /// The mean length of its frames in bits, intermission included.
    mean_bits: f64,
    /// Its fixed priority: the earlier the relative deadline, the smaller.
    pub(super) rank: Priority,
}

/// Messages of a node each, at a load that can be chosen.
pub(super) struct MessageSet {
    pub(super) messages: Vec<PeriodicMessage>,
    /// The share of the bus that they take as drawn.
    drawn: f64,
}

/// A message at one load.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timing {
    pub(super) period: Duration,
    pub(super) deadline: Duration,
    pub(super) offset: Duration,
}

impl MessageSet {
    /// Draws messages until they fill the bus.
    pub(super) fn draw(shape: &Shape, seed: u64) -> anyhow::Result<Self> {
        let mut random = Random::new(seed);
        let mut messages = Vec::new();
        let mut drawn = 0.0;
        while drawn < 1.0 {
            if messages.len() == MOST {
                bail!(
                    "more than {MOST} messages are needed to fill the bus, and only so many fixed priorities \
                     exist; choose a smaller --longest-period"
                );
            }
            let message = PeriodicMessage::draw(shape, messages.len() as u16, &mut random);
            drawn += message.mean_bits * NANOSECONDS_A_BIT / message.period;
            messages.push(message);
        }
        let mut by_deadline: Vec<usize> = (0..messages.len()).collect();
        by_deadline.sort_by(|a, b| messages[*a].relative().total_cmp(&messages[*b].relative()));
        for (rank, at) in (1..).zip(by_deadline) {
            messages[at].rank = Priority::new(rank);
        }
        Ok(Self { messages, drawn })
    }

    /// The timing of each message when all together take this share of the bus.
    pub(super) fn timings(&self, load: f64) -> Vec<Timing> {
        let stretch = self.drawn / load;
        let timing = |message: &PeriodicMessage| {
            let period = message.period * stretch;
            Timing {
                period: Duration::from_ticks(period as u64),
                deadline: Duration::from_ticks((period * message.deadline) as u64),
                offset: Duration::from_ticks((period * message.offset) as u64),
            }
        };
        self.messages.iter().map(timing).collect()
    }
}

impl PeriodicMessage {
    fn draw(shape: &Shape, number: u16, random: &mut Random) -> Self {
        let (shortest, longest) = (shape.shortest_period.ln(), shape.longest_period.ln());
        let period = (shortest + (longest - shortest) * random.share()).exp() * 1e6;
        let len = match shape.lengths {
            Lengths::Full => Payload::MAX_LEN,
            Lengths::Mixed => 1 + random.below(Payload::MAX_LEN as u64) as usize,
        };
        let deadline = match shape.deadlines {
            Deadlines::Period => 1.0,
            Deadlines::Drawn => 0.5 + random.share() / 2.0,
        };
        let mut message = Self {
            // The shape has at most a hundred nodes, a set at most 249 messages: both fit.
            node: TxNode::new(random.below(shape.nodes.into()) as u8).unwrap_or(TxNode::MIN),
            etag: Etag::new(Etag::BOUND_FIRST.get() + number).unwrap_or(Etag::BOUND_FIRST),
            len,
            period,
            deadline,
            offset: random.share(),
            contents: random.bits(),
            mean_bits: 0.0,
            rank: Priority::SOFT_LEAST_URGENT,
        };
        message.mean_bits = message.mean_bits();
        message
    }

    /// The relative deadline, in nanoseconds, as drawn.
    fn relative(&self) -> f64 {
        self.period * self.deadline
    }

    /// The frame of one release, with contents of its own.
    pub(super) fn frame(&self, release: u64, priority: Priority) -> Frame {
        let contents = Random::new(self.contents ^ release).bits().to_be_bytes();
        let id = Id::new(priority, self.node, self.etag);
        Frame::new(id, Payload::truncated(contents, self.len))
    }

    fn mean_bits(&self) -> f64 {
        let priority = |release: u64| Priority::new(1 + (release % 249) as u8);
        let frames = (0..SAMPLES).map(|release| self.frame(release, priority(release)));
        let bits: u32 = frames.map(bits_of).sum();
        f64::from(bits) / SAMPLES as f64
    }
}

impl Timing {
    /// When a release is to be sent by.
    pub(super) fn deadline_of(&self, released_at: Instant) -> Instant {
        released_at + self.deadline
    }
}

/// The message that has this etag.
pub(super) fn number_of(etag: Etag) -> usize {
    usize::from(etag.get() - Etag::BOUND_FIRST.get())
}

/// The length of a frame on the wire, with the intermission behind it.
pub(super) fn bits_of(frame: Frame) -> u32 {
    WireFrame::from(frame).bit_count() + INTERMISSION_BITS
}

pub(super) const INTERMISSION_BITS: u32 = 3;

/// Fixed priorities that there are.
const MOST: usize = Priority::SOFT_LEAST_URGENT.get() as usize;
const NANOSECONDS_A_BIT: f64 = 1_000.0;
const SAMPLES: u64 = 249;
