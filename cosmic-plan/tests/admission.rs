//! Admission at run time against the analysis, over random sequences of announcements and withdrawals: what a node
//! admits, the analysis of the same set accepts; and it admits nearly all that the analysis accepts.

use cosmic_core::admission::{Admission, Ask, NotAdmitted, Objection, OtherChannel};
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::EventRate;
use cosmic_core::time::{Duration, Instant};
use cosmic_plan::analysis::reserved::Reserved;
use cosmic_plan::analysis::segment::assess;
use cosmic_plan::cluster::{Channel, Cluster, Recurrence};
use cosmic_plan::document::Source;
use cosmic_plan::plan::{Effort, Plan, plan};
use proptest::prelude::RngExt as _;
use proptest::test_runner::{RngAlgorithm, TestRng as Random};
use std::fmt::Write as _;

const LEASE: Duration = Duration::from_secs(10);
const MOST: usize = 40;

/// A planned segment that holds: some hard channels, some soft ones, a non real-time one with a deadline now and then.
fn planned(random: &mut Random) -> Option<(Cluster, Plan)> {
    let rate = [125, 250, 500, 1000][random.random_range(0..4)];
    let scale = 1000 / rate;
    let mut text = format!(
        "[segment]\nname = 's'\nbit_rate = '{rate} kbit/s'\nclock_accuracy = '50 us'\nrelease_jitter = '10 us'\n\
         slow_refill = {}\n",
        random.random_bool(0.1)
    );
    match random.random_range(0..3) {
        0 => text += "[errors]\nburst = 2\ninterval = '50 ms'\n",
        1 => text += "[errors]\ncount = 1\nwindow = '40 ms'\n",
        _ => {}
    }
    let (hard, soft, low) = (random.random_range(0..4), random.random_range(1..6), random.random_range(0..2));
    let names: Vec<String> = (0..hard + soft + low).map(|at| format!("'c{at}'")).collect();
    writeln!(text, "[[node]]\nname = 'n'\nuid = 1\npublishes = [{}]", names.join(", ")).ok()?;
    for at in 0..hard + soft + low {
        let (name, subject, len) = (format!("c{at}"), at + 1, random.random_range(0..9));
        write!(text, "[[channel]]\nname = '{name}'\nsubject = {subject}\nlength = {len}\n").ok()?;
        if at < hard {
            writeln!(text, "class = 'HRT'\nperiod = '{} ms'", 20 * scale).ok()?;
        } else if at < hard + soft {
            let period = random.random_range(3..20) * scale;
            let (jitter, deadline) =
                (random.random_range(0..800) * scale, random.random_range(2..60) * scale);
            writeln!(
                text,
                "class = 'SRT'\nmin_interarrival = '{period} ms'\nburst = {}",
                random.random_range(1..3)
            )
            .ok()?;
            writeln!(text, "jitter = '{jitter} us'\ndeadline = '{deadline} ms'").ok()?;
        } else {
            writeln!(
                text,
                "class = 'NRT'\nmin_interarrival = '{} ms'\ndeadline = '{} ms'",
                60 * scale,
                40 * scale
            )
            .ok()?;
        }
    }
    let cluster =
        Cluster::read(&Source::new("random.toml", text)).unwrap_or_else(|problems| panic!("{problems}"));
    let plan = plan(&cluster, &Effort::default()).ok()?;
    assess(&cluster, &plan).holds().then_some((cluster, plan))
}

fn ask(random: &mut Random, scale: u64) -> Ask {
    let interval = Duration::from_micros(random.random_range(1_000..12_000) * scale);
    let jitter = Duration::from_micros(random.random_range(0..1_000) * scale);
    let rate = EventRate::sporadic(interval).with_burst(random.random_range(1..4)).with_jitter(jitter);
    Ask {
        tx_node: TxNode::new(random.random_range(2..8)).unwrap(),
        etag: Etag::new(random.random_range(1100..1140)).unwrap(),
        rate,
        deadline: Duration::from_micros(random.random_range(500..12_000) * scale),
        len: random.random_range(0..9),
    }
}

