//! The monitor: hands each frame to the parts that it concerns, and tells what they noticed.

use cosmic_bus::{TrafficClass, WireFrame};
use cosmic_core::Subject;
use cosmic_core::can::{BitRate, ErrorCounters, Etag, Frame, Priority, TxNode};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::protocol::names_its_sender;
use cosmic_core::time::{Duration, Instant};
use cosmic_plan::cluster::PlannedClass;

use crate::brokers::Brokers;
use crate::channels::Channels;
use crate::clock::ListenerClock;
use crate::decode::{self, Decoded, DecodedField, Meaning};
use crate::digits::hexadecimal;
use crate::feed::{Feed, News, Notice, NoticeKind};
use crate::load::Load;
use crate::messages::{Messages, Whole};
use crate::nodes::Nodes;
use crate::plan::SegmentPlan;
use crate::slots::{Slots, Standing};
use crate::snapshot::Snapshot;
use crate::suspects::Suspects;

/// What a listener knows of a segment. See the [crate](crate) for the calling order and the bounds.
#[derive(Clone, Debug)]
pub struct Monitor {
    pub(crate) plan: Option<SegmentPlan>,
    pub(crate) bit_rate: BitRate,
    pub(crate) started: Instant,
    /// The latest instant at which something happened on the link.
    heard_at: Instant,
    /// The latest instant that was told, by the link or by whoever looks.
    pub(crate) now: Instant,
    swept_at: Instant,
    pub(crate) link: LinkSeen,
    pub(crate) nodes: Nodes,
    pub(crate) channels: Channels,
    pub(crate) brokers: Brokers,
    pub(crate) clock: ListenerClock,
    pub(crate) slots: Slots,
    pub(crate) load: Load,
    pub(crate) suspects: Suspects,
    pub(crate) messages: Messages,
    pub(crate) feed: Feed,
    /// When the nodes were asked who they are.
    pub(crate) probed_at: Option<Instant>,
}

/// What the link told of itself.
#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct LinkSeen {
    pub(crate) received: u64,
    pub(crate) foreign: u64,
    pub(crate) lost: u64,
    pub(crate) last_at: Option<Instant>,
    pub(crate) errors: Option<ErrorCounters>,
    pub(crate) bus_off: u32,
    pub(crate) bus_off_at: Option<Instant>,
}

impl Monitor {
    /// Listens to a segment of which only the bit rate is known.
    pub fn new(bit_rate: BitRate, now: Instant) -> Self {
        Self::build(bit_rate, None, now)
    }

    /// Listens to a segment whose plan is known.
    pub fn with_plan(plan: SegmentPlan, now: Instant) -> Self {
        Self::build(plan.bit_rate(), Some(plan), now)
    }

    fn build(bit_rate: BitRate, plan: Option<SegmentPlan>, now: Instant) -> Self {
        Self {
            slots: Slots::new(plan.as_ref()),
            plan,
            bit_rate,
            started: now,
            heard_at: now,
            now,
            swept_at: now,
            link: LinkSeen::default(),
            nodes: Nodes::new(),
            channels: Channels::new(),
            brokers: Brokers::new(),
            clock: ListenerClock::new(),
            load: Load::new(now),
            suspects: Suspects::default(),
            messages: Messages::new(),
            feed: Feed::default(),
            probed_at: None,
        }
    }

    /// The plan, if there is one.
    pub fn plan(&self) -> Option<&SegmentPlan> {
        self.plan.as_ref()
    }

    /// The bit rate of the segment.
    pub fn bit_rate(&self) -> BitRate {
        self.bit_rate
    }

    /// A frame has arrived.
    pub fn on_frame(&mut self, frame: &Frame, at: Instant) {
        let at = self.advance(at);
        self.link.received += 1;
        self.link.last_at = Some(at);
        self.messages.forget_whole();
        let bits = bits_of(&WireFrame::from(*frame));
        self.load.add(decode::class_of(frame).0, bits, at, self.bit_rate);
        if names_its_sender(frame.id) {
            self.hear(frame.id.tx_node(), at);
        }
        if frame.id.priority() == Priority::HARD {
            self.on_hard(frame, at);
        }
        if frame.id.etag().is_reserved() {
            self.on_control(frame, at);
        } else {
            self.on_event(frame, bits, at);
        }
    }

    /// A frame has arrived that COSMIC does not use: with a standard identifier, or a remote frame. `None` if the link
    /// does not say what it was; then it counts as a frame, and not in the load.
    pub fn on_foreign(&mut self, frame: Option<&WireFrame>, at: Instant) {
        let at = self.advance(at);
        self.link.foreign += 1;
        self.link.last_at = Some(at);
        if let Some(frame) = frame {
            self.load.add(TrafficClass::Foreign, bits_of(frame), at, self.bit_rate);
        }
    }

