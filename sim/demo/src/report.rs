//! The numbers of a run, as they are printed and written as JSON.
//!
//! Spans are in microseconds of true (virtual) time.

use cosmic_bus::trace::{BusError, Origin};
use cosmic_bus::{TrafficClass, VirtualInstant};
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::ExceptionKind;
use serde::Serialize;

use crate::bus_log::{Attempt, Ending};
use crate::cluster::{Channel, Promise};
use crate::hard::{self, Fate};
use crate::journal::Journal;
use crate::order;
use crate::span::{Range, Span, Spread};
use crate::verdict::{Totals, Verdict};

/// What the run was asked for.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct Settings {
    /// Virtual seconds.
    pub seconds: f64,
    /// All chance follows from it.
    pub seed: u64,
    /// The load that the bus as a whole was to have, in percent.
    pub load_percent: f64,
    /// The chance that a frame on the wire is destroyed.
    pub error_rate: f64,
    /// Attempts that were to be destroyed in a row in one hard real-time slot.
    pub burst: u32,
}

/// The numbers of a run.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct Report {
    /// What was asked for.
    pub settings: Settings,
    /// Whether everything was as promised.
    pub passed: bool,
    /// What was not.
    pub violations: Vec<String>,
    /// How the clocks were synchronised.
    pub settling: Settling,
    /// The channels.
    pub channels: Vec<ChannelReport>,
    /// The hard real-time slots.
    pub slots: SlotReport,
    /// How soft real-time events competed.
    pub order: OrderReport,
    /// The bus.
    pub bus: BusReport,
    /// The background load.
    pub background: BackgroundReport,
    /// Exceptions that applications were told of.
    pub exceptions: Vec<ExceptionReport>,
}

/// How the clocks were synchronised.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct Settling {
    /// From when on all nodes rely on their clocks, from the start of the run; `None` if that was never.
    pub until_us: Option<Span>,
    /// The ready instant of the first slot that is judged, from the start of the run.
    pub judged_from_us: Option<Span>,
    /// Exceptions *clock out of bound* before that.
    pub exceptions: usize,
}

/// A channel in numbers.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct ChannelReport {
    /// Its name.
    pub name: &'static str,
    /// `HRT`, `SRT` or `NRT`.
    pub class: &'static str,
    /// The publisher's name.
    pub publisher: &'static str,
    /// Events that the publisher's middleware took.
    pub published: usize,
    /// Events that it refused.
    pub refused: usize,
    /// Events that were sent.
    pub sent: usize,
    /// Events that missed their deadline; hard real-time: that were not delivered in their slot.
    pub missed: usize,
    /// Events that expired before they were sent.
    pub expired: usize,
    /// Events that were on their way when the run ended.
    pub under_way: usize,
    /// Hard real-time events published before the clocks were synchronised and not delivered.
    pub lost_while_settling: usize,
    /// The subscribers.
    pub subscribers: Vec<SubscriberReport>,
}

/// A channel at a subscriber.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct SubscriberReport {
    /// Its name.
    pub node: &'static str,
    /// Events that its application took, each counted once.
    pub delivered: usize,
    /// Events that were published before it subscribed.
    pub before: usize,
    /// Further copies that it took.
    pub duplicates: usize,
    /// From publication until the event became visible.
    pub latency_us: Option<Range>,
    /// Hard real-time: distance from the delivery instant of the calendar. Otherwise: difference of the
    /// latencies of two events in a row.
    pub jitter_us: Option<Range>,
    /// From publication until the application had taken the event.
    pub taken_us: Option<Range>,
}

/// The hard real-time slots in numbers.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct SlotReport {
    /// Slots after the settling time.
    pub judged: usize,
    /// Slots whose event was delivered everywhere.
    pub delivered: usize,
    /// Slots in which at least one attempt was destroyed.
    pub with_faults: usize,
    /// Slots in which more attempts were destroyed than the omission degree, or a node was bus-off or
    /// without the time of the cluster.
    pub beyond_hypothesis: usize,
    /// Slots whose event was lost, beyond the hypothesis and reported.
    pub lost: usize,
    /// Slots for which nothing had been published.
    pub unused: usize,
    /// Slots that were not judged, because the cluster had no common time.
    pub without_time: usize,
    /// Delivery less delivery instant of the calendar.
    pub deviation_us: Option<Range>,
    /// The earliest and the latest that is allowed.
    pub allowed_us: (Span, Span),
}

/// How soft real-time events competed.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct OrderReport {
    /// How often a frame waited while another won the bus.
    pub contests: usize,
    /// How often a node chose between several events.
    pub choices: usize,
    /// The most by which a winner was less urgent than one that waited.
    pub worst_us: Option<Span>,
    /// What is allowed.
    pub bound_us: Span,
    /// How often more than that.
    pub inversions: usize,
}

