//! Resets of a part whose power stays on: what brings them, what they leave, and what they say.

mod support;

use cosmic_emu::{Cluster, Observation, ObservationKind, ResetCause, StopReason};
use fugit::RateExtU32 as _;
use support::{Program, instant, quiet_bus, run};

const IWDG: u32 = 0x4000_3000;
const CSR: u32 = 0x4002_3874;
/// A word that the program counts its starts in.
const STARTS: u32 = support::RAM + 0x4000;

/// Starts the watchdog with a period of 2 ms at 32 kHz: 16 times 4 periods.
fn guarded(asm: &mut Program) -> &mut Program {
    asm.write(IWDG, 0x5555).write(IWDG + 8, 15).write(IWDG, 0xCCCC)
}

/// Shows the flags of the resets on the pins PA0 to PA7, and removes them.
fn tells_cause(asm: &mut Program) -> &mut Program {
    // ldr r1, [r0]; lsrs r1, #24; str r1, [r0]
    asm.load(0, CSR).halves(&[0x6801, 0x0E09]).load(0, support::register::GPIOA_ODR).half(0x6001);
    asm.write(CSR, 1 << 24).write(support::register::GPIOA_ODR, 0)
}

fn resets(seen: &[Observation]) -> Vec<(u64, ResetCause)> {
    let reset = |seen: &Observation| match seen.kind {
        ObservationKind::Reset(cause) => Some((seen.at.as_ticks() / 1000, cause)),
        _ => None,
    };
    seen.iter().filter_map(reset).collect()
}

/// The pins that were high at some time in each life of the node.
fn told(seen: &[Observation]) -> Vec<u32> {
    let mut lives = vec![0];
    for seen in seen {
        match seen.kind {
            ObservationKind::Pin { pin, level: true, .. } => {
                *lives.last_mut().unwrap() |= 1 << pin.number;
            }
            ObservationKind::Reset(_) => lives.push(0),
            _ => {}
        }
    }
    lives
}

#[test]
fn a_watchdog_that_is_not_fed_resets_a_node_asleep_busy_or_stopped() {
    type Ending = (&'static str, fn(&mut Program));
    let ends: [Ending; 3] = [
        ("asleep", |asm| {
            asm.sleep();
        }),
        ("busy", |asm| {
            asm.half(0xE7FE); // b to itself
        }),
        ("stopped by a fault", |asm| {
            asm.half(0xDE00); // udf
        }),
    ];
    for (name, end) in ends {
        let mut program = Program::default();
        program.main(|asm| {
            tells_cause(guarded(asm.set_up()));
            end(asm);
        });
        let seen = run(&program, 7000);
        let resets = resets(&seen);
        let causes: Vec<_> = resets.iter().map(|(_, cause)| *cause).collect();
        assert_eq!(causes, [ResetCause::Watchdog; 3], "{name}: {seen:?}");
        assert!((2000..2010).contains(&resets[0].0), "{name}: {resets:?}");
        // After power-on POR, BOR and PIN; after the watchdog IWDG and PIN.
        assert_eq!(told(&seen), [0x0E, 0x24, 0x24, 0x24], "{name}");
    }
}

#[test]
fn one_that_is_fed_in_time_never_does_unless_its_oscillator_is_too_fast() {
    let mut program = Program::default();
    program.main(|asm| {
        guarded(asm.set_up());
        let start = asm.here();
        // 1.9 ms: 7 600 turns of 4 cycles at 16 MHz.
        asm.load(4, 7_600).halves(&[0x3C01, 0xD1FD]).write(IWDG, 0xAAAA);
        let back = (start as i32 - asm.here() as i32 - 4) / 2;
        asm.half(0xE000 | (back as u16 & 0x7FF));
    });
    for (kilohertz, is_reset) in [(17, false), (32, false), (47, true)] {
        let mut cluster = Cluster::new(quiet_bus());
        let mut config = program.node("fed");
        config.low_speed = kilohertz.kHz();
        cluster.add_node(config).unwrap();
        cluster.run_until(instant(50_000));
        assert_eq!(!resets(&cluster.take_observations()).is_empty(), is_reset, "{kilohertz} kHz");
    }
}

#[test]
fn memory_outlives_a_reset_but_not_the_loss_of_power() {
    let mut program = Program::default();
    program.main(|asm| {
        // Counts its starts, and shows the number.
        asm.set_up().load(0, STARTS).halves(&[0x6801, 0x3101, 0x6001]).show(STARTS);
        guarded(asm).half(0xE7FE);
    });
    let mut cluster = Cluster::new(quiet_bus());
    let node = cluster.add_node(program.node("counts")).unwrap();
    cluster.run_until(instant(5000));
    cluster.restart(node);
    cluster.run_until(instant(8000));
    cluster.reset(node);
    cluster.run_until(instant(9000));
    assert_eq!(told(&cluster.take_observations()), [1, 2, 3 | 1, 2, 3]);
}

#[test]
fn a_node_without_power_stays_off_whatever_its_watchdog() {
    let mut program = Program::default();
    program.main(|asm| {
        guarded(asm).sleep();
    });
    let mut cluster = Cluster::new(quiet_bus());
    let node = cluster.add_node(program.node("off")).unwrap();
    cluster.run_until(instant(1000));
    cluster.power_off(node);
    cluster.run_until(instant(5000));
    cluster.reset(node);
    cluster.run_until(instant(9000));
    assert!(cluster.is_stopped(node));
    assert_eq!(cluster.take_observations(), []);
}

#[test]
fn a_fault_without_a_watchdog_is_the_end() {
    let mut program = Program::default();
    program.main(|asm| {
        asm.half(0xDE00);
    });
    let seen = run(&program, 100_000);
    let [only] = seen.as_slice() else { panic!("{seen:?}") };
    assert!(matches!(only.kind, ObservationKind::Stopped { reason: StopReason::Fault(_), .. }));
}