/// The cluster with these channels in its file.
fn with<'a>(cluster: &Cluster, asks: impl Iterator<Item = &'a Ask>) -> Cluster {
    let mut all = cluster.clone();
    let like = all
        .channels
        .iter()
        .find(|channel| channel.class == cosmic_plan::cluster::PlannedClass::Soft)
        .unwrap()
        .clone();
    for ask in asks {
        all.nodes[0].publishes.push(all.channels.len());
        all.channels.push(Channel {
            name: format!("asked{}", all.channels.len()),
            subject: ask.etag.get().into(),
            etag: None,
            length: ask.len.into(),
            recurrence: Recurrence::Sporadic(ask.rate.interval()),
            burst: 1,
            jitter: ask.rate.tolerance(),
            deadline: Some(ask.deadline),
            ..like.clone()
        });
    }
    all
}

#[derive(Default, Debug)]
struct Counts {
    asked: u32,
    /// By the analysis.
    acceptable: u32,
    admitted: u32,
    /// Refused with an interval at which it would fit.
    advised: u32,
    /// Refused, because another channel would suffer, or a less urgent frame.
    suffers: u32,
    less_urgent: u32,
}

fn sequence(seed: u64, counts: &mut Counts) {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let mut random = Random::from_seed(RngAlgorithm::ChaCha, &bytes);
    let Some((cluster, plan)) = planned(&mut random) else { return };
    let reserved = Reserved::of(&cluster, &plan);
    let reservations = reserved.reservations();
    let mut admission = Admission::<'_, MOST>::new(&reservations);
    let scale = 1_000_000 / u64::from(cluster.segment.bit_rate.bits_per_second());
    for step in 0..random.random_range(5..50_u64) {
        let now = Instant::from_epoch(Duration::from_millis(step));
        if random.random_bool(0.25) {
            let admitted: Vec<Ask> = admission.admitted().map(|admitted| admitted.ask).collect();
            if let Some(gone) = admitted.get(random.random_range(0..MOST)) {
                assert!(admission.withdraw(gone.tx_node, gone.etag));
            }
            continue;
        }
        let new = ask(&mut random, scale);
        let is_it = |other: &&Ask| (other.tx_node, other.etag) == (new.tx_node, new.etag);
        let others: Vec<Ask> = admission.admitted().map(|admitted| admitted.ask).collect();
        let others: Vec<&Ask> = others.iter().filter(|other| !is_it(other)).collect();
        let holds = |last: &Ask| assess(&with(&cluster, others.iter().copied().chain([last])), &plan).holds();
        let acceptable = holds(&new);
        counts.asked += 1;
        counts.acceptable += u32::from(acceptable);
        let answer = admission.ask(now, &new, LEASE);
        match answer.map_err(|refused| refused.why) {
            Err(Objection::Suffers(other)) => {
                assert!(match other {
                    OtherChannel::Planned(subject) => {
                        reservations.soft.iter().any(|soft| soft.subject == subject)
                    }
                    OtherChannel::Admitted(etag) => others.iter().any(|other| other.etag == etag),
                });
                counts.suffers += 1;
            }
            Err(Objection::LessUrgent(_)) => counts.less_urgent += 1,
            _ => {}
        }
        match answer {
            Ok(()) => {
                counts.admitted += 1;
                assert!(acceptable, "seed {seed}, step {step}: {new:?} beside {others:?}");
            }
            Err(NotAdmitted { fits_at: Some(interval), .. }) => {
                counts.advised += 1;
                let rate = EventRate::sporadic(interval).with_jitter(new.rate.tolerance());
                let advised = Ask { rate, ..new };
                assert!(holds(&advised), "seed {seed}, step {step}: the advice for {new:?} does not hold");
                if random.random_bool(0.5) {
                    assert_eq!(admission.ask(now, &advised, LEASE), Ok(()));
                }
            }
            Err(_) => {}
        }
    }
}

