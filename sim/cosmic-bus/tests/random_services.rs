//! Clusters that configure themselves, under random faults: whatever happens, the nodes agree in the end, and
//! no event vanishes without a count.
//!
//! Each run is one seed, printed on failure. `COSMIC_SEED` repeats one, `COSMIC_RUNS` sets how many there
//! are. The judge looks only at the trace of the bus and at what the applications saw.

mod service_cluster;

use cosmic_bus::trace::{TraceEvent, TraceKind};
use cosmic_bus::{ErrorLevel, StationId, Transmitter, VirtualInstant};
use cosmic_core::broker::{Broker, BrokerRole};
use cosmic_core::can::{Etag, Frame, TxNode};
use cosmic_core::protocol::Side;
use service_cluster::{CHANNELS, Label, MILLISECOND, Sample, Scenario, subject};
use std::collections::{BTreeSet, HashMap, HashSet};

#[test]
fn clusters_agree_in_the_end_and_no_event_vanishes() {
    let (runs, mut delivered) = (runs(), 0);
    for &seed in &runs {
        match std::panic::catch_unwind(|| survive(seed)) {
            Ok(count) => delivered += count,
            Err(panic) => {
                eprintln!("COSMIC_SEED={seed} repeats this");
                std::panic::resume_unwind(panic);
            }
        }
    }
    assert!(delivered > 300 * runs.len(), "{delivered}");
}