    /// So many frames were lost before they arrived here.
    pub fn on_lost(&mut self, frames: u32, at: Instant) {
        let at = self.advance(at);
        self.link.lost += u64::from(frames);
        let news = News::new(
            NoticeKind::Lost,
            "frames were lost on the way to this listener: it is too slow, or its link",
        );
        self.feed.add(news.times(frames.into()), at);
    }

    /// The error counters of the link's controller.
    pub fn on_errors(&mut self, errors: ErrorCounters, at: Instant) {
        self.advance(at);
        self.link.errors = Some(errors);
    }

    /// The link's controller has left the bus.
    pub fn on_bus_off(&mut self, at: Instant) {
        let at = self.advance(at);
        self.link.bus_off = self.link.bus_off.saturating_add(1);
        self.link.bus_off_at = Some(at);
        let news = News::new(NoticeKind::BusOff, "the controller of this link has left the bus");
        self.feed.add(news.because([ExceptionKind::BusOff]), at);
    }

    /// All that is known at `now`.
    pub fn snapshot(&mut self, now: Instant) -> Snapshot {
        let now = self.refresh(now);
        self.view(now)
    }

    /// Time has come so far: forgets what is too old.
    pub(crate) fn refresh(&mut self, now: Instant) -> Instant {
        self.now = self.now.max(now);
        self.sweep(self.now);
        self.now
    }

    /// The notices with a [sequence number](Notice::sequence) above this, oldest first.
    pub fn notices(&self, after: u64) -> impl Iterator<Item = &Notice> {
        self.feed.after(after)
    }

    /// The frame in words, with the names that are known now. It is not taken into account. A frame of a message is shown as
    /// its bytes; see [`Monitor::decode_whole`].
    pub fn decode(&self, frame: &Frame) -> Decoded {
        self.decode_as(frame, None)
    }

    /// The frame that was handed in last, in words, as its subscribers see it: the last frame of a message is the whole
    /// message, the others are nothing. Which channels carry messages, only the plan says.
    pub fn decode_whole(&self, frame: &Frame) -> Option<Decoded> {
        if frame.id.etag().is_reserved() || !self.carries_messages(self.planned_channel(frame.id.etag())) {
            return Some(self.decode(frame));
        }
        Some(self.decode_as(frame, Some(self.messages.whole()?)))
    }

    /// The bytes that the subscribers of an event see, of the frame that was handed in last: as
    /// [`decode_whole`](Self::decode_whole).
    pub fn content_whole(&self, frame: &Frame) -> Option<Vec<u8>> {
        if frame.id.etag().is_reserved() || !self.carries_messages(self.planned_channel(frame.id.etag())) {
            return Some(frame.payload.as_slice().to_vec());
        }
        Some(self.messages.whole()?.content.clone())
    }

    /// Returns whether the plan has messages of several frames on this channel of it.
    pub(crate) fn carries_messages(&self, channel: Option<usize>) -> bool {
        self.plan.as_ref().zip(channel).is_some_and(|(plan, channel)| plan.carries_messages(channel))
    }

    /// `message`: the one that this frame has completed.
    fn decode_as(&self, frame: &Frame, message: Option<&Whole>) -> Decoded {
        let (etag, tx_node) = (frame.id.etag(), frame.id.tx_node());
        let meaning = decode::control(frame);
        let subject = meaning.is_none().then(|| self.subject_of(etag)).flatten();
        let channel = meaning.is_none().then(|| self.planned_channel(etag)).flatten();
        let data = message.map_or_else(|| frame.payload.to_string(), Whole::data);
        let content = message.map_or(frame.payload.as_slice(), |message| &message.content);
        // What stands in a part of a message, only the whole says.
        let described = channel.filter(|_| message.is_some() || !self.carries_messages(channel));
        Decoded {
            id: frame.id.to_string(),
            class: decode::class_of(frame).1,
            priority: frame.id.priority().get(),
            tx_node: tx_node.get(),
            node: names_its_sender(frame.id).then(|| self.name_of(tx_node)).flatten(),
            etag: etag.get(),
            channel: channel.zip(self.plan.as_ref()).map(|(at, plan)| plan.channel(at).name.clone()),
            subject: subject.map(|subject| subject.to_string()),
            data,
            meaning: meaning.unwrap_or_else(|| {
                let (fields, malformed) = self.content(described, content);
                Meaning::Event { fields, malformed }
            }),
        }
    }

