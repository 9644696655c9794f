//! bxCAN of several nodes on one bus.

mod support;

use cosmic_bus::trace::TraceKind;
use cosmic_bus::{BitPosition, Bus, Chance, Fault, FaultModel, Filter, Rule};
use cosmic_core::can::{BitRate, Etag, Id, Priority, TxNode};
use cosmic_emu::{BackgroundLoad, ClockError, Cluster, NodeConfig, Observation, ObservationKind};
use embedded_can::Frame as _;
use support::register::{CAN1, GPIOA_ODR};
use support::{HSI_PERIOD_NS, Program, edges, instant, order, quiet_bus};

const RX0: u32 = 20;
const RX0_VECTOR: u32 = 16 + RX0;

/// Shows the low half of each received word on port A and releases the message.
fn receiver() -> Program {
    let mut program = Program::default();
    program.handler(RX0_VECTOR, |asm| {
        asm.show(CAN1 + 0x1B8).write(CAN1 + 0x0C, 1 << 5);
    });
    program.main(|asm| {
        asm.set_up().start_can().write(CAN1 + 0x14, 1 << 1).enable_interrupt(RX0, 0).sleep();
    });
    program
}

/// Joins the bus, does what `code` says, and sleeps.
fn sender(code: impl FnOnce(&mut Program)) -> Program {
    let mut program = Program::default();
    program.main(|asm| {
        asm.set_up().start_can();
        code(asm);
        asm.sleep();
    });
    program
}

fn cluster(bus: Bus, programs: &[&Program]) -> Cluster {
    let mut cluster = Cluster::new(bus);
    cluster.bus_mut().record_trace(true);
    for (n, program) in programs.iter().enumerate() {
        let config = program.node(&format!("node {n}"));
        cluster.add_node(config).unwrap_or_else(|error| panic!("{error}"));
    }
    cluster
}

fn starts(cluster: &mut Cluster) -> Vec<(u32, u32)> {
    let mut trace = Vec::new();
    cluster.bus_mut().take_trace(&mut trace);
    let start = |kind: &TraceKind| match kind {
        TraceKind::FrameStart { frame, attempt, .. } => Some((frame.arbitration().raw_id(), *attempt)),
        _ => None,
    };
    trace.iter().filter_map(|event| start(&event.kind)).collect()
}

#[test]
fn a_frame_goes_from_node_to_node() {
    let sender = sender(|asm| {
        // Time to let the receiver join.
        asm.load(4, 2000).halves(&[0x3C01, 0xD1FD]); // subs r4, #1; bne
        asm.send(0, 0x123_4567, 0x55AA);
        asm.poll(CAN1 + 8, 3, 3).set(31 - 16); // RQCP, TXOK
    });
    let mut cluster = cluster(quiet_bus(), &[&sender, &receiver()]);
    cluster.run_until(instant(2000));
    let seen = cluster.take_observations();
    let received: Vec<_> = seen.iter().filter(|seen| seen.node.index() == 1).cloned().collect();
    let edges = edges(&received);
    assert_eq!(edges.iter().fold(0, |pins, (_, pin, _)| pins | 1_u32 << pin), 0x55AA);
    assert_eq!(seen.iter().filter(|seen| seen.node.index() == 0).count(), 1);

    let mut trace = Vec::new();
    cluster.bus_mut().take_trace(&mut trace);
    let start = trace.iter().find_map(|event| match event.kind {
        TraceKind::FrameStart { frame, .. } => Some((event.at, frame)),
        _ => None,
    });
    let Some((start, frame)) = start else { panic!("{trace:?}") };
    assert_eq!((frame.arbitration().raw_id(), frame.data()), (0x123_4567, &[0xAA, 0x55, 0, 0][..]));
    // Received one bit before the end of the frame; entry 12 cycles; the handler's instructions up to the
    // store take 2 + 2 + 2 + 1; the frame may end within a cycle.
    let received = (start.as_ticks() + u64::from(frame.bit_count() - 1) * 1000) as f64;
    let latency = (edges[0].0 as f64 - received) / HSI_PERIOD_NS;
    assert!((18.9..20.0).contains(&latency), "{latency}");
}

#[test]
fn a_pending_frame_can_be_aborted_and_one_on_the_wire_completes() {
    let sender = sender(|asm| {
        asm.load(4, 2000).halves(&[0x3C01, 0xD1FD]);
        asm.send(0, 1, 0).send(1, 2, 0);
        asm.write(CAN1 + 8, 1 << 15 | 1 << 7); // ABRQ1, ABRQ0
        asm.show(CAN1 + 8); // at once: 1 is withdrawn, 0 is not yet
        asm.poll(CAN1 + 8, 1, 1).load(4, 0x10).show(CAN1 + 8);
    });
    let mut cluster = cluster(quiet_bus(), &[&sender, &receiver()]);
    cluster.run_until(instant(2000));
    let seen: Vec<_> =
        cluster.take_observations().into_iter().filter(|seen| seen.node.index() == 0).collect();
    // First RQCP1 (8) alone of the low half, with ABRQ0 (7); then RQCP0 and TXOK0, and ABRQ0 is clear.
    assert_eq!(order(&seen), [(7, true), (8, true), (0, true), (1, true), (7, false)]);
    assert_eq!(starts(&mut cluster), [(1, 1)]);
}

