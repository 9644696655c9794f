//! Bounds against the bit-accurate bus: what is observed never exceeds what is proven.
//!
//! Sets are drawn at random, and released as badly as is known: all together, each first frame as late as
//! its jitter allows, right behind the start of the longest frame of lower priority. How close the
//! observed maxima come is printed, and must not become poor: a bound that nothing comes near proves
//! little, and a simulation that stays far away tests little.

mod bed;

use bed::{Bed, Naming, Seen, Source};
use cosmic_bus::{BitPosition, Fault, FaultModel, Filter, Rule};
use cosmic_core::can::BitRate;
use cosmic_plan::analysis::segment::assess;
use cosmic_plan::analysis::set::MessageSet;
use cosmic_plan::cluster::{self, Cluster};
use cosmic_plan::document::Source as Document;
use cosmic_plan::plan::{Effort, Plan, plan};
use proptest::prelude::RngExt as _;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::fmt::Write as _;

fn rng(seed: u64) -> TestRng {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    TestRng::from_seed(RngAlgorithm::ChaCha, &bytes)
}

/// Instants of a stream until `end`: the first nominal one lies `jitter` before `first`.
fn releases(rng: &mut TestRng, first: u64, period: u64, jitter: u64, end: u64) -> Vec<(u64, u64)> {
    let mut all = vec![(first - jitter, first)];
    let mut nominal = first - jitter + period;
    while nominal < end {
        // Soon behind the first, as early as possible; later anyhow.
        let late = if nominal < first + 3 * period || jitter == 0 { 0 } else { rng.random_range(0..=jitter) };
        all.push((nominal, nominal + late));
        nominal += period;
    }
    all
}

/// `burst` faults in a row from the attempt `skip` on, each at the end of a frame, where it costs most.
fn burst(skip: u32, count: u32) -> FaultModel {
    FaultModel::none().with_rule(Rule {
        frames: Filter::ANY,
        skip,
        count,
        fault: Fault::Inverted(BitPosition::FromEnd(1)),
    })
}

/// How close observations come to bounds, in all.
#[derive(Default)]
struct Closeness {
    ratios: Vec<f64>,
}

impl Closeness {
    fn note(&mut self, observed: u64, bound: u64) {
        self.ratios.push(observed as f64 / bound as f64);
    }

    fn report(&mut self, what: &str) -> f64 {
        self.ratios.sort_by(f64::total_cmp);
        let count = self.ratios.len();
        let median = self.ratios[count / 2];
        let best = self.ratios[count - 1];
        println!("{what}: {count} bounds, observed / bound: median {median:.3}, closest {best:.3}");
        median
    }
}

const START: u64 = 5_000_000;

struct Drawn {
    extended: bool,
    id: u32,
    bytes: usize,
    period: u64,
    jitter: u64,
}

fn draw(rng: &mut TestRng) -> Vec<Drawn> {
    let count = rng.random_range(3..12);
    (0..count)
        .map(|at| {
            let extended = rng.random_range(0..2) == 1;
            let place = 0x111 + 0x61 * at;
            Drawn {
                extended,
                id: if extended { place << 18 | 0x1_5A5A } else { place },
                bytes: rng.random_range(0..=8),
                period: rng.random_range(10..120) * 100_000,
                jitter: rng.random_range(0..10) * 20_000,
            }
        })
        .collect()
}

#[test]
fn fixed_priorities_stay_within_the_exact_bound() {
    let mut closeness = Closeness::default();
    for seed in 0..300 {
        let mut rng = rng(seed);
        let drawn = draw(&mut rng);
        let faults: u32 = rng.random_range(0..3);
        let mut text = String::from("bit_rate = 500_000\n");
        if faults > 0 {
            writeln!(text, "[errors]\nburst = {faults}\ninterval = '10 s'").unwrap();
        }
        for message in &drawn {
            writeln!(
                text,
                "[[message]]\nid = {}\nextended = {}\nlength = {}\nperiod = '{} ns'\njitter = '{} ns'",
                message.id, message.extended, message.bytes, message.period, message.jitter
            )
            .unwrap();
        }
        let set = MessageSet::read(&Document::new("set", text)).unwrap_or_else(|p| panic!("{p}"));
        let findings = set.analyse(&|_| ());
        let mut observed = vec![Seen::default(); drawn.len()];
        for trial in 0..4 {
            let end = START + 200_000_000;
            // One of the lower frames starts just before all others are released.
            let blocker = rng.random_range(0..drawn.len());
            let sources: Vec<Source> = drawn
                .iter()
                .enumerate()
                .map(|(at, message)| {
                    let first = match trial {
                        0..3 if at == blocker => START - 2_000,
                        0..3 => START,
                        _ => START + rng.random_range(0..message.period),
                    };
                    Source {
                        node: at,
                        mailbox: 2,
                        naming: Naming::Fixed { extended: message.extended, id: message.id },
                        bytes: message.bytes,
                        releases: releases(&mut rng, first, message.period, message.jitter, end),
                        frames: 1,
                    }
                })
                .collect();
            let rate = BitRate::new(500_000).unwrap();
            let faults = burst(rng.random_range(0..4), faults);
            for (seen, new) in observed.iter_mut().zip(Bed::new(rate, faults, sources, 1).run(end)) {
                seen.count += new.count;
                seen.from_nominal = seen.from_nominal.max(new.from_nominal);
            }
        }
        for (at, (seen, finding)) in observed.iter().zip(&findings.messages).enumerate() {
            assert!(seen.count > 0, "seed {seed}: message {at} was never sent");
            let Some(bound) = finding.exact_us else { continue };
            let bound = (bound * 1000.0) as u64;
            assert!(seen.from_nominal <= bound, "seed {seed}, message {at}: {seen:?} beyond {bound}");
            closeness.note(seen.from_nominal, bound);
        }
    }
    assert!(closeness.report("fixed priorities") > 0.7);
}

