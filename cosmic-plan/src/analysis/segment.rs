//! Everything on a segment: does each channel keep what it promises?
//!
//! | class | bound | why |
//! |---|---|---|
//! | HRT, periodic | from the start of each period to delivery | `hard` |
//! | HRT, sporadic | from publication to delivery | `hard` |
//! | SRT | from publication until sent | [`soft`](super::soft) |
//! | NRT | from publication until the last frame has been sent | below |
//! | foreign | from its nominal instant until sent | the sufficient test of [`fixed`](super::fixed) |
//!
//! An NRT event of n frames is sent frame by frame, each loaded within the inter-frame space behind the one
//! before. So its last frame is one of fixed priority that has n - 1 frames more in front, for which the
//! sufficient test holds; where nodes refill slowly, a frame of lower priority may slip in behind each. The
//! bound holds if the event has gone before the next comes. Configuration and binding send frames only
//! while nodes join; their longest frame is counted as blocking.

use super::bus::{Bus, Stream};
use super::calendar_load::CalendarLoad;
use super::fixed::Level;
use super::frame::{arbitration_key, longest_frame_bits};
use super::proof::{ChannelProof, Origin, Proof, Term, Verdict};
use super::soft::{Rule, SoftBound, SoftBus, SoftStream};
use crate::cluster::{Cluster, Foreign, PlannedClass};
use crate::plan::found::Plan;
use cosmic_core::can::{ERROR_RECOVERY_BITS, LONGEST_FRAME_BITS, Priority};
use cosmic_core::network::fragments;
use cosmic_core::time::Duration;

/// Shares of time.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Utilisation {
    /// The windows of the calendar.
    pub reserved: f64,
    /// Hard real-time frames, without faults.
    pub hard: f64,
    /// Soft real-time frames.
    pub soft: f64,
    /// Non real-time frames.
    pub non_real_time: f64,
    /// Sync frames.
    pub sync: f64,
    /// Foreign frames.
    pub foreign: f64,
}

impl Utilisation {
    /// All frames together, without faults.
    pub fn total(&self) -> f64 {
        self.hard + self.soft + self.non_real_time + self.sync + self.foreign
    }
}

/// Everything that is proven of a segment.
#[derive(Clone, PartialEq, Debug)]
pub struct Assessment {
    /// One for each channel and publisher, in the order of the file.
    pub channels: Vec<ChannelProof>,
    /// One for each foreign frame, in the order of the file.
    pub foreign: Vec<Proof>,
    /// Who takes how much.
    pub utilisation: Utilisation,
}

impl Assessment {
    /// Returns whether every promise holds.
    pub fn holds(&self) -> bool {
        let channels = self.channels.iter().map(|channel| &channel.proof);
        channels.chain(&self.foreign).all(|proof| proof.verdict.holds())
    }
}

/// Analyses a segment beside its calendar.
pub fn assess(cluster: &Cluster, plan: &Plan) -> Assessment {
    let traffic = Traffic::of(cluster, plan);
    let mut channels = traffic.soft_proofs(cluster);
    channels.extend(super::hard::proofs(cluster, plan));
    channels.extend(traffic.non_real_time_proofs(cluster));
    channels.sort_by_key(|channel| (channel.channel, channel.node));
    Assessment {
        channels,
        foreign: cluster
            .foreign
            .iter()
            .enumerate()
            .map(|(at, _)| traffic.foreign_proof(cluster, at))
            .collect(),
        utilisation: traffic.utilisation(plan),
    }
}

/// What is on the bus, as streams.
pub(super) struct Traffic {
    pub(super) bus: Bus,
    sync: Vec<Stream>,
    pub(super) soft: Vec<(usize, usize, SoftStream)>,
    non_real_time: Vec<(usize, usize, Priority, u64, Stream)>,
    foreign: Vec<(u8, u32, Stream)>,
    longest: u64,
    priority_step: u64,
    reload: u64,
    slow_refill: bool,
}