fn runs() -> Vec<u64> {
    if let Some(seed) = std::env::var("COSMIC_SEED").ok().and_then(|seed| seed.parse().ok()) {
        return vec![seed];
    }
    let count = std::env::var("COSMIC_RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(200);
    (1..=count).collect()
}

/// One run. Returns how many events were delivered.
fn survive(seed: u64) -> usize {
    let mut scenario = Scenario::new(seed);
    let first = scenario.dice.below(3_000);
    scenario.advance(first);
    for _ in 0..1 + scenario.dice.below(5) {
        scenario.disrupt();
    }
    scenario.advance(SETTLING);
    scenario.journal.borrow_mut().calm = true;
    let victim = scenario.dice.below(scenario.stations.len() as u64) as usize;
    let dead = scenario.cluster.visit(scenario.stations[victim], |node| node.half().services().tx_node());
    scenario.cluster.power_off(scenario.stations[victim]);
    scenario.advance(CALM);
    check_agreement(&mut scenario, victim, dead.flatten());
    check_publishers(&mut scenario);
    check_subscribers(&scenario);
    scenario.journal.borrow().deliveries.len()
}

/// In milliseconds: after the last disruption everything is as it should be, though events flow.
const SETTLING: u64 = 6_000;
/// In milliseconds: nobody publishes. Longer than a lease, a silence, and a round of the broker's table.
const CALM: u64 = 6_000;

/// Ids differ, each subject has one etag, the brokers and the clocks agree, and the dead are forgotten.
fn check_agreement(scenario: &mut Scenario, victim: usize, dead: Option<TxNode>) {
    let mut ids = BTreeSet::new();
    let mut etags: HashMap<u8, Etag> = HashMap::new();
    let mut owners: HashMap<Etag, u8> = HashMap::new();
    let (mut active, mut masters) = (0, 0);
    for (index, station) in scenario.stations.clone().into_iter().enumerate() {
        if index == victim {
            continue;
        }
        let roles = scenario.roles[index];
        let known = scenario.cluster.visit(station, |node| {
            let now = node.now;
            let services = node.half().services();
            let synchronised = services.clock().clock().is_synchronised(now);
            assert!(synchronised, "node {} is not synchronised", index + 1);
            active += usize::from(services.broker().as_ref().map(Broker::role) == Some(BrokerRole::Active));
            masters += usize::from(services.clock().is_master());
            if let Some(dead) = dead {
                let members = services.members();
                assert!(members.status_of(dead).is_none(), "node {} takes {dead:?} for alive", index + 1);
                for channel in 0..CHANNELS {
                    let Some(etag) = services.etag_of(subject(channel)) else { continue };
                    for side in [Side::Publisher, Side::Subscriber] {
                        let interested =
                            services.interests().nodes(etag, side).any(|(node, ..)| node == dead);
                        assert!(!interested, "node {} keeps the interest of {dead:?}", index + 1);
                    }
                }
            }
            let etags: Vec<_> = (0..CHANNELS).map(|channel| services.etag_of(subject(channel))).collect();
            (services.tx_node(), etags)
        });
        let (tx_node, known) = known.expect("the node is on");
        let tx_node = tx_node.unwrap_or_else(|| panic!("node {} has no TxNode", index + 1));
        assert!(ids.insert(tx_node), "{tx_node:?} belongs to two nodes");
        for channel in 0..CHANNELS {
            let at = usize::from(channel);
            if !roles.publishes[at] && !roles.subscribes[at] {
                continue;
            }
            let etag = known[at].unwrap_or_else(|| panic!("node {} has no etag for {channel}", index + 1));
            assert_eq!(*etags.entry(channel).or_insert(etag), etag, "channel {channel} has two etags");
            assert_eq!(*owners.entry(etag).or_insert(channel), channel, "{etag:?} belongs to two channels");
        }
    }
    assert_eq!((active, masters), (1, 1), "brokers and masters");
}

/// What a node has accepted has left it, or was counted as expired.
fn check_publishers(scenario: &mut Scenario) {
    for (index, station) in scenario.stations.clone().into_iter().enumerate() {
        let (number, journal) = (index as u8 + 1, scenario.journal.clone());
        let roles = scenario.roles[index];
        scenario.cluster.visit(station, |node| {
            let journal = journal.borrow();
            let start = journal.starts[&number];
            for channel in (0..CHANNELS).filter(|channel| roles.publishes[usize::from(*channel)]) {
                let accepted = journal.accepted.get(&(number, start, channel)).copied().unwrap_or_default();
                let counters = node.half().channel_counters(subject(channel)).unwrap();
                assert_eq!(
                    accepted,
                    counters.sent + counters.discarded,
                    "node {number}, channel {channel}: {counters:?}"
                );
            }
        });
    }
}

/// When a node could not hear the others.
struct Absence {
    from: VirtualInstant,
    until: VirtualInstant,
}

fn absences(trace: &[TraceEvent], of: StationId) -> Vec<Absence> {
    let mut all: Vec<Absence> = Vec::new();
    for event in trace {
        let back = match event.kind {
            TraceKind::Connection { station, connected } if station == of => connected,
            TraceKind::Reset { station } if station == of => true,
            TraceKind::ErrorState { station, state } if station == of => state.level() != ErrorLevel::BusOff,
            _ => continue,
        };
        match all.last_mut() {
            Some(last) if last.until == FOREVER => {
                if back {
                    last.until = event.at;
                }
            }
            _ => {
                let until = if back { event.at } else { FOREVER };
                all.push(Absence { from: event.at, until });
            }
        }
    }
    all
}

const FOREVER: VirtualInstant = VirtualInstant::from_ticks(u64::MAX / 2);

/// Had the node this etag for the channel, in one run, for a while before and behind this instant? While
/// brokers contradict each other, an etag may come and go between two samples.
fn is_bound(samples: &[Sample], channel: u8, etag: Etag, at: VirtualInstant) -> bool {
    let behind = samples.partition_point(|sample| sample.at <= at);
    let around = behind.checked_sub(STEADY).and_then(|first| samples.get(first..behind + STEADY));
    let Some([first, rest @ ..]) = around else { return false };
    let same = |sample: &Sample| sample.etags[usize::from(channel)] == Some(etag);
    same(first) && rest.iter().all(|sample| sample.start == first.start && same(sample))
}

/// So many samples on both sides of an instant must agree.
const STEADY: usize = 8;

/// Every event that was on the bus reached every subscriber that was there, or its queue was full; none
/// reached another channel's, except while parts of the bus came together.
fn check_subscribers(scenario: &Scenario) {
    let journal = scenario.journal.borrow();
    // Parts of the bus that come together do not know yet that they have used one etag for two subjects.
    let uniting = |now: VirtualInstant| {
        let since = |at: &VirtualInstant| now.as_ticks().checked_sub(at.as_ticks());
        let lately = |at: &VirtualInstant| since(at).is_some_and(|span| span < SETTLING / 2 * MILLISECOND);
        scenario.unions.iter().any(lately)
    };
    for delivery in journal.deliveries.iter().filter(|delivery| delivery.channel != delivery.label.channel) {
        assert!(uniting(delivery.at), "on a wrong channel: {delivery:?}");
    }
    for (node, at) in &journal.malformed {
        assert!(uniting(*at), "node {node} got what is no event of the channel at {at:?}");
    }
    let delivered: HashSet<(u8, Label)> =
        journal.deliveries.iter().map(|delivery| (delivery.node, delivery.label)).collect();
    for (index, station) in scenario.stations.iter().enumerate() {
        let number = index as u8 + 1;
        let absences = absences(&scenario.trace, *station);
        let samples = journal.samples.get(&number).map_or(&[][..], Vec::as_slice);
        let mut missing: HashMap<u8, u32> = HashMap::new();
        let mut unnoticed = None;
        for event in &scenario.trace {
            if let TraceKind::Omission { number, victims, transmitter: Transmitter::Accepts } = &event.kind {
                // The error flags of a node that is error passive tell nobody that it has rejected the frame.
                unnoticed = victims.contains(station).then_some(*number);
            }
            let TraceKind::FrameEnd { number: frame_number, frame, station: sender, .. } = &event.kind else {
                continue;
            };
            if unnoticed == Some(*frame_number) {
                continue;
            }
            let Ok(frame) = Frame::try_from(*frame) else { continue };
            let etag = frame.id.etag();
            if sender == station || etag < Etag::BOUND_FIRST {
                continue;
            }
            let label = Label::read(frame.payload.as_slice()).expect("an event of these applications");
            let there = absences.iter().all(|absence| {
                let margin = 50 * MILLISECOND;
                event.at.as_ticks() + margin < absence.from.as_ticks()
                    || event.at.as_ticks() > absence.until.as_ticks() + margin
            });
            let subscribes = scenario.roles[index].subscribes[usize::from(label.channel)];
            if there && subscribes && is_bound(samples, label.channel, etag, event.at) {
                *missing.entry(label.channel).or_default() +=
                    u32::from(!delivered.contains(&(number, label)));
            }
        }
        for (channel, missing) in missing {
            let overflows = journal.overflows.get(&(number, channel)).copied().unwrap_or_default();
            assert!(
                missing <= overflows,
                "node {number} misses {missing} of channel {channel}, {overflows} counted"
            );
        }
    }
}