/// A random segment, as its file.
fn segment(rng: &mut TestRng, faults: u32) -> String {
    let mut text = String::from(
        "[segment]\nname = 'random'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '5 us'\nstamp_latency = '1 us'\n\
         release_jitter = '5 us'\nsync_period = '0 s'\n",
    );
    if faults > 0 {
        writeln!(text, "[errors]\nburst = {faults}\ninterval = '10 s'").unwrap();
    }
    let count = rng.random_range(4..16);
    let nodes = rng.random_range(2..5);
    let mut published = vec![Vec::new(); nodes];
    let mut channels = String::new();
    for at in 0..count {
        let node = rng.random_range(0..nodes);
        published[node].push(format!("'c{at}'"));
        let class = ["HRT", "SRT", "SRT", "SRT", "NRT"][rng.random_range(0..5_usize)];
        let length = if class == "NRT" { rng.random_range(0..30) } else { rng.random_range(0..=8) };
        writeln!(
            channels,
            "[[channel]]\nname = 'c{at}'\nsubject = {}\nclass = '{class}'\nlength = {length}",
            at + 1
        )
        .unwrap();
        match class {
            "HRT" => writeln!(channels, "period = '{} ms'", [5, 10, 20][rng.random_range(0..3_usize)]),
            "SRT" => {
                let period = rng.random_range(8..100) * 100;
                let deadline = rng.random_range(5..60) * 100;
                let jitter = rng.random_range(0..5) * 50;
                writeln!(
                    channels,
                    "period = '{period} us'\ndeadline = '{deadline} us'\njitter = '{jitter} us'"
                )
            }
            _ => writeln!(channels, "period = '40 ms'\nimportance = {}", rng.random_range(0..5)),
        }
        .unwrap();
    }
    for (at, names) in published.iter().enumerate() {
        writeln!(text, "[[node]]\nname = 'n{at}'\nuid = {}\npublishes = [{}]", at + 1, names.join(", "))
            .unwrap();
    }
    text + &channels
}

fn sources(rng: &mut TestRng, cluster: &Cluster, plan: &Plan, end: u64, together: bool) -> Vec<Source> {
    let mut sources = Vec::new();
    for (at, channel) in cluster.channels.iter().enumerate() {
        let node =
            cluster.nodes.iter().position(|node| node.publishes.contains(&at)).expect("it is published");
        let tail =
            u32::from(cluster.nodes[node].tx_node.get()) << 14 | u32::from(channel.etag.unwrap().get());
        let (period, jitter) = (channel.recurrence.span().as_ticks(), channel.jitter.as_ticks());
        let (mailbox, naming, releases, frames) = match &channel.class {
            cluster::PlannedClass::Hard { .. } => {
                let slot = &plan.slots().iter().find(|slot| slot.channel == at).expect("it has a slot").slot;
                // A node's clock may be off, and its task late.
                let off = rng.random_range(0..=15_000);
                let ready = |turn: u64| slot.phase.as_ticks() + turn * period + off;
                let all = (0..end / period).map(|turn| (ready(turn), ready(turn))).collect();
                (0, Naming::Fixed { extended: true, id: tail }, all, 1)
            }
            cluster::PlannedClass::Soft => {
                let first = if together { START } else { START + rng.random_range(0..period) };
                let deadline = channel.deadline.unwrap().as_ticks();
                let all = releases(rng, first, period, jitter, end);
                (1, Naming::Soft { tail, deadline }, all, 1)
            }
            cluster::PlannedClass::NonRealTime { importance } => {
                let first = if together { START - 2_000 } else { START + rng.random_range(0..period) };
                let priority = u32::from(cluster::PlannedClass::priority_of(*importance).get());
                let frames =
                    if channel.length <= 8 { 1 } else { (u32::from(channel.length) + 2).div_ceil(7) };
                let id = priority << 21 | tail;
                (2, Naming::Fixed { extended: true, id }, releases(rng, first, period, jitter, end), frames)
            }
        };
        let bytes = usize::from(channel.length.min(8));
        sources.push(Source { node, mailbox, naming, bytes, releases, frames });
    }
    sources
}