impl Traffic {
    pub(super) fn of(cluster: &Cluster, plan: &Plan) -> Self {
        let rate = cluster.segment.bit_rate;
        let bit = rate.bit_time().as_ticks();
        let ours = |len: u16| longest_frame_bits(true, u8::try_from(len.min(8)).unwrap_or(8)) * bit;
        let mut soft = Vec::new();
        let mut non_real_time = Vec::new();
        for (at, channel) in cluster.channels.iter().enumerate() {
            let (period, jitter) = (channel.recurrence.span().as_ticks(), channel.tolerance().as_ticks());
            for node in (0..cluster.nodes.len()).filter(|n| cluster.nodes[*n].publishes.contains(&at)) {
                let stream = Stream { transmission: ours(channel.length), period, jitter };
                match &channel.class {
                    PlannedClass::Hard { .. } => {}
                    PlannedClass::Soft => {
                        let deadline = channel.deadline.unwrap_or(channel.recurrence.span()).as_ticks();
                        soft.push((at, node, SoftStream { stream, deadline }));
                    }
                    PlannedClass::NonRealTime { importance } => {
                        let priority = PlannedClass::priority_of(*importance);
                        non_real_time.push((at, node, priority, frames_of(channel.length), stream));
                    }
                }
            }
        }
        let sync = cluster.sync_period.map(|period| Stream {
            transmission: ours(8),
            period: period.as_ticks(),
            jitter: cluster.segment.release_jitter.as_ticks(),
        });
        Self {
            bus: Bus {
                bit,
                recovery: u64::from(ERROR_RECOVERY_BITS) * bit,
                errors: cluster.errors,
                calendar: CalendarLoad::of(plan),
            },
            // A sync frame and its follow-up.
            sync: sync.into_iter().flat_map(|stream| [stream, stream]).collect(),
            soft,
            non_real_time,
            foreign: cluster.foreign.iter().map(|frame| foreign_stream(frame, bit)).collect(),
            longest: u64::from(LONGEST_FRAME_BITS) * bit,
            priority_step: cluster.priority_step.as_ticks(),
            reload: cluster.segment.release_jitter.as_ticks(),
            slow_refill: cluster.slow_refill,
        }
    }

    /// What goes before all soft frames.
    pub(super) fn above_soft(&self) -> Vec<Stream> {
        let mut above = self.sync.clone();
        above.extend(self.foreign.iter().filter(|f| f.0 < Priority::CONFIGURATION.get()).map(|f| f.2));
        above
    }

    /// Of each non real-time and foreign frame with a deadline: the window in which it must get on the wire, and what
    /// is free of that.
    pub(super) fn guarded(&self, cluster: &Cluster) -> Vec<(u64, u64)> {
        let mut guarded = Vec::new();
        let slip = if self.slow_refill { self.longest } else { 0 };
        for &(channel, node, priority, frames, stream) in &self.non_real_time {
            let Some(deadline) = cluster.channels[channel].deadline else { continue };
            let higher = self.above(priority.get(), Some((channel, node)));
            let before = (frames - 1) * (stream.transmission + slip);
            let limit = deadline.as_ticks().min(stream.period.saturating_sub(stream.jitter));
            guarded.push(self.room(&higher, stream.transmission, before, limit));
        }
        for (at, &(_, _, stream)) in self.foreign.iter().enumerate() {
            let Some(deadline) = cluster.foreign[at].deadline else { continue };
            let higher = self.above_foreign(at);
            let limit = deadline.as_ticks().min(stream.period).saturating_sub(stream.jitter);
            guarded.push(self.room(&higher, stream.transmission, 0, limit));
        }
        guarded
    }

    /// The window that ends when a frame must be on the wire to be sent at `limit`, and what the sufficient test leaves
    /// free of it.
    fn room(&self, higher: &[Stream], transmission: u64, before: u64, limit: u64) -> (u64, u64) {
        let window = limit.saturating_sub(transmission);
        let front = self.longest.max(transmission).saturating_add(before);
        let above = higher.iter().map(|s| s.arrivals(window, self.bus.bit).saturating_mul(s.transmission));
        let taken = above
            .fold(front, u64::saturating_add)
            .saturating_add(self.bus.calendar.within(window.saturating_add(self.bus.bit)))
            .saturating_add(self.bus.error_overhead(window + transmission, self.longest));
        (window, window.saturating_sub(taken))
    }

    fn above_foreign(&self, at: usize) -> Vec<Stream> {
        let (priority, key, _) = self.foreign[at];
        let mut higher = self.sync.clone();
        higher.extend(self.soft.iter().map(|s| s.2.stream));
        higher.extend(self.foreign.iter().filter(|f| f.1 < key).map(|f| f.2));
        for &(_, _, _, frames, stream) in self.non_real_time.iter().filter(|n| n.2.get() <= priority) {
            higher.push(self.event(frames, stream, false));
        }
        higher
    }

