//! A segment as its engineer describes it: nodes, event channels, foreign frames, faults.
//!
//! [`Cluster::read`] turns one TOML file into a value that can only be valid, or into everything that
//! is wrong with the file. What the file may say is in [`format`](mod@format); whether a calendar exists for it is
//! not asked here.

mod contents;
mod dbc;
pub mod format;
mod validate;
pub mod values;

use crate::analysis::errors::ErrorModel;
use crate::contents::Layout;
use crate::document::{Problems, Source};
use cosmic_core::admission::Unplanned;
use cosmic_core::calendar::Segment;
use cosmic_core::can::{Etag, Priority, TxNode};
use cosmic_core::protocol::Rank;
use cosmic_core::sync::SyncConfig;
use cosmic_core::time::Duration;
use std::path::PathBuf;

/// The commented example that `cosmic-plan new` writes.
pub const EXAMPLE: &str = include_str!("../../examples/vehicle.toml");

/// A segment with everything on it.
#[derive(Clone, PartialEq, Debug)]
pub struct Cluster {
    /// What the segment is called.
    pub name: String,
    /// Bit rate, clock accuracy and release jitter.
    pub segment: Segment,
    /// The nodes that may host a broker, as positions in [`Cluster::nodes`], if the cluster is sealed.
    pub sealed: Option<Vec<usize>>,
    /// How etags of soft and non real-time channels are found.
    pub binding: Binding,
    /// What becomes of a soft real-time channel that is not here; `None`: it is published, unproven, or the cluster is
    /// sealed.
    pub unplanned: Option<Unplanned>,
    /// Δt_p: the span of deadlines that one priority stands for.
    pub priority_step: Duration,
    /// A node may not manage to load its next frame within the inter-frame space.
    pub slow_refill: bool,
    /// How often the clock master sends sync and follow-up; `None` without a clock service.
    pub sync_period: Option<Duration>,
    /// How late a node takes the time-stamp of a sync frame at worst.
    pub stamp_latency: Duration,
    /// The faults under which soft and non real-time bounds hold.
    pub errors: ErrorModel,
    /// The nodes, in the order of the file.
    pub nodes: Vec<Node>,
    /// The event channels, in the order of the file.
    pub channels: Vec<Channel>,
    /// What stands in the bytes of events, in the order of the file.
    pub contents: Vec<Layout>,
    /// Frames on the bus that are not COSMIC's.
    pub foreign: Vec<Foreign>,
    /// Groups of hard real-time channels that share one fault budget.
    pub pools: Vec<Pool>,
    /// The other files that it was read from.
    pub files: Vec<PathBuf>,
}

/// How the etags of soft and non real-time channels are found.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Binding {
    /// They are fixed here, from [`Etag::BOUND_LAST`] down.
    Static,
    /// The event channel broker hands them out at run time.
    Broker,
}

/// A node.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its 64-bit UID.
    pub uid: u64,
    /// Its short id on this segment. Of a node that [asks](Self::asks) it is what stands for it in the analysis.
    pub tx_node: TxNode,
    /// The broker gives it a short id at run time.
    pub asks: bool,
    /// Its place in the succession of time masters; `None`: it does not become master.
    pub rank: Option<Rank>,
    /// What it publishes: positions in [`Cluster::channels`].
    pub publishes: Vec<usize>,
    /// What it subscribes to: positions in [`Cluster::channels`].
    pub subscribes: Vec<usize>,
}

/// How events follow each other.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Recurrence {
    /// One event in every period.
    Periodic(Duration),
    /// Events at least this far apart.
    Sporadic(Duration),
}

impl Recurrence {
    /// The period, or the least distance of two events.
    pub fn span(self) -> Duration {
        match self {
            Self::Periodic(span) | Self::Sporadic(span) => span,
        }
    }

    /// The same kind of recurrence with another span.
    pub fn with_span(self, span: Duration) -> Self {
        match self {
            Self::Periodic(_) => Self::Periodic(span),
            Self::Sporadic(_) => Self::Sporadic(span),
        }
    }
}

/// An event channel.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Channel {
    /// Its name, for people and for the generated constants.
    pub name: String,
    /// Its subject.
    pub subject: u64,
    /// Its etag; `None` where the broker will find one.
    pub etag: Option<Etag>,
    /// Bytes of an event at most.
    pub length: u16,
    /// What stands in them: a position in [`Cluster::contents`].
    pub content: Option<usize>,
    /// How events follow each other.
    pub recurrence: Recurrence,
    /// Soft and non real-time: how many events may come at once.
    pub burst: u8,
    /// Soft and non real-time: how late an event may be published after its nominal instant. Hard
    /// real-time: how far the spacing of slots may deviate from the period.
    pub jitter: Duration,
    /// Soft and non real-time: the jitter that the publisher's node allows. It is [`jitter`](Self::jitter); or, if the
    /// file gives none, a tenth of the recurrence, 1 ms at most, so that a task that is a little late is not refused.
    pub allowed_jitter: Duration,
    /// Periodic hard real-time: delivery at the latest, from the start of each period. Others: from publication.
    pub deadline: Option<Duration>,
    /// After this span an event is worthless and is discarded.
    pub validity: Option<Duration>,
    /// The class with what only it has.
    pub class: PlannedClass,
}

impl Channel {
    /// Soft and non real-time: how far events may come before their nominal instants, at worst: jitter, and what a burst
    /// takes. Both are one to an analysis: in any span t there are at most ⌈(t + this) / span of recurrence⌉ events.
    pub fn tolerance(&self) -> Duration {
        let further = u64::from(self.burst.saturating_sub(1));
        Duration::from_ticks(self.jitter.as_ticks() + further * self.recurrence.span().as_ticks())
    }
}

