//! Properties of whole plans, over random clusters.

use cosmic_plan::analysis::segment::assess;
use cosmic_plan::cluster::{Cluster, PlannedClass};
use cosmic_plan::document::Source;
use cosmic_plan::plan::{Effort, NoPlan, plan};
use cosmic_plan::verify::verify;
use proptest::prelude::*;
use std::fmt::Write as _;

/// A cluster of hard channels: (period in ms, bytes, omission degree, wish), and how the bus is loaded besides.
fn cluster(hard: &[(u64, u8, u8, u8)], soft: &[(u64, u64)]) -> Cluster {
    let mut text = String::from(
        "[segment]\nname = 'random'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '5 us'\nstamp_latency = '1 us'\nrelease_jitter = '5 us'\n\
         [errors]\ncount = 1\nwindow = '20 ms'\n",
    );
    for node in 0..3 {
        let ours = (0..hard.len() + soft.len()).filter(|at| at % 3 == node).map(|at| format!("'c{at}'"));
        let list = ours.collect::<Vec<_>>().join(", ");
        writeln!(text, "[[node]]\nname = 'n{node}'\nuid = {}\npublishes = [{list}]", node + 1).unwrap();
    }
    for (at, (period, bytes, degree, wish)) in hard.iter().enumerate() {
        writeln!(
            text,
            "[[channel]]\nname = 'c{at}'\nsubject = {}\nclass = 'HRT'\nlength = {bytes}\nperiod = '{period} ms'\n\
             omission_degree = {degree}",
            at + 1
        )
        .unwrap();
        match wish {
            0 => writeln!(text, "deadline = '{} us'", period * 700).unwrap(),
            1 => writeln!(text, "earliest = '{} us'", period * 300).unwrap(),
            3 => writeln!(text, "jitter = '400 us'").unwrap(),
            2 if at > 0 && hard[0].0 == *period => {
                writeln!(text, "after = {{ channel = 'c0', within = '1500 us' }}").unwrap();
            }
            _ => {}
        }
    }
    for (at, (period, deadline)) in soft.iter().enumerate() {
        let name = hard.len() + at;
        writeln!(
            text,
            "[[channel]]\nname = 'c{name}'\nsubject = {}\nclass = 'SRT'\nlength = 8\nperiod = '{period} us'\n\
             deadline = '{deadline} us'",
            name + 1
        )
        .unwrap();
    }
    Cluster::read(&Source::new("random.toml", text)).unwrap_or_else(|problems| panic!("{problems}"))
}

fn hard() -> impl Strategy<Value = Vec<(u64, u8, u8, u8)>> {
    let period = prop::sample::select(vec![4_u64, 5, 6, 8, 10, 12, 20]);
    prop::collection::vec((period, 0_u8..=8, 0_u8..3, 0_u8..8), 1..10)
}

fn soft() -> impl Strategy<Value = Vec<(u64, u64)>> {
    prop::collection::vec((600_u64..9000, 500_u64..9000), 0..6)
}

#[test]
fn a_burst_is_counted_as_the_frames_that_come_at_once() {
    // One channel of 20 ms behind another one, of which 1, 2 or 3 events come at once: one frame more each.
    let bound = |burst: u8| {
        let text = format!(
            "[segment]\nname = 's'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '5 us'\nrelease_jitter = '5 us'\n\
             sync_period = '0 s'\n\
             [[node]]\nname = 'a'\nuid = 1\npublishes = ['slow']\n[[node]]\nname = 'b'\nuid = 2\npublishes = ['alarm']\n\
             [[channel]]\nname = 'slow'\nsubject = 1\nclass = 'SRT'\nlength = 8\nperiod = '20 ms'\ndeadline = '10 ms'\n\
             [[channel]]\nname = 'alarm'\nsubject = 2\nclass = 'SRT'\nlength = 8\nmin_interarrival = '50 ms'\n\
             burst = {burst}\ndeadline = '5 ms'\n"
        );
        let cluster =
            Cluster::read(&Source::new("burst.toml", text)).unwrap_or_else(|problems| panic!("{problems}"));
        let plan = plan(&cluster, &Effort::of(STEPS)).unwrap();
        assess(&cluster, &plan).channels[0].proof.bound.unwrap().as_micros()
    };
    assert_eq!([1, 2, 3].map(bound), [480, 640, 800]);
}

const STEPS: u64 = 2_000_000_000;

