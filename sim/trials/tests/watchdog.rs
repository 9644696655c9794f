//! Nodes that hang: the watchdog resets them, they take part again by themselves, and they say why.

use std::collections::BTreeSet;

use cosmic_core::can::Priority;
use cosmic_core::protocol::NodeState;
use cosmic_emu::{NodeConfig, ResetCause};
use cosmic_trials::Trial;
use fugit::RateExtU32 as _;

/// A misdeed is committed one to two seconds after the start.
const END: u64 = 4_000;
/// By the plan.
const MASTER: u8 = 1;
const WORKER: u8 = 3;

/// Runs the cluster, in which one node does something wrong, and returns the millisecond of its reset.
fn run(culprit: &str, misdeed: u8) -> (Trial, u64) {
    let of = |name| (name, if name == culprit { misdeed } else { 0 });
    let mut trial = Trial::new(&[of("master"), of("deputy"), of("worker"), of("guest")]);
    trial.run_until(END);
    let innocent = trial.nodes.iter().map(|(name, _)| *name).filter(|name| *name != culprit);
    innocent.for_each(|name| assert_eq!(trial.resets(name), [], "{name}"));
    let resets = trial.resets(culprit);
    let [(at, ResetCause::Watchdog)] = resets.as_slice() else {
        panic!("{resets:?}: {:#?}", trial.log(culprit, 0))
    };
    let at = *at;
    (trial, at)
}

/// The milliseconds in which hard real-time frames of the worker were sent, from one on.
fn beats(trial: &Trial, from: u64) -> Vec<u64> {
    trial.frames(from).filter(|(_, frame)| frame.id.priority() == Priority::HARD).map(|(at, _)| at).collect()
}

/// From the reset on the worker beats within a second and a half, in every slot but `unused`, and all are well.
fn goes_on(trial: &Trial, reset: u64, unused: usize) {
    let beats = beats(trial, reset + 2);
    assert!(beats.first().is_some_and(|first| *first < reset + 1_500), "{beats:?}");
    let steady: Vec<_> = beats.windows(2).skip(1).map(|pair| pair[1] - pair[0]).collect();
    let gaps = steady.iter().filter(|gap| !(9..=11).contains(*gap));
    assert!(steady.len() > 50 && gaps.clone().all(|gap| (19..=21).contains(gap)), "{steady:?}");
    assert_eq!(gaps.count(), unused, "{steady:?}");
    let later = trial.statuses(END - 1_100);
    let states: Vec<_> = later.map(|(_, status)| (status.tx_node, status.state)).collect();
    assert!(
        states.len() >= 4 && states.iter().all(|(_, state)| *state == NodeState::Operational),
        "{states:?}"
    );
}

/// What the statuses of a node of the plan say of its starts, each cause once.
fn causes(trial: &Trial, tx_node: u8) -> BTreeSet<&'static str> {
    let of_node = trial.statuses(0).filter(|(_, status)| status.tx_node.get() == tx_node);
    of_node.map(|(_, status)| status.reset_cause.name()).collect()
}

#[test]
fn a_worker_that_hangs_is_reset_and_takes_part_again() {
    for misdeed in [b'W', b'S', b'L', b'M', b'F'] {
        let (trial, reset) = run("worker", misdeed);
        let name = char::from(misdeed);
        // Patience is 100 ms at 47 kHz, so 147 ms at 32 kHz; it was fed 20 ms before at most.
        let hung = trial.log("worker", 0).into_iter().find(|(_, line)| line.contains("misbehaves"));
        let (hung, _) = hung.unwrap_or_else(|| panic!("{name}: {:#?}", trial.log("worker", 0)));
        assert!((100..=300).contains(&(reset - hung)), "{name}: hung at {hung}, reset at {reset}");
        goes_on(&trial, reset, 0);
        assert!(trial.said("worker", "started by Watchdog", reset), "{name}");
        assert_eq!(causes(&trial, WORKER), BTreeSet::from(["power-on", "watchdog"]), "{name}");
        assert_eq!(causes(&trial, MASTER), BTreeSet::from(["power-on"]), "{name}");
        let odd: Vec<_> =
            trial.oddities().into_iter().filter(|odd| misdeed != b'F' || !odd.contains("stopped")).collect();
        assert_eq!(odd, Vec::<String>::new(), "{name}");
    }
}

#[test]
fn a_stack_that_outgrows_its_place_is_stopped_at_its_end() {
    let (trial, reset) = run("worker", b'O');
    // It lies at the lower end of RAM, so nothing was overwritten: see memory.x.
    let odd = trial.oddities();
    let [stopped] = odd.as_slice() else { panic!("{odd:#?}") };
    let hole = "stopped by write of unmapped or protected address 0x1ffff";
    assert!(stopped.starts_with("worker") && stopped.contains(hole), "{stopped}");
    goes_on(&trial, reset, 0);
    assert!(trial.said("worker", "started by Watchdog", reset));
}

#[test]
fn what_a_node_knew_before_its_reset_it_tells_after_it() {
    // The application waits for ever, and its slots pass unused: the others of its tasks go on until the reset.
    let (trial, reset) = run("worker", b'W');
    let told = trial.log("worker", reset).into_iter().filter(|(_, line)| line.contains("before that"));
    let told: Vec<_> = told.collect();
    assert_eq!(told.len(), 8, "{told:#?}");
    assert!(told.iter().all(|(_, line)| line.contains("NothingPublished")), "{told:#?}");
}

#[test]
fn silence_and_a_fast_or_slow_oscillator_are_no_reason_for_a_reset() {
    // Alone nobody acknowledges, there is no time, and no broker.
    let mut alone = Trial::new(&[("guest", 0)]);
    alone.run_until(1_500);
    assert_eq!((alone.resets("guest"), alone.oddities()), (vec![], vec![]));
    for kilohertz in [17, 47] {
        let change = |config: &mut NodeConfig| config.low_speed = kilohertz.kHz();
        let mut trial = Trial::with(&[("master", 0), ("worker", 0)], change);
        trial.run_until(1_500);
        assert_eq!((trial.resets("master"), trial.resets("worker")), (vec![], vec![]), "{kilohertz} kHz");
        assert!(trial.said("master", "beats", 900), "{kilohertz} kHz");
    }
}

#[test]
fn a_time_master_and_broker_that_hangs_is_stood_in_for_and_comes_back() {
    let (trial, reset) = run("master", b'M');
    // The deputy has taken over: the worker went on meanwhile.
    let meanwhile = beats(&trial, reset - 100).iter().filter(|at| **at < reset).count();
    assert!(meanwhile >= 8, "{meanwhile} beats while the master hung");
    // Once the worker's bound of the clock is exceeded, when the deputy begins a time of its own: and it says so.
    goes_on(&trial, reset, 1);
    assert!(trial.said("worker", "ClockOutOfBound", reset - 500));
    assert!(trial.said("master", "started by Watchdog", reset));
    assert_eq!(trial.oddities(), Vec::<String>::new());
}