/// The bus in numbers.
#[derive(Clone, PartialEq, Serialize, Debug)]
pub struct BusReport {
    /// Its bit rate, in bits per second.
    pub bits_per_second: u32,
    /// The share of time in which it was not free, in percent.
    pub load_percent: f64,
    /// The share of destroyed frames and error frames in it, in percent.
    pub error_load_percent: f64,
    /// By class.
    pub classes: Vec<ClassReport>,
    /// Attempts that failed.
    pub failed_attempts: u64,
    /// Those of them that failed because no other station took part in the traffic.
    pub unacknowledged_attempts: usize,
    /// Frames that the error source hit.
    pub injected_errors: u64,
    /// Element k: frames that were sent after k failed attempts.
    pub frames_by_omission_degree: Vec<u64>,
}

/// A class of traffic.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct ClassReport {
    /// `HRT`, `SRT`, `NRT`.
    pub class: &'static str,
    /// Frames that were sent.
    pub frames: u64,
    /// The share of time that they took, in percent.
    pub load_percent: f64,
}

/// The background load in numbers.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct BackgroundReport {
    /// Soft real-time events published.
    pub soft_published: u64,
    /// Soft real-time events sent.
    pub soft_sent: u64,
    /// Soft real-time events that missed their deadline.
    pub soft_missed: u64,
    /// Soft real-time events that expired.
    pub soft_expired: u64,
    /// Non real-time events published.
    pub non_real_time_published: u64,
    /// Non real-time events sent.
    pub non_real_time_sent: u64,
}

/// Exceptions of one kind at one node.
#[derive(Clone, Copy, PartialEq, Serialize, Debug)]
pub struct ExceptionReport {
    /// The node's name.
    pub node: &'static str,
    /// The channel's name; `None` if they concern the node as a whole.
    pub channel: Option<&'static str>,
    /// Whether the node is the publisher of the channel, or a subscriber.
    pub role: Option<&'static str>,
    /// What.
    pub kind: &'static str,
    /// How often.
    pub count: usize,
    /// How often before the first hard real-time slot that is judged.
    pub while_starting: usize,
}

impl Report {
    /// The numbers of a run and its verdict.
    pub fn of(settings: Settings, journal: &Journal, verdict: &Verdict) -> Self {
        let start = VirtualInstant::from_ticks(0);
        let accounts = verdict.ledger.channels.iter().zip(&verdict.totals);
        Self {
            settings,
            passed: verdict.is_passed(),
            violations: verdict.violations.iter().map(|it| it.describe(journal.cluster)).collect(),
            settling: Settling {
                until_us: verdict.slots.settled_at.map(|at| Span::between(start, at)),
                judged_from_us: judged_from(verdict).map(|at| Span::between(start, at)),
                exceptions: verdict.slots.settling_exceptions,
            },
            channels: accounts
                .map(|(account, totals)| channel(journal, verdict, account.channel, totals))
                .collect(),
            slots: slots(journal, verdict),
            order: OrderReport {
                contests: verdict.order.contests,
                choices: verdict.order.choices,
                worst_us: verdict.order.worst,
                bound_us: order::bound(journal.cluster.calendar),
                inversions: verdict.order.inversions.len(),
            },
            bus: bus(journal),
            background: background(journal),
            exceptions: exceptions(journal, verdict),
        }
    }
}

fn channel(
    journal: &Journal,
    verdict: &Verdict,
    channel: &'static Channel,
    totals: &Totals,
) -> ChannelReport {
    ChannelReport {
        name: channel.name,
        class: channel.class.name(),
        publisher: journal.cluster.name_of(channel.publisher),
        published: totals.published,
        refused: totals.refused,
        sent: totals.sent,
        missed: totals.missed,
        expired: totals.expired,
        under_way: totals.under_way,
        lost_while_settling: totals.settling,
        subscribers: channel
            .subscribers
            .iter()
            .map(|it| subscriber(journal, verdict, channel, *it))
            .collect(),
    }
}

fn subscriber(
    journal: &Journal,
    verdict: &Verdict,
    channel: &'static Channel,
    node: TxNode,
) -> SubscriberReport {
    let (mut latency, mut taken, mut jitter) = (Spread::default(), Spread::default(), Spread::default());
    let (mut delivered, mut before, mut duplicates, mut previous) = (0, 0, 0, None);
    let subscribed_from = verdict.ledger.subscribed_from(node, channel.number);
    let account = verdict.ledger.account(channel.etag, channel.publisher);
    for life in account.into_iter().flat_map(|account| account.events.iter()) {
        let mut deliveries = life.deliveries_to(node);
        let Some(first) = deliveries.next() else {
            before += usize::from(subscribed_from.is_some_and(|from| life.published_at <= from));
            continue;
        };
        delivered += 1;
        duplicates += deliveries.count();
        let span = Span::between(life.published_at, first.visible_at);
        latency.add(span);
        taken.add(Span::between(life.published_at, first.taken_at));
        if let Some(previous) = previous.replace(span) {
            jitter.add((span - previous).abs());
        }
    }
    if channel.class == Promise::Hard {
        let of = verdict.slots.jitter.iter().find(|(at, slot, _)| {
            (*at, slot.etag, slot.publisher) == (node, channel.etag, channel.publisher)
        });
        jitter = of.map_or(Spread::default(), |(.., spread)| *spread);
    }
    SubscriberReport {
        node: journal.cluster.name_of(node),
        delivered,
        before,
        duplicates,
        latency_us: latency.range(),
        jitter_us: jitter.range(),
        taken_us: taken.range(),
    }
}