    fn soft_proofs(&self, cluster: &Cluster) -> Vec<ChannelProof> {
        let above = self.above_soft();
        let soft_bus = SoftBus {
            bus: &self.bus,
            above: &above,
            blocking: self.longest,
            longest: self.longest,
            priority_step: self.priority_step,
            reload: self.reload,
            slow_refill: self.slow_refill,
        };
        let streams: Vec<SoftStream> = self.soft.iter().map(|s| s.2).collect();
        let bounds = soft_bus.responses(&streams);
        let proof = |(at, bound): (usize, Option<SoftBound>)| {
            let (channel, node, _) = self.soft[at];
            let deadline = cluster.channels[channel].deadline;
            let (how, terms) = match bound {
                Some(bound) => (rule_in_words(bound.rule), soft_terms(&soft_bus, &streams, at, &bound)),
                None => ("the bus is overloaded: there is no bound", Vec::new()),
            };
            let bound = bound.map(|bound| Duration::from_ticks(bound.response));
            let verdict = Verdict::of(bound, deadline);
            let origin = Origin::Publication;
            let proof = Proof { bound, deadline, verdict, origin, from_ready: None, how, terms };
            ChannelProof { channel, node, proof }
        };
        bounds.into_iter().enumerate().map(proof).collect()
    }

    /// Everything that goes before frames of this non real-time priority, but not those of one channel and
    /// publisher.
    fn above(&self, priority: u8, except: Option<(usize, usize)>) -> Vec<Stream> {
        let mut above = self.sync.clone();
        above.extend(self.soft.iter().map(|s| s.2.stream));
        above.extend(self.foreign.iter().filter(|f| f.0 <= priority).map(|f| f.2));
        let before =
            |n: &&(usize, usize, Priority, u64, Stream)| n.2.get() <= priority && except != Some((n.0, n.1));
        for &(_, node, _, frames, stream) in self.non_real_time.iter().filter(before) {
            let same_node = except.is_some_and(|except| except.1 == node);
            above.push(self.event(frames, stream, same_node));
        }
        above
    }

    /// All frames of an event as one. If nodes refill slowly, frames of one node do not follow each other
    /// without a gap: others slip in, and what is left of the event before adds to it.
    fn event(&self, frames: u64, stream: Stream, same_node: bool) -> Stream {
        let slip = if self.slow_refill && same_node { self.longest } else { 0 };
        let carried = if self.slow_refill && frames > 1 { stream.period } else { 0 };
        Stream {
            transmission: (stream.transmission + slip) * frames,
            jitter: stream.jitter + carried,
            ..stream
        }
    }

    fn non_real_time_proofs(&self, cluster: &Cluster) -> Vec<ChannelProof> {
        let mut proofs = Vec::new();
        for &(channel, node, priority, frames, stream) in &self.non_real_time {
            let higher = self.above(priority.get(), Some((channel, node)));
            let level = Level { higher: &higher, blocking: self.longest, longest: self.longest };
            let slip = if self.slow_refill { self.longest } else { 0 };
            let before = (frames - 1) * (stream.transmission + slip);
            let single = Stream { jitter: 0, ..stream };
            let all = level.sufficient(&single, &self.bus, before);
            let bound = all.filter(|all| all + stream.jitter <= stream.period);
            let how = match (bound, frames) {
                (None, _) => "events would come faster than they can be sent at worst: there is no bound",
                (Some(_), 1) => "from publication until sent, behind everything of higher priority",
                (Some(_), _) => "from publication until the last fragment has been sent",
            };
            let terms = bound.map_or_else(Vec::new, |all| self.level_terms(&level, &single, before, all));
            let bound = bound.map(Duration::from_ticks);
            let deadline = cluster.channels[channel].deadline;
            let verdict = Verdict::of(bound, deadline);
            proofs.push(ChannelProof {
                channel,
                node,
                proof: Proof {
                    bound,
                    deadline,
                    verdict,
                    origin: Origin::Publication,
                    from_ready: None,
                    how,
                    terms,
                },
            });
        }
        proofs
    }