/// Sequences: `COSMIC_RUNS=n` looks at more.
fn runs() -> u64 {
    std::env::var("COSMIC_RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(1_000)
}

#[test]
fn what_is_admitted_the_analysis_accepts_and_nearly_all_of_that_is_admitted() {
    let mut counts = Counts::default();
    for seed in 1..=runs() {
        sequence(seed, &mut counts);
    }
    println!("{counts:?}");
    assert!(counts.asked > 3 * runs() as u32, "{counts:?}");
    assert!(u64::from(counts.admitted) * 100 >= u64::from(counts.acceptable) * 90, "{counts:?}");
    assert!(counts.advised > 0 && counts.suffers > 0 && counts.less_urgent > 0, "{counts:?}");
}

/// Two planned channels of 2 ms in 10 ms at 1 Mbit/s, and nothing else.
fn two() -> Reserved {
    let text = "[segment]\nname = 's'\nbit_rate = '1 Mbit/s'\nclock_accuracy = '5 us'\nrelease_jitter = '10 us'\n\
                sync_period = '0 s'\n[[node]]\nname = 'n'\nuid = 1\npublishes = ['a', 'b']\n[[channel]]\nname = 'a'\n\
                subject = 1\nclass = 'SRT'\nlength = 8\nperiod = '10 ms'\ndeadline = '2 ms'\n\
                [[channel]]\nname = 'b'\nsubject = 2\nclass = 'SRT'\nlength = 8\nperiod = '10 ms'\ndeadline = '2 ms'\n";
    let cluster = Cluster::read(&Source::new("lone.toml", text)).unwrap();
    let plan = plan(&cluster, &Effort::default()).unwrap();
    Reserved::of(&cluster, &plan)
}

#[test]
fn a_refusal_says_why_and_what_would_fit() {
    let reserved = two();
    let reservations = reserved.reservations();
    let mut admission = Admission::<'_, 2>::new(&reservations);
    let of = |number: u16, rate, deadline| Ask {
        tx_node: TxNode::new(2).unwrap(),
        etag: Etag::new(1100 + number).unwrap(),
        rate,
        deadline: Duration::from_micros(deadline),
        len: 8,
    };
    let every = |microseconds| EventRate::sporadic(Duration::from_micros(microseconds));
    let now = Instant::EPOCH;
    let why = |refused: Result<(), NotAdmitted>| refused.unwrap_err().why;
    // A frame every 150 us takes more than the bus has; one that must be sent within 300 us may wait for one of 160.
    let busy = of(7, every(150), 1_000);
    let refused = admission.ask(now, &busy, LEASE).unwrap_err();
    assert_eq!(refused.why, Objection::Utilisation);
    assert_eq!(why(admission.ask(now, &of(7, every(9_000), 300), LEASE)), Objection::Blocking);
    // Ten at once, and the two planned ones may go before the last of them.
    let burst = of(7, every(50_000).with_burst(10), 1_820);
    assert_eq!(why(admission.ask(now, &burst, LEASE)), Objection::Late);
    // What would fit fits.
    let advised = Ask { rate: every(refused.fits_at.unwrap().as_micros() + 1), ..busy };
    assert_eq!(admission.ask(now, &advised, LEASE), Ok(()));
    assert_eq!(admission.ask(now, &of(8, every(90_000), 9_000), LEASE), Ok(()));
    assert_eq!(why(admission.ask(now, &of(9, every(90_000), 9_000), LEASE)), Objection::Full);
    // Asked for again, it goes on; with the lease it ends.
    let later = now + Duration::from_secs(6);
    assert_eq!(admission.ask(later, &advised, LEASE), Ok(()));
    assert_eq!(admission.next_wakeup(), now + LEASE);
    assert_eq!(admission.ask(now + LEASE, &of(9, every(90_000), 9_000), LEASE), Ok(()), "8 has ended");
    let left: Vec<u16> = admission.admitted().map(|admitted| admitted.ask.etag.get()).collect();
    assert_eq!(left, [1107, 1109]);
    assert!(admission.withdraw(advised.tx_node, advised.etag));
    assert!(!admission.withdraw(advised.tx_node, advised.etag), "it is gone");
}