/// The ready instant of the first slot that is judged.
fn judged_from(verdict: &Verdict) -> Option<VirtualInstant> {
    let first = verdict.slots.occurrences.iter().find(|it| it.fate.is_judged())?;
    Some(first.window.ready)
}

fn slots(journal: &Journal, verdict: &Verdict) -> SlotReport {
    let judged = || verdict.slots.occurrences.iter().filter(|it| it.fate.is_judged());
    let with = |fate| verdict.slots.occurrences.iter().filter(|it| it.fate == fate).count();
    SlotReport {
        judged: judged().count(),
        delivered: with(Fate::Delivered),
        with_faults: judged().filter(|it| it.faulted > 0).count(),
        beyond_hypothesis: judged().filter(|it| it.is_beyond_hypothesis()).count(),
        lost: with(Fate::Lost),
        unused: with(Fate::Unused),
        without_time: with(Fate::NoCommonTime),
        deviation_us: verdict.slots.deviation.range(),
        allowed_us: hard::bounds(journal),
    }
}

fn bus(journal: &Journal) -> BusReport {
    let accounting = &journal.accounting;
    let bit_time = journal.bit_rate.bit_time().as_ticks();
    let share = |bits: u64| (bits * bit_time) as f64 * 100.0 / journal.end.as_ticks().max(1) as f64;
    let classes = [TrafficClass::Hard, TrafficClass::Soft, TrafficClass::NonRealTime];
    let class = |(class, name)| ClassReport {
        class: name,
        frames: accounting.frames(class),
        load_percent: share(accounting.bits(class)),
    };
    BusReport {
        bits_per_second: journal.bit_rate.bits_per_second(),
        load_percent: share(accounting.busy_bits()),
        error_load_percent: share(accounting.error_bits()),
        classes: classes.into_iter().zip(["HRT", "SRT", "NRT"]).map(class).collect(),
        failed_attempts: accounting.failed_attempts(),
        unacknowledged_attempts: journal.bus.attempts().iter().filter(|it| is_unheard(it)).count(),
        injected_errors: accounting.inverted(),
        frames_by_omission_degree: accounting.omission_degrees().to_vec(),
    }
}

fn is_unheard(attempt: &Attempt) -> bool {
    matches!(attempt.ending, Ending::Failed(BusError { origin: Origin::NoReceiver, .. }))
}

fn background(journal: &Journal) -> BackgroundReport {
    let log = &journal.background;
    BackgroundReport {
        soft_published: log.published[0],
        soft_sent: log.sent[0],
        soft_missed: log.missed,
        soft_expired: log.expired,
        non_real_time_published: log.published[1],
        non_real_time_sent: log.sent[1],
    }
}

fn exceptions(journal: &Journal, verdict: &Verdict) -> Vec<ExceptionReport> {
    // A channel with several publishers stands in the cluster several times.
    let mut channels: Vec<_> = journal.cluster.channels.iter().collect();
    channels.dedup_by_key(|channel| channel.etag);
    let channels = channels.into_iter().map(Some).chain([None]);
    let places = channels.flat_map(|channel| journal.cluster.nodes.iter().map(move |node| (channel, node)));
    let started = judged_from(verdict);
    let mut reports = Vec::new();
    for (channel, node) in places {
        for kind in ExceptionKind::ALL {
            let etag = channel.map(|channel| channel.etag);
            let same = |it: &&super::ledger::Told| (it.node, it.etag, it.kind) == (node.tx_node, etag, *kind);
            let count = verdict.ledger.told.iter().filter(same).count();
            let starting = |it: &&super::ledger::Told| started.is_none_or(|started| it.at < started);
            let while_starting = verdict.ledger.told.iter().filter(same).filter(starting).count();
            if count > 0 {
                let is_publisher =
                    |channel: &Channel| journal.cluster.channel_of(channel.etag, node.tx_node).is_some();
                reports.push(ExceptionReport {
                    node: node.name,
                    channel: channel.map(|channel| channel.name),
                    role: channel.map(|it| if is_publisher(it) { "publisher" } else { "subscriber" }),
                    kind: kind.name(),
                    count,
                    while_starting,
                });
            }
        }
    }
    reports
}