    fn level_terms(&self, level: &Level<'_>, stream: &Stream, before: u64, response: u64) -> Vec<Term> {
        let start = response - stream.transmission - stream.jitter;
        let term = |name: &str, ticks: u64| Term { name: name.to_owned(), span: Duration::from_ticks(ticks) };
        let front = level.blocking.max(stream.transmission);
        let hard = self.bus.calendar.within(start + self.bus.bit);
        let faults = self.bus.error_overhead(start + stream.transmission, level.longest);
        let mut terms = vec![
            term("one frame that has just started", front),
            term("frames of higher priority", start.saturating_sub(front + before + hard + faults)),
            term("hard real-time frames", hard),
            term("faults", faults),
            term("the frame itself", stream.transmission),
        ];
        if before > 0 {
            terms.insert(1, term("the fragments before the last", before));
        }
        if stream.jitter > 0 {
            terms.insert(0, term("jitter", stream.jitter));
        }
        terms
    }

    fn foreign_proof(&self, cluster: &Cluster, at: usize) -> Proof {
        let (_, _, stream) = self.foreign[at];
        let higher = self.above_foreign(at);
        let level = Level { higher: &higher, blocking: self.longest, longest: self.longest };
        let bound = level.sufficient(&stream, &self.bus, 0).filter(|bound| *bound <= stream.period);
        let deadline = cluster.foreign[at].deadline;
        let how = match bound {
            Some(_) => "from its nominal instant until sent, behind everything that may go before it",
            None => "there is no bound within its period",
        };
        let terms = bound.map_or_else(Vec::new, |one| self.level_terms(&level, &stream, 0, one));
        let bound = bound.map(Duration::from_ticks);
        let verdict = Verdict::of(bound, deadline);
        Proof { bound, deadline, verdict, origin: Origin::Nominal, from_ready: None, how, terms }
    }

    fn utilisation(&self, plan: &Plan) -> Utilisation {
        let sum = |streams: &mut dyn Iterator<Item = Stream>| streams.map(|s| s.utilisation()).sum();
        let events = self.non_real_time.iter();
        Utilisation {
            reserved: plan.reserved(),
            hard: self.bus.calendar.utilisation(),
            soft: sum(&mut self.soft.iter().map(|s| s.2.stream)),
            non_real_time: events.map(|n| n.3 as f64 * n.4.utilisation()).sum(),
            sync: sum(&mut self.sync.iter().copied()),
            foreign: sum(&mut self.foreign.iter().map(|f| f.2)),
        }
    }
}

fn soft_terms(bus: &SoftBus<'_>, streams: &[SoftStream], at: usize, bound: &SoftBound) -> Vec<Term> {
    let mut terms: Vec<Term> = Vec::new();
    if bound.rule == Rule::EdgeOfBand {
        let outside = Duration::from_ticks(bound.response - bound.start);
        terms.push(Term {
            name: "until the deadline is within the band of priorities".to_owned(),
            span: outside,
        });
        let pending = "until all that can be pending then has been sent".to_owned();
        terms.push(Term { name: pending, span: Duration::from_ticks(bound.start) });
        return terms;
    }
    for (name, ticks) in bus.terms(streams, at, bound) {
        terms.push(Term { name: name.to_owned(), span: Duration::from_ticks(ticks) });
    }
    terms
}

fn rule_in_words(rule: Rule) -> &'static str {
    match rule {
        Rule::DeadlineOrder => {
            "from publication until sent, behind frames with deadlines before it or Δt_p later"
        }
        Rule::BusyPeriod => "from publication until sent: all soft frames together, in whatever order",
        Rule::EdgeOfBand => {
            "the deadline is beyond the band of priorities; from its edge on by order of deadlines"
        }
    }
}

/// The frames of an event: itself, or fragments with a header byte each and a checksum behind all.
fn frames_of(length: u16) -> u64 {
    if length <= 8 { 1 } else { fragments::frames_of(usize::from(length)) as u64 }
}

/// What a foreign frame's first eight bits would be as our priority; where it stands in arbitration.
fn foreign_stream(frame: &Foreign, bit: u64) -> (u8, u32, Stream) {
    let key = arbitration_key(frame.id, frame.extended);
    let priority = (key >> 22) as u8;
    let stream = Stream {
        transmission: longest_frame_bits(frame.extended, frame.length) * bit,
        period: frame.period.as_ticks(),
        jitter: frame.jitter.as_ticks(),
    };
    (priority, key, stream)
}
