//! The plan of the cluster, as a listener uses it: names, deadlines, slots.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use cosmic_core::calendar::Calendar;
use cosmic_core::can::{BitRate, Etag, Payload, TxNode};
use cosmic_core::event_layer::{
    self as declared, Bytes, HardAttributes, Importance, MessageChannel, NonRealTimeAttributes,
    SoftAttributes,
};
use cosmic_core::network::fragments::{MAX_MESSAGE_LEN, frames_of};
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_plan::analysis::segment::assess;
use cosmic_plan::cluster::{Channel, Cluster, Node, PlannedClass, Recurrence};
use cosmic_plan::contents::NotDecoded;
use cosmic_plan::document::Source;
use cosmic_plan::plan::{Effort, Plan, PlannedSlot, plan};

use crate::decode::DecodedField;

/// The description of a cluster with the calendar that was planned for it.
#[derive(Clone, Debug)]
pub struct SegmentPlan {
    cluster: Cluster,
    plan: Plan,
    calendar: Calendar,
    by_etag: HashMap<Etag, usize>,
    by_subject: HashMap<Subject, usize>,
    by_node: HashMap<TxNode, usize>,
    by_name: HashMap<String, usize>,
}

/// A channel of messages whose content is taken as bytes, whatever the plan says of it.
pub type ByteMessages = MessageChannel<Bytes<MAX_MESSAGE_LEN>, MAX_MESSAGE_LEN, 1>;

/// Why there is no plan: all that is wrong, with file, line and remedy.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PlanRefused(String);

impl fmt::Display for PlanRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for PlanRefused {}

impl SegmentPlan {
    /// Reads the description of a cluster and plans it, as the build of its programs does.
    ///
    /// # Errors
    /// The file cannot be read, or is wrong, or there is no calendar for it.
    pub fn read(file: impl AsRef<Path>) -> Result<Self, PlanRefused> {
        let file = file.as_ref();
        let text = std::fs::read_to_string(file).map_err(|error| {
            PlanRefused(format!(
                "{} cannot be read: {error}; give the path of a cluster file",
                file.display()
            ))
        })?;
        Self::parse(&Source::new(file.display().to_string(), text))
    }

    /// As [`read`](Self::read), of a text.
    ///
    /// # Errors
    /// As there.
    pub fn parse(source: &Source) -> Result<Self, PlanRefused> {
        let cluster = Cluster::read(source)
            .map_err(|problems| PlanRefused(problems.to_string().trim_end().to_owned()))?;
        let refused = |what: &str| {
            let name = source.name();
            PlanRefused(format!("{name}: {what}; `cosmic-plan check {name}` says why, and what would help"))
        };
        let plan = plan(&cluster, &Effort::default())
            .map_err(|_| refused("no calendar was found for this cluster"))?;
        let calendar = plan.calendar().map_err(|_| refused("its calendar is none"))?;
        let calendar = calendar.with_priority_step(cluster.priority_step);
        Ok(Self::new(cluster, plan, calendar))
    }

    fn new(cluster: Cluster, plan: Plan, calendar: Calendar) -> Self {
        let channels = || cluster.channels.iter().enumerate();
        Self {
            by_etag: channels().filter_map(|(at, channel)| Some((channel.etag?, at))).collect(),
            by_subject: channels()
                .filter_map(|(at, channel)| Some((Subject::new(channel.subject)?, at)))
                .collect(),
            by_node: cluster.nodes.iter().enumerate().map(|(at, node)| (node.tx_node, at)).collect(),
            by_name: channels().map(|(at, channel)| (channel.name.clone(), at)).collect(),
            cluster,
            plan,
            calendar,
        }
    }

    /// The description.
    pub fn cluster(&self) -> &Cluster {
        &self.cluster
    }

    /// The bit rate of the segment.
    pub fn bit_rate(&self) -> BitRate {
        self.cluster.segment.bit_rate
    }

    /// The share of time that the plan leaves to others, 0 to 1: behind the windows of the calendar, and all other frames
    /// of the description.
    pub fn free_share(&self) -> f64 {
        let shares = assess(&self.cluster, &self.plan).utilisation;
        let taken = shares.reserved + shares.soft + shares.non_real_time + shares.sync + shares.foreign;
        (1.0 - taken).clamp(0.0, 1.0)
    }

    /// The digest of the calendar, as sync frames carry it.
    pub fn digest(&self) -> u32 {
        self.calendar.digest()
    }

    /// The calendar, as nodes have it.
    pub fn calendar(&self) -> Calendar {
        self.calendar
    }

    /// The slots of the calendar, by phase.
    pub fn slots(&self) -> &[PlannedSlot] {
        self.plan.slots()
    }

    /// After this span the calendar repeats.
    pub fn cycle(&self) -> Duration {
        self.plan.cycle()
    }

    /// A channel by its position in the description.
    pub fn channel(&self, at: usize) -> &Channel {
        &self.cluster.channels[at]
    }