#[test]
fn a_full_fifo_reports_the_overrun() {
    let sender = sender(|asm| {
        asm.load(4, 2000).halves(&[0x3C01, 0xD1FD]);
        for number in 0..5 {
            asm.send(0, number, number).poll(CAN1 + 8, 1 << 26, 1 << 26);
        }
    });
    let mut deaf = Program::default();
    deaf.main(|asm| {
        asm.set_up().start_can().load(4, 8000).halves(&[0x3C01, 0xD1FD]);
        asm.show(CAN1 + 0x0C).sleep();
    });
    let mut cluster = cluster(quiet_bus(), &[&sender, &deaf]);
    cluster.run_until(instant(3000));
    // Three messages, FULL, FOVR.
    let expected = [(0, true), (1, true), (3, true), (4, true)];
    assert_eq!(order(&cluster.take_observations()), expected);
    assert_eq!(starts(&mut cluster).len(), 5);
}

#[test]
fn a_destroyed_frame_is_sent_again_and_counted() {
    let sender = sender(|asm| {
        asm.load(4, 2000).halves(&[0x3C01, 0xD1FD]);
        asm.send(2, 7, 0).poll(CAN1 + 8, 1 << 16, 1 << 16);
        // The high half of ESR: ldr r1, [r0]; lsrs r1, #16; str
        asm.load(0, CAN1 + 0x18).halves(&[0x6801, 0x0C09]).load(0, GPIOA_ODR).half(0x6001);
    });
    let fault = Fault::Inverted(BitPosition::FromStart(40));
    let rule = Rule { frames: Filter::ANY, skip: 0, count: 2, fault };
    let bus = Bus::new(BitRate::MAX, FaultModel::none().with_rule(rule));
    let mut cluster = cluster(bus, &[&sender, &receiver()]);
    cluster.run_until(instant(2000));
    assert_eq!(starts(&mut cluster), [(7, 1), (7, 2), (7, 3)]);
    let seen: Vec<_> =
        cluster.take_observations().into_iter().filter(|seen| seen.node.index() == 0).collect();
    // TEC: 2 * 8 - 1.
    assert_eq!(order(&seen), [(0, true), (1, true), (2, true), (3, true)]);
}

#[test]
fn a_node_with_another_bit_rate_stays_off_the_bus() {
    let mut cluster = cluster(Bus::new(BitRate::new(500_000).unwrap(), FaultModel::none()), &[&receiver()]);
    cluster.run_until(instant(500));
    let seen = cluster.take_observations();
    let [only] = &seen[..] else { panic!("{seen:?}") };
    assert_eq!(only.kind, ObservationKind::WrongBitRate { bits_per_second: 1_000_000 });
}

/// Three drifting nodes under load and errors.
fn random_run(seed: u64, step: u64) -> (Vec<Observation>, String) {
    let chance = Chance::new(0.02).unwrap();
    let bus = Bus::new(BitRate::MAX, FaultModel::seeded(seed).with_inversion(chance));
    let mut cluster = Cluster::new(bus);
    cluster.bus_mut().record_trace(true);
    let talker = sender(|asm| {
        asm.load(4, 100).halves(&[0x3C01, 0xD1FD]);
        let start = asm.here();
        asm.send(0, 0x100, 0xFFFF).send(1, 0x10, 0x0F0F).write(CAN1 + 8, 1 << 7);
        asm.poll(CAN1 + 8, 3 << 26, 3 << 26).write(CAN1 + 8, 0x0101);
        let back = (start as i32 - asm.here() as i32 - 4) / 2;
        asm.half(0xE000 | (back as u16 & 0x7FF));
    });
    let programs = [talker, receiver(), receiver()];
    for (n, program) in programs.iter().enumerate() {
        let config = NodeConfig {
            clock_error: ClockError::parts_per_million(30 * n as i32 - 30).unwrap(),
            start_at: instant(77 * n as u64),
            ..program.node(&format!("node {n}"))
        };
        cluster.add_node(config).unwrap_or_else(|error| panic!("{error}"));
    }
    let ids = vec![Id::new(Priority::LEAST, TxNode::MAX, Etag::BOUND_LAST)];
    let load = BackgroundLoad::new(cluster.bus(), 30, ids, seed).unwrap();
    cluster.add_station("load", Box::new(load));
    let mut now = 0;
    let mut seen = Vec::new();
    while now < 30_000 {
        now += step;
        cluster.run_until(instant(now));
        seen.extend(cluster.take_observations());
    }
    let mut trace = Vec::new();
    cluster.bus_mut().take_trace(&mut trace);
    (seen, format!("{trace:?}"))
}

#[test]
fn one_seed_gives_one_trace_byte_for_byte() {
    let first = random_run(7, 30_000);
    assert!(first.0.len() > 100 && first.1.len() > 10_000);
    assert_eq!(random_run(7, 30_000), first);
    assert_ne!(random_run(8, 30_000), first);
}

#[test]
fn how_often_the_cluster_is_stopped_makes_no_difference() {
    let (seen, trace) = random_run(3, 30_000);
    let (seen_in_steps, trace_in_steps) = random_run(3, 50);
    assert_eq!(trace_in_steps, trace);
    assert_eq!(seen_in_steps, seen);
}