/// The cluster without one of its channels.
fn without(cluster: &Cluster, gone: usize) -> Cluster {
    let mut fewer = cluster.clone();
    for node in &mut fewer.nodes {
        node.publishes.retain(|channel| *channel != gone);
    }
    for channel in &mut fewer.channels {
        if let PlannedClass::Hard { wishes, .. } = &mut channel.class {
            wishes.after = wishes.after.filter(|after| after.channel != gone);
        }
    }
    fewer
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_calendar_passes_both_independent_checks(hard in hard()) {
        let cluster = cluster(&hard, &[]);
        if let Ok(plan) = plan(&cluster, &Effort::of(STEPS)) {
            prop_assert_eq!(verify(&cluster, &plan), Ok(()));
            prop_assert!(plan.calendar().is_ok(), "{:?}", plan.calendar());
        }
    }

    #[test]
    fn the_independent_check_sees_every_deviation(hard in hard(), which in any::<prop::sample::Index>()) {
        prop_assume!(!hard.is_empty());
        let cluster = cluster(&hard, &[]);
        let at = which.index(hard.len());
        let Ok(plan) = plan(&cluster, &Effort::of(STEPS)) else { return Ok(()) };
        // The plan of this cluster is none for a cluster that asks for more.
        let more_faults = cluster.with_omission_degree(at, 200);
        prop_assert!(verify(&more_faults, &plan).is_err());
        let twice_as_often = cluster.with_period(at, cluster.channels[at].recurrence.span() / 2);
        prop_assert!(verify(&twice_as_often, &plan).is_err());
        let mut moved = cluster.clone();
        let phase = plan.slots().iter().find(|slot| slot.channel == at).map(|slot| slot.slot.phase);
        if let PlannedClass::Hard { wishes, .. } = &mut moved.channels[at].class {
            wishes.phase = phase.map(|phase| phase + cosmic_core::time::Duration::from_micros(1));
        }
        // A slot that may be off its rhythm is not where it should be only beyond that.
        prop_assert!(!cluster.channels[at].jitter.is_zero() || verify(&moved, &plan).is_err());
        let mut hurried = cluster.clone();
        hurried.channels[at].deadline = Some(cosmic_core::time::Duration::from_micros(1));
        prop_assert!(verify(&hurried, &plan).is_err());
    }

    #[test]
    fn what_holds_at_some_load_holds_at_a_lower_one(hard in hard(), soft in soft(), which in any::<prop::sample::Index>()) {
        // Placing single occurrences can take longer than a test has; that is no property of the set.
        let hard: Vec<_> = hard.into_iter().map(|(t, s, k, wish)| (t, s, k, if wish == 3 { 7 } else { wish })).collect();
        let cluster = cluster(&hard, &soft);
        let holds = |cluster: &Cluster| {
            plan(cluster, &Effort::of(STEPS)).is_ok_and(|plan| assess(cluster, &plan).holds())
        };
        // Without a hard channel the other slots may stand elsewhere, and so may what soft frames meet: that a
        // calendar exists is asked of hard channels, that every bound holds of soft ones.
        let plannable = |cluster: &Cluster| !matches!(plan(cluster, &Effort::of(STEPS)), Err(NoPlan::Impossible(_) | NoPlan::GaveUp { .. }));
        if plannable(&cluster) && !hard.is_empty() {
            let gone = which.index(hard.len());
            prop_assert!(plannable(&without(&cluster, gone)));
            prop_assert!(plannable(&cluster.with_omission_degree(gone, 0)));
        }
        if holds(&cluster) && !soft.is_empty() {
            let gone = hard.len() + which.index(soft.len());
            prop_assert!(holds(&without(&cluster, gone)));
            let span = cluster.channels[gone].recurrence.span();
            prop_assert!(holds(&cluster.with_period(gone, span * 2)));
            let mut shorter = cluster.clone();
            shorter.channels[gone].length = 0;
            prop_assert!(holds(&shorter));
            let mut patient = cluster.clone();
            patient.channels[gone].deadline = patient.channels[gone].deadline.map(|deadline| deadline * 2);
            prop_assert!(holds(&patient));
        }
    }

    #[test]
    fn a_contradiction_is_small_and_real(hard in hard()) {
        let cluster = cluster(&hard, &[]);
        let Err(NoPlan::Impossible(conflict)) = plan(&cluster, &Effort::of(STEPS)) else { return Ok(()) };
        prop_assert!(!conflict.constraints.is_empty());
        // Without all channels that are not in it, it is still impossible.
        let mut only = cluster.clone();
        for channel in (0..cluster.channels.len()).filter(|c| !conflict.channels.contains(c)) {
            only = without(&only, channel);
        }
        prop_assert!(matches!(plan(&only, &Effort::of(STEPS)), Err(NoPlan::Impossible(_))));
        // Without any one of its channels, the rest of it can be planned.
        if conflict.minimal && conflict.channels.len() == conflict.constraints.len() {
            for channel in &conflict.channels {
                prop_assert!(plan(&without(&only, *channel), &Effort::of(STEPS)).is_ok());
            }
        }
    }
}