    /// The position of the channel with this etag, if the description fixes it.
    pub fn channel_of_etag(&self, etag: Etag) -> Option<usize> {
        self.by_etag.get(&etag).copied()
    }

    /// The position of the channel with this subject.
    pub fn channel_of_subject(&self, subject: Subject) -> Option<usize> {
        self.by_subject.get(&subject).copied()
    }

    /// The position of the channel of this name.
    pub fn channel_named(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }

    /// The node with this TxNode.
    pub fn node(&self, tx_node: TxNode) -> Option<&Node> {
        self.by_node.get(&tx_node).map(|at| &self.cluster.nodes[*at])
    }

    /// The UID of the node with this TxNode.
    pub fn uid_of(&self, tx_node: TxNode) -> Option<NodeUid> {
        NodeUid::new(self.node(tx_node)?.uid)
    }

    /// Returns whether the description names this node as a publisher of the channel.
    pub fn publishes(&self, tx_node: TxNode, channel: usize) -> bool {
        self.node(tx_node).is_some_and(|node| node.publishes.contains(&channel))
    }

    /// Events a second of this channel at most, of all its publishers. A message of several frames counts as often as
    /// it has frames.
    pub fn most_frames_per_second(&self, channel: usize) -> f64 {
        let Channel { recurrence, length, .. } = &self.cluster.channels[channel];
        let publishers = self.cluster.publishers(channel).count().max(1) as f64;
        let frames = match length {
            0..=8 => 1,
            longer => frames_of(usize::from(*longer)),
        };
        publishers * frames as f64 * 1e9 / recurrence.span().as_ticks().max(1) as f64
    }

    /// Returns whether the channel carries messages of several frames, not events.
    pub fn carries_messages(&self, channel: usize) -> bool {
        usize::from(self.channel(channel).length) > Payload::MAX_LEN
    }

    /// The fields of an event or a whole message of this channel: none if the description does not say what stands in it.
    ///
    /// # Errors
    /// The bytes are no content of the channel.
    pub fn decode(&self, channel: usize, bytes: &[u8]) -> Result<Vec<DecodedField>, NotDecoded> {
        let layout = self.cluster.layout_of(self.channel(channel));
        let Some(layout) = layout else { return Ok(Vec::new()) };
        Ok(layout.decode(bytes)?.into_iter().map(DecodedField::from).collect())
    }

    /// The channel as a program declares it that takes its content as bytes. `None` if the description contradicts the
    /// protocol, which one that was read does not.
    pub fn declare(&self, at: usize) -> Option<declared::Channel<Payload>> {
        let planned = self.channel(at);
        let subject = Subject::new(planned.subject)?;
        let channel = match planned.class {
            PlannedClass::Hard { .. } => {
                let attributes = HardAttributes {
                    period: planned.recurrence.span(),
                    periodic: matches!(planned.recurrence, Recurrence::Periodic(_)),
                    omission_degree: self.cluster.omission_degree(at)?,
                };
                let etag = planned.etag.filter(|etag| etag.is_hard())?;
                return Some(declared::Channel::hard(subject, etag, attributes));
            }
            PlannedClass::Soft => {
                let deadline = planned.deadline.unwrap_or(planned.recurrence.span());
                let deadline = deadline.max(Duration::from_ticks(1));
                let validity = planned.validity.unwrap_or(deadline).max(deadline);
                declared::Channel::soft(subject, SoftAttributes { deadline, validity })
            }
            PlannedClass::NonRealTime { importance } => {
                let importance = Importance::new(importance)?;
                let attributes = NonRealTimeAttributes { importance, validity: planned.validity };
                declared::Channel::non_real_time(subject, attributes)
            }
        };
        let etag = planned.etag.filter(|etag| !etag.is_hard() && !etag.is_reserved());
        Some(etag.map_or(channel, |etag| channel.with_etag(etag)))
    }

    /// The channel of messages as a program declares it that takes their content as bytes. `None` if the channel carries
    /// events, or is not non real-time.
    pub fn declare_messages(&self, at: usize) -> Option<ByteMessages> {
        let planned = self.channel(at);
        let PlannedClass::NonRealTime { importance } = planned.class else { return None };
        if !self.carries_messages(at) {
            return None;
        }
        let importance = Importance::new(importance)?;
        let attributes = NonRealTimeAttributes { importance, validity: planned.validity };
        let channel = ByteMessages::new(Subject::new(planned.subject)?, attributes);
        let etag = planned.etag.filter(|etag| !etag.is_hard() && !etag.is_reserved());
        Some(etag.map_or(channel, |etag| channel.with_etag(etag)))
    }

    /// The deadline of a soft real-time event from its publication.
    pub(crate) fn soft_deadline(&self, channel: usize) -> Option<Duration> {
        let channel = self.channel(channel);
        channel.deadline.filter(|_| channel.class == PlannedClass::Soft)
    }
}