    /// Which subject has which etag, as far as a binding was heard.
    pub fn bindings(&self) -> impl Iterator<Item = (Subject, Etag)> + '_ {
        self.channels.iter().filter_map(|(etag, channel)| Some((channel.subject?, etag)))
    }

    /// Takes a binding as heard: another listener has heard it, or this one at another time.
    pub fn learn(&mut self, subject: Subject, etag: Etag) {
        self.channels.bind(subject, etag, self.now);
    }

    /// The fields of an event of a planned channel, or why it is none.
    pub(crate) fn content(
        &self,
        channel: Option<usize>,
        bytes: &[u8],
    ) -> (Vec<DecodedField>, Option<String>) {
        let decoded = channel.zip(self.plan.as_ref()).map(|(at, plan)| plan.decode(at, bytes));
        match decoded {
            Some(Ok(fields)) => (fields, None),
            Some(Err(why)) => (Vec::new(), Some(why.to_string())),
            None => (Vec::new(), None),
        }
    }

    /// The name of a node in the plan.
    pub fn name_of(&self, tx_node: TxNode) -> Option<String> {
        self.plan.as_ref()?.node(tx_node).map(|node| node.name.clone())
    }

    /// The etag of a channel by its name in the plan, its subject, or its etag itself, as a person writes them: `brake`,
    /// `C05A1C0000000003`, `0xC05A1C0000000003`, `16383`.
    pub fn etag_called(&self, name: &str) -> Option<Etag> {
        let by_name = || {
            let plan = self.plan.as_ref()?;
            let channel = plan.channel(plan.channel_named(name)?);
            channel.etag.or_else(|| self.channels.etag_of(Subject::new(channel.subject)?))
        };
        let by_subject = || {
            let is_long = name.strip_prefix("0x").unwrap_or(name).len() > 5;
            let subject = Subject::new(hexadecimal(name).filter(|_| is_long)?)?;
            let planned =
                self.plan.as_ref().and_then(|plan| plan.channel(plan.channel_of_subject(subject)?).etag);
            planned.or_else(|| self.channels.etag_of(subject))
        };
        by_name().or_else(by_subject).or_else(|| Etag::new(name.parse().ok()?))
    }

    /// The position of a channel in the plan: by its etag there, or by the subject that was bound to it.
    pub(crate) fn planned_channel(&self, etag: Etag) -> Option<usize> {
        let plan = self.plan.as_ref()?;
        let bound = || plan.channel_of_subject(self.channels.get(etag)?.subject?);
        plan.channel_of_etag(etag).or_else(bound)
    }

    /// The subject of a channel, by a binding or by the plan.
    pub(crate) fn subject_of(&self, etag: Etag) -> Option<Subject> {
        let bound = self.channels.get(etag).and_then(|channel| channel.subject);
        let planned = || Subject::new(self.plan.as_ref()?.channel(self.planned_channel(etag)?).subject);
        bound.or_else(planned)
    }

    /// Takes note of the time at which something happened on the link; an instant before the latest counts as that. Returns
    /// which one counts. That somebody has looked meanwhile makes nothing later than it was: what the link still holds was
    /// stamped before.
    fn advance(&mut self, at: Instant) -> Instant {
        self.heard_at = self.heard_at.max(at);
        self.now = self.now.max(self.heard_at);
        if self.now.saturating_since(self.swept_at) >= SWEEP {
            self.sweep(self.now);
        }
        self.heard_at
    }

    /// What only time brings: silence, ended leases, slots that passed.
    fn sweep(&mut self, now: Instant) {
        self.swept_at = now;
        self.load.advance(now, self.bit_rate);
        for tx_node in self.nodes.advance(now) {
            self.channels.forget_node(tx_node);
            let news = News::new(NoticeKind::NodeSilent, "the node has not been heard for too long");
            self.feed.add(news.of(tx_node), now);
        }
        self.channels.advance(now);
        // Frames of slots that have passed may be on their way here, but not for ever.
        let is_silent = now.saturating_since(self.heard_at) >= SILENCE;
        self.pass_slots(if is_silent { now } else { self.heard_at });
    }

    /// Slots whose windows have passed without a frame are missed. Linear in the slots.
    pub(crate) fn pass_slots(&mut self, now: Instant) {
        let Some(global) = self.clock.global(now) else { return };
        let tolerance = self.slot_tolerance();
        for (etag, tx_node, missed) in self.slots.advance(global, tolerance) {
            self.on_missed_slots(etag, tx_node, missed, now);
        }
    }

    fn on_missed_slots(&mut self, etag: Etag, tx_node: TxNode, missed: u64, at: Instant) {
        let here = [
            ExceptionKind::NothingPublished,
            ExceptionKind::OmissionDegreeExceeded,
            ExceptionKind::SlotSkipped,
        ];
        here.into_iter().for_each(|kind| self.explain(tx_node, kind));
        let mut subscribers: Vec<TxNode> = self.channels.get(etag).map_or_else(Vec::new, |channel| {
            channel.subscribers.iter().map(|subscriber| subscriber.tx_node).collect()
        });
        if let Some((plan, channel)) = self.plan.as_ref().zip(self.planned_channel(etag)) {
            subscribers.extend(plan.cluster().subscribers(channel).map(|node| node.tx_node));
        }
        subscribers.into_iter().for_each(|node| self.explain(node, ExceptionKind::MissedEvent));
        let text = "slots of a periodic channel passed without a frame";
        let news = News::new(NoticeKind::MissedSlot, text).of(tx_node).on(etag).times(missed);
        self.feed.add(news.because([ExceptionKind::MissedEvent]), at);
    }

    /// How far from its window a frame may seem to be by the clocks of its publisher and of this listener.
    fn slot_tolerance(&self) -> Duration {
        let scatter = self.clock.uncertainty().unwrap_or(Duration::from_ticks(0));
        let planned = self.plan.as_ref().map_or(Duration::from_ticks(0), |plan| plan.cluster().segment.gap());
        Duration::from_ticks(scatter.as_ticks().saturating_mul(2).saturating_add(planned.as_ticks()))
    }

    fn hear(&mut self, tx_node: TxNode, at: Instant) {
        if self.nodes.hear(tx_node, at) {
            self.feed.add(
                News::new(NoticeKind::NodeAppeared, "a node was heard that was not there").of(tx_node),
                at,
            );
        }
    }

    pub(crate) fn explain(&mut self, tx_node: TxNode, kind: ExceptionKind) {
        if let Some(node) = self.nodes.get_mut(tx_node) {
            node.evidence.add(kind);
        }
    }

    fn on_hard(&mut self, frame: &Frame, at: Instant) {
        let (etag, tx_node) = (frame.id.etag(), frame.id.tx_node());
        let tolerance = self.slot_tolerance();
        let standing = match &self.plan {
            Some(_) => self.slots.on_frame(frame.id, self.clock.global(at), tolerance),
            // Without a plan only what no calendar can hold is known to be wrong.
            None if etag.is_hard() => Standing::Unknown,
            None => Standing::Unplanned,
        };
        let text = match standing {
            Standing::Inside | Standing::Unknown => return,
            Standing::Unplanned => "a frame of priority 0 that no slot of the calendar is for",
            Standing::Outside => "a hard real-time frame outside of its window",
        };
        self.suspects.hard(etag, tx_node, standing, at);
        self.feed.add(News::new(NoticeKind::OutsideSlot, text).of(tx_node).on(etag), at);
    }

    fn on_event(&mut self, frame: &Frame, bits: u32, at: Instant) {
        let (etag, tx_node) = (frame.id.etag(), frame.id.tx_node());
        self.channels.on_event(frame, at);
        let channel = self.planned_channel(etag);
        if self.carries_messages(channel)
            && let Some(whole) = self.messages.on_frame(frame, at)
        {
            self.channels.on_message(whole, at);
        }
        let stranger = match (&self.plan, channel) {
            (Some(plan), Some(channel)) => !plan.publishes(tx_node, channel),
            // Channels that the broker binds may be of nobody's plan.
            (Some(plan), None) => plan.cluster().binding == cosmic_plan::cluster::Binding::Static,
            (None, _) => false,
        };
        if stranger {
            self.suspects.publisher(etag, tx_node, at);
        }
        let priority = frame.id.priority();
        let soft = priority != Priority::HARD && priority <= Priority::SOFT_LEAST_URGENT;
        let is_soft =
            |(plan, channel): (&SegmentPlan, usize)| plan.channel(channel).class == PlannedClass::Soft;
        if !soft || !self.plan.as_ref().zip(channel).is_none_or(is_soft) {
            return;
        }
        if priority == Priority::SOFT_MOST_URGENT {
            self.explain(tx_node, ExceptionKind::MissedDeadline);
        }
        let plan = self.plan.as_ref();
        let step = plan.map_or(self.bit_rate.longest_frame(8), |plan| plan.cluster().priority_step);
        let deadline = plan.zip(channel).and_then(|(plan, channel)| plan.soft_deadline(channel));
        if let Some(seen) = self.channels.of(etag, at) {
            seen.latency.add(priority, step, self.bit_rate.bits(bits), deadline);
        }
    }
}

/// With the space behind the frame.
fn bits_of(frame: &WireFrame) -> u32 {
    frame.bit_count() + INTERMISSION
}

const INTERMISSION: u32 = 3;
/// No link holds a frame back for so long.
const SILENCE: Duration = Duration::from_secs(1);
/// How often silence and the like are looked for.
const SWEEP: Duration = Duration::from_secs(1);