/// The class of a channel.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum PlannedClass {
    /// Delivered at its deadline, under up to `omission_degree` faults.
    Hard {
        /// How many omissions a slot tolerates.
        omission_degree: u8,
        /// Where the slot should be.
        wishes: Wishes,
    },
    /// Earliest deadline first.
    Soft,
    /// When the bus is free.
    NonRealTime {
        /// 0 (most important) to [`PlannedClass::LEAST_IMPORTANT`].
        importance: u8,
    },
}

impl PlannedClass {
    /// The least importance: the priorities behind configuration's are 251..=255.
    pub const LEAST_IMPORTANT: u8 = Priority::LEAST.get() - Priority::CONFIGURATION.get() - 1;

    /// The priority of non real-time frames of this importance.
    pub fn priority_of(importance: u8) -> Priority {
        Priority::new(Priority::CONFIGURATION.get() + 1 + importance.min(Self::LEAST_IMPORTANT))
    }

    /// The abbreviation that the papers use, without "EC".
    pub fn abbreviation(&self) -> &'static str {
        match self {
            Self::Hard { .. } => "HRT",
            Self::Soft => "SRT",
            Self::NonRealTime { .. } => "NRT",
        }
    }
}

/// Where a slot should be.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub struct Wishes {
    /// Exactly this ready instant, from the start of each period.
    pub phase: Option<Duration>,
    /// Ready not before this instant of each period.
    pub earliest: Option<Duration>,
    /// Behind another channel's slot.
    pub after: Option<After>,
}

/// "This after that, at most so much later."
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct After {
    /// Position of the channel that comes first.
    pub channel: usize,
    /// From its delivery to this channel's ready instant at most.
    pub within: Duration,
}

/// A frame on the bus that is not COSMIC's.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Foreign {
    /// Its name.
    pub name: String,
    /// Its identifier.
    pub id: u32,
    /// Whether it has an identifier of 29 bits.
    pub extended: bool,
    /// Bytes of data.
    pub length: u8,
    /// Its period or least distance.
    pub period: Duration,
    /// How late it may be queued.
    pub jitter: Duration,
    /// By when it should be sent, if anybody cares.
    pub deadline: Option<Duration>,
}

/// Slots that share one fault budget.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Pool {
    /// Positions of the channels.
    pub channels: Vec<usize>,
    /// How many faults all their slots together tolerate.
    pub faults: u8,
}

impl Cluster {
    /// Reads the description of a segment.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn read(source: &Source) -> Result<Self, Problems> {
        validate::read(source)
    }

    /// The settings of the clock synchronisation that all nodes share: without rank and calendar. `None` without a
    /// clock service.
    pub fn sync(&self) -> Option<SyncConfig> {
        let period = self.sync_period?;
        let stamp_error = SyncConfig::stamp_error_for(self.segment.bit_rate, self.stamp_latency);
        Some(SyncConfig { period, stamp_error, ..SyncConfig::DEFAULT })
    }

    /// By when a slot of a hard real-time channel must have delivered, from the start of each period: `None` for
    /// sporadic ones, whose events keep no period.
    pub fn delivery_deadline(&self, channel: usize) -> Option<Duration> {
        let channel = &self.channels[channel];
        match channel.recurrence {
            Recurrence::Periodic(period) => Some(channel.deadline.unwrap_or(period)),
            Recurrence::Sporadic(_) => None,
        }
    }

    /// What stands in the events of a channel; `None` if the file does not say.
    pub fn layout_of(&self, channel: &Channel) -> Option<&Layout> {
        self.contents.get(channel.content?)
    }

    /// The nodes that publish a channel.
    pub fn publishers(&self, channel: usize) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(move |node| node.publishes.contains(&channel))
    }

    /// The nodes that subscribe to a channel.
    pub fn subscribers(&self, channel: usize) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(move |node| node.subscribes.contains(&channel))
    }

    /// The position of the channel of this name.
    pub fn channel_named(&self, name: &str) -> Option<usize> {
        self.channels.iter().position(|channel| channel.name == name)
    }

    /// The same cluster with another period of this channel, and of those that share its pool.
    #[must_use]
    pub fn with_period(&self, channel: usize, span: Duration) -> Self {
        let mut changed = self.clone();
        let members = self.pool_of(channel).map_or(vec![channel], |pool| self.pools[pool].channels.clone());
        for member in members {
            changed.channels[member].recurrence = changed.channels[member].recurrence.with_span(span);
        }
        changed
    }

    /// How many faults a hard real-time channel's slots tolerate: each by itself, or with their pool.
    pub fn omission_degree(&self, channel: usize) -> Option<u8> {
        match (&self.channels[channel].class, self.pool_of(channel)) {
            (PlannedClass::Hard { .. }, Some(pool)) => Some(self.pools[pool].faults),
            (PlannedClass::Hard { omission_degree, .. }, None) => Some(*omission_degree),
            _ => None,
        }
    }

    /// The same cluster with another omission degree of this channel, or of its pool.
    #[must_use]
    pub fn with_omission_degree(&self, channel: usize, degree: u8) -> Self {
        let mut changed = self.clone();
        if let Some(pool) = self.pool_of(channel) {
            changed.pools[pool].faults = degree;
        } else if let PlannedClass::Hard { omission_degree, .. } = &mut changed.channels[channel].class {
            *omission_degree = degree;
        }
        changed
    }

    /// The pool that a channel's slots belong to.
    pub fn pool_of(&self, channel: usize) -> Option<usize> {
        self.pools.iter().position(|pool| pool.channels.contains(&channel))
    }
}