#[test]
fn segments_stay_within_their_bounds() {
    let (mut soft, mut slow) = (Closeness::default(), Closeness::default());
    let mut accepted = 0;
    for seed in 0..300 {
        let mut rng = rng(1000 + seed);
        let faults = rng.random_range(0..3);
        let text = segment(&mut rng, faults);
        let cluster = Cluster::read(&Document::new("segment", text)).unwrap_or_else(|p| panic!("{p}"));
        let Ok(plan) = plan(&cluster, &Effort::default()) else { continue };
        let assessment = assess(&cluster, &plan);
        accepted += u32::from(assessment.holds());
        for trial in 0..3 {
            let end = START + 120_000_000;
            let sources = sources(&mut rng, &cluster, &plan, end, trial < 2);
            let model = burst(rng.random_range(0..6), faults);
            let step = cluster.priority_step.as_ticks();
            let seen = Bed::new(cluster.segment.bit_rate, model, sources, step).run(end);
            for (seen, proven) in seen.iter().zip(&assessment.channels) {
                let Some(bound) = proven.proof.bound else { continue };
                let bound = bound.as_ticks();
                let channel = &cluster.channels[proven.channel];
                let observed = match channel.class {
                    // A frame is loaded up to 15 µs behind its ready instant here, and faults beyond the
                    // omission degree are not its matter.
                    cluster::PlannedClass::Hard { .. } if faults > 1 => continue,
                    cluster::PlannedClass::Hard { .. } | cluster::PlannedClass::Soft => seen.from_publication,
                    cluster::PlannedClass::NonRealTime { .. } => seen.from_nominal,
                };
                assert!(observed <= bound, "seed {seed}, {}: {seen:?} beyond {bound}", channel.name);
                match channel.class {
                    cluster::PlannedClass::Soft if trial == 0 => soft.note(observed, bound),
                    cluster::PlannedClass::NonRealTime { .. } if trial == 0 => slow.note(observed, bound),
                    _ => {}
                }
            }
        }
    }
    println!("{accepted} of 300 segments accepted");
    assert!(accepted > 100);
    assert!(soft.report("soft real-time") > 0.3);
    slow.report("non real-time");
}

/// Three nodes share a window; faults up to the pool's budget hit its frames, wherever; frames of lower
/// priority fill the bus, and clocks and tasks are as bad as the segment allows.
#[test]
fn a_pool_is_in_time_under_its_shared_budget_of_faults() {
    let file = include_str!("../../../docs/tutorial/pooled.toml");
    let cluster = Cluster::read(&Document::new("pooled.toml", file)).unwrap_or_else(|p| panic!("{p}"));
    let plan = plan(&cluster, &Effort::default()).expect("the tutorial says so");
    let members: Vec<_> = plan.slots().iter().filter(|slot| slot.pool.is_some()).collect();
    let (deadline, ready) = (members[0].times.deadline.as_ticks(), members[0].slot.phase.as_ticks());
    let gap = plan.segment().gap().as_ticks();
    let mut closest: f64 = 0.0;
    for seed in 0..400 {
        let mut rng = rng(9000 + seed);
        let mut sources: Vec<Source> = members
            .iter()
            .enumerate()
            .map(|(node, member)| {
                let loaded = ready + rng.random_range(0..=gap);
                let id = u32::from(member.slot.publisher.get()) << 14 | u32::from(member.slot.etag.get());
                Source {
                    node,
                    mailbox: 0,
                    naming: Naming::Fixed { extended: true, id },
                    bytes: usize::from(member.slot.len),
                    releases: vec![(loaded, loaded)],
                    frames: 1,
                }
            })
            .collect();
        let begin = ready.saturating_sub(rng.random_range(0..400_000));
        sources.push(Source {
            node: members.len(),
            mailbox: 2,
            naming: Naming::Fixed { extended: true, id: 0x1FFF_FFFF },
            bytes: 8,
            releases: vec![(begin, begin)],
            frames: 40,
        });
        // Two faults in frames of the pool: all that it tolerates.
        let mut faults = FaultModel::none();
        for member in [rng.random_range(0..members.len()), rng.random_range(0..members.len())] {
            let slot = &members[member].slot;
            let raw = u32::from(slot.publisher.get()) << 14 | u32::from(slot.etag.get());
            let id = embedded_can::ExtendedId::new(raw).expect("29 bits");
            faults.add_rule(Rule {
                frames: Filter::exactly(id.into()),
                skip: 0,
                count: 1,
                fault: Fault::Inverted(BitPosition::FromEnd(rng.random_range(0..60))),
            });
        }
        let seen = Bed::new(cluster.segment.bit_rate, faults, sources, 1).run(50_000_000);
        for seen in &seen[..members.len()] {
            assert_eq!(seen.count, 1);
            assert!(seen.from_publication <= deadline, "seed {seed}: {seen:?} beyond {deadline}");
            closest = closest.max(seen.from_publication as f64 / deadline as f64);
        }
    }
    println!("pool: closest {closest:.3}");
    assert!(closest > 0.7);
}
