//! Each rule of the doctor, with its fault seeded into a simulated cluster, which is healthy but for that.

mod bed;

use bed::{Bed, Changes, ROVER, channel_named};
use cosmic_bus::{BitPosition, Fault, FaultModel, Filter, Rule as FaultRule};
use cosmic_core::NodeUid;
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::protocol::{Answer, BrokerStatus, NodeState, NodeStatus, SupplyEtag};
use cosmic_monitor::{Finding, Monitor, NodeView, Rule, Severity};
use embedded_can::ExtendedId;

/// The findings, once the cluster has run for so long with the fault in it.
fn after(mut bed: Bed, milliseconds: u64, mut each: impl FnMut(&mut Bed, u64)) -> Bed {
    for millisecond in 0..milliseconds {
        each(&mut bed, millisecond);
        bed.run(1);
    }
    bed
}

fn only(bed: &mut Bed, rule: Rule) -> Finding {
    let findings = bed.findings();
    let rules: Vec<Rule> = findings.iter().map(|finding| finding.rule).collect();
    assert_eq!(rules, [rule], "{findings:#?}");
    let finding = findings[0].clone();
    assert_eq!((finding.severity, finding.remedy), (rule.severity(), rule.remedy()));
    finding
}

fn healthy() -> Bed {
    let mut bed = Bed::rover().power_on();
    bed.run(2_000);
    assert_eq!(bed.rules(), []);
    bed
}

fn rover_with(changes: &Changes) -> Bed {
    let mut bed = Bed::new(ROVER, changes).power_on();
    bed.run(2_000);
    bed
}

fn number(bed: &Bed, name: &str) -> TxNode {
    bed.plan.cluster().nodes.iter().find(|node| node.name == name).unwrap().tx_node
}

#[test]
fn two_brokers() {
    let mut bed = rover_with(&Changes { brokers: vec![0, 3], ..Changes::default() });
    assert_eq!(bed.rules(), [], "one of them stands by");
    let other = TxNode::new(0x7A).unwrap();
    // A broker that does not hear the other one, and so does not yield.
    let heartbeat = BrokerStatus { tx_node: other, uid: NodeUid::MIN }.encode();
    // Ours would: so it stays with a higher UID.
    let last = BrokerStatus { uid: NodeUid::MAX, ..BrokerStatus::decode(&heartbeat).unwrap() }.encode();
    bed = after(bed, 2_000, |bed, ms| {
        if ms % 250 == 0 {
            bed.send(bed.stranger, last)
        }
    });
    let finding = only(&mut bed, Rule::TwoBrokers);
    assert!(finding.nodes.contains(&other.get()) && finding.nodes.len() == 2, "{finding}");
    bed.run(4_000);
    assert!(!bed.rules().contains(&Rule::TwoBrokers), "it has gone");
}

#[test]
fn two_brokers_of_which_one_says_nothing_but_answers() {
    let mut bed = rover_with(&Changes { brokers: vec![0], ..Changes::default() });
    for etag in [9_000, 9_001] {
        let answer = Answer::Bound(Etag::new(etag).unwrap());
        for half in SupplyEtag::pair(TxNode::BROKER, TxNode::MIN, bed::subject(0xABCD), answer) {
            bed.send(bed.stranger, half.encode());
            bed.run(5);
        }
    }
    let finding = only(&mut bed, Rule::TwoBrokers);
    assert!(finding.what.contains("9000") && finding.what.contains("9001"), "{finding}");
}

#[test]
fn two_calendars_plan_and_cluster() {
    let mut bed =
        Bed::new(&ROVER.replace("period = \"20 ms\"", "period = \"40 ms\""), &Changes::default()).power_on();
    bed.monitor = Monitor::with_plan(bed::plan_of(ROVER), bed.now());
    bed.run(3_000);
    assert_eq!(bed.rules()[0], Rule::TwoCalendars);
    let finding = bed.findings().remove(0);
    let digests =
        [bed.plan.digest(), bed.monitor.plan().unwrap().digest()].map(|digest| format!("{digest:08X}"));
    assert!(digests.iter().all(|digest| finding.what.contains(digest)), "{finding}");
}

#[test]
fn two_calendars_of_two_nodes() {
    let other =
        bed::plan_of(&ROVER.replace("clock_accuracy = \"50 us\"", "clock_accuracy = \"60 us\"")).calendar();
    // Node 1 becomes master when node 0 goes, with its other calendar.
    let mut bed = rover_with(&Changes { calendar: Some((1, other)), ..Changes::default() });
    let base = bed.nodes[0];
    bed.cluster.power_off(base);
    bed.run(2_500);
    let rules = bed.rules();
    assert!(rules.contains(&Rule::TwoCalendars), "{rules:?}");
    // That the others keep silent follows from it, and is not told as a clock that is bad.
    assert!(!rules.contains(&Rule::ClockOutOfBound), "{rules:?}");
}

#[test]
fn no_acknowledgement() {
    // Nobody else is on.
    let mut bed = Bed::rover();
    let stranger = bed.stranger;
    let now = bed.cluster.now();
    bed.cluster.bus().disconnect(now, stranger);
    let frame = Frame::new(Id::new(Priority::LEAST, TxNode::MIN, Etag::BOUND_LAST), Payload::EMPTY);
    bed.send(bed.listener, frame);
    bed.run(1_000);
    only(&mut bed, Rule::NoAcknowledgement);
}

#[test]
fn bus_off() {
    let mut bed = healthy();
    // Something disturbs every frame of the listener, whose station has an id of its own here.
    let id = ExtendedId::new(0x7B << 14).unwrap();
    let frames = Filter::new(embedded_can::Id::Extended(id), false, 0x7F << 14);
    let fault = Fault::Inverted(BitPosition::Drawn);
    bed.cluster.bus().faults_mut().add_rule(FaultRule { frames, skip: 0, count: 100, fault });
    let frame =
        Frame::new(Id::new(Priority::LEAST, TxNode::new(0x7B).unwrap(), Etag::BOUND_LAST), Payload::EMPTY);
    bed.send(bed.listener, frame);
    bed.run(500);
    let rules = bed.rules();
    assert!(rules.contains(&Rule::BusOff), "{rules:?}");
}

#[test]
fn clock_out_of_bound() {
    let mut bed = rover_with(&Changes { one_master: true, ..Changes::default() });
    assert_eq!(bed.rules(), []);
    let base = bed.nodes[0];
    bed.cluster.power_off(base);
    bed.run(2_500);
    let findings = bed.findings();
    let inhibited: Vec<u8> = findings
        .iter()
        .filter(|it| it.rule == Rule::ClockOutOfBound)
        .flat_map(|it| it.nodes.clone())
        .collect();
    // Those that have slots keep silent in them.
    for name in ["left_motor", "right_motor"] {
        assert!(inhibited.contains(&number(&bed, name).get()), "{findings:#?}");
    }
    bed.run(3_000);
    let findings = bed.findings();
    assert!(findings.iter().any(|it| it.what.starts_with("no time master for")), "{findings:#?}");
}

#[test]
fn a_time_scale_that_jumps() {
    let mut bed = healthy();
    // The master is restarted, so fast that nobody takes over: global time begins anew.
    let base = bed.nodes[0];
    bed.cluster.power_off(base);
    for station in bed.nodes.clone() {
        bed.cluster.power_on(station);
    }
    bed.run(2_500);
    let findings = bed.findings();
    assert!(
        findings.iter().any(|it| it.rule == Rule::ClockOutOfBound && it.what.contains("jumped by -")),
        "{findings:#?}"
    );
}

#[test]
fn unplanned_frames_at_priority_0() {
    let mut bed = healthy();
    let stranger = TxNode::new(0x66).unwrap();
    let id = Id::new(Priority::HARD, stranger, Etag::new(500).unwrap());
    bed = after(bed, 200, |bed, ms| {
        if ms % 20 == 0 {
            bed.send(bed.stranger, Frame::new(id, Payload::EMPTY))
        }
    });
    let rules = bed.rules();
    assert_eq!(rules, [Rule::UnplannedHard, Rule::UnplannedPublisher]);
    let finding = &bed.findings()[0];
    assert_eq!((finding.nodes.as_slice(), finding.etag), (&[0x66][..], Some(500)));
    assert!(finding.what.contains("sent 10 frames"), "{finding}");
}

#[test]
fn hard_frames_outside_of_their_slot() {
    let mut bed = healthy();
    let slot = bed.plan.slots()[0].slot;
    let id = Id::new(Priority::HARD, slot.publisher, slot.etag);
    // As a node would whose calendar task runs at the wrong instants: ten milliseconds behind its slot.
    bed = after(bed, 400, |bed, ms| {
        let global = bed.monitor.snapshot(bed.now()).clock.global_ns.unwrap();
        let behind = (global + slot.period.as_ticks() - slot.phase.as_ticks()) % slot.period.as_ticks();
        if behind / 1_000_000 == 10 && ms < 300 {
            bed.send(bed.stranger, Frame::new(id, Payload::truncated([0; 8], slot.len.into())));
        }
    });
    let findings = bed.findings();
    let outside = findings.iter().find(|it| it.rule == Rule::UnplannedHard).unwrap();
    assert!(outside.what.contains("outside of its window"), "{outside}");
    assert!(bed.monitor.snapshot(bed.now()).slots[0].outside >= 10);
}

/// As a gateway is: a node beside the plan, whose clock is too coarse for slots that it does not have.
#[test]
fn a_node_without_slots_keeps_silent_in_none() {
    let mut bed = healthy();
    let gateway = TxNode::new(0x64).unwrap();
    let status = NodeStatus::first(gateway, NodeState::HardInhibited).encode();
    bed.send(bed.stranger, status);
    bed.run(10);
    let state = |node: &NodeView| (node.tx_node == 0x64).then_some(node.state);
    let nodes = bed.monitor.snapshot(bed.now()).nodes;
    assert_eq!(nodes.iter().find_map(state), Some(Some("hard-inhibited")));
    assert_eq!(bed.findings(), []);
    let planned = NodeStatus::first(bed.plan.slots()[0].slot.publisher, NodeState::HardInhibited).encode();
    bed.send(bed.stranger, planned);
    bed.run(10);
    assert!(bed.rules().contains(&Rule::ClockOutOfBound));
}

#[test]
fn unplanned_frames_at_priority_0_without_a_plan() {
    let bed = healthy();
    let mut monitor = Monitor::new(bed.plan.bit_rate(), bed.now());
    for (at, frame) in &bed.log {
        monitor.on_frame(&Frame::try_from(*frame).unwrap(), bed::instant(*at));
    }
    assert_eq!(
        monitor.doctor(bed.now()),
        [],
        "slots are not known, but the etags are those of hard real-time"
    );
    let id = Id::new(Priority::HARD, TxNode::MIN, Etag::BOUND_LAST);
    monitor.on_frame(&Frame::new(id, Payload::EMPTY), bed.now());
    assert_eq!(monitor.doctor(bed.now())[0].rule, Rule::UnplannedHard);
}

#[test]
fn a_tx_node_that_two_nodes_have() {
    let plan = Bed::rover().plan;
    let (arm, power) = (&plan.cluster().nodes[4], &plan.cluster().nodes[5]);
    // It is fixed on both. The one that loses it is silent, and claims it again after a pause.
    let changes = Changes { ids: vec![(5, arm.tx_node, power.uid)], ..Changes::default() };
    let mut bed = rover_with(&changes);
    bed.run(10_000);
    let findings = bed.findings();
    let duplicate = findings.iter().find(|it| it.rule == Rule::DuplicateNode);
    assert_eq!(duplicate.map(|it| it.nodes.as_slice()), Some(&[arm.tx_node.get()][..]), "{findings:#?}");
}

#[test]
fn a_uid_that_two_nodes_have() {
    let plan = Bed::rover().plan;
    let (arm, power) = (&plan.cluster().nodes[4], &plan.cluster().nodes[5]);
    let changes = Changes { ids: vec![(5, power.tx_node, arm.uid)], ..Changes::default() };
    let mut bed = rover_with(&changes);
    let finding = only(&mut bed, Rule::DuplicateNode);
    assert_eq!(finding.nodes, [arm.tx_node.get(), power.tx_node.get()]);
}

#[test]
fn an_unplanned_publisher() {
    let mut bed = healthy();
    let attitude = bed.plan.channel(channel_named(&bed.plan, "attitude")).etag.unwrap();
    let imposter = number(&bed, "arm");
    let id = Id::new(Priority::new(40), imposter, attitude);
    bed = after(bed, 300, |bed, ms| {
        if ms % 100 == 0 {
            bed.send(bed.stranger, Frame::new(id, Payload::full([0; 8])))
        }
    });
    let finding = only(&mut bed, Rule::UnplannedPublisher);
    assert_eq!((finding.nodes.as_slice(), finding.etag), (&[imposter.get()][..], Some(attitude.get())));
    assert!(finding.what.starts_with("arm (") && finding.what.contains("3 times on attitude"), "{finding}");
    assert_eq!(finding.severity, Severity::Warning);
}

#[test]
fn a_babbling_channel() {
    let mut bed = healthy();
    let gripper = channel_named(&bed.plan, "gripper");
    bed.orders.borrow_mut().babble = Some((gripper, 20));
    bed.run(2_000);
    let finding = only(&mut bed, Rule::Babbling);
    assert_eq!(finding.nodes, [number(&bed, "arm").get()]);
    assert!(finding.what.contains("gripper") && finding.what.contains("20 are planned"), "{finding}");
    bed.orders.borrow_mut().babble = None;
    bed.run(3_000);
    assert_eq!(bed.rules(), []);
}

#[test]
fn a_silent_node() {
    let mut bed = healthy();
    let power = bed.nodes[5];
    bed.cluster.power_off(power);
    bed.run(4_500);
    assert_eq!(bed.rules(), [], "it may come back");
    bed.run(1_500);
    let finding = only(&mut bed, Rule::SilentNode);
    assert_eq!(finding.nodes, [number(&bed, "power").get()]);
}

#[test]
fn a_node_that_was_never_there() {
    let mut bed = Bed::rover();
    for station in bed.nodes.clone().into_iter().take(5) {
        bed.cluster.power_on(station);
    }
    bed.run(6_000);
    let finding = only(&mut bed, Rule::SilentNode);
    assert!(finding.what.starts_with("power (") && finding.what.contains("never heard"), "{finding}");
}

#[test]
fn nothing_received() {
    let mut bed = Bed::rover();
    bed.run(2_500);
    assert_eq!(bed.rules(), [], "it is too early to say");
    bed.run(1_000);
    only(&mut bed, Rule::NothingReceived);
}

#[test]
fn a_wrong_bit_rate() {
    // To a receiver of another rate every frame is an error.
    let faults = FaultModel::seeded(3).with_inversion(cosmic_bus::Chance::new(1.0).unwrap());
    let mut bed = Bed::new(ROVER, &Changes { faults: Some(faults), ..Changes::default() }).power_on();
    bed.run(4_000);
    only(&mut bed, Rule::WrongBitRate);
}

#[test]
fn a_node_near_bus_off() {
    let mut bed = healthy();
    let arm = number(&bed, "arm");
    let id = ExtendedId::new(u32::from(arm.get()) << 14).unwrap();
    let frames = Filter::new(embedded_can::Id::Extended(id), false, 0x7F << 14);
    let fault = Fault::Inverted(BitPosition::Drawn);
    // Sixteen errors in a row make a transmitter error passive; one less than bus-off.
    bed.cluster.bus().faults_mut().add_rule(FaultRule { frames, skip: 0, count: 16, fault });
    bed.run(400);
    let findings = bed.findings();
    let near = findings.iter().find(|it| it.rule == Rule::ErrorPassive);
    assert_eq!(near.map(|it| it.nodes.as_slice()), Some(&[arm.get()][..]), "{findings:#?}");
}

#[test]
fn a_full_bus() {
    let mut bed = healthy();
    let journal = bed.plan.channel(channel_named(&bed.plan, "journal")).etag.unwrap();
    let id = Id::new(Priority::LEAST, number(&bed, "base"), journal);
    for _ in 0..15_000 {
        bed.send(bed.stranger, Frame::new(id, Payload::full([0x55; 8])));
        bed.run_for_a_tenth();
    }
    let rules = bed.rules();
    assert!(rules.contains(&Rule::BusFull) && rules.contains(&Rule::Babbling), "{rules:?}");
}

#[test]
fn frames_lost_here() {
    let mut bed = healthy();
    let now = bed.now();
    bed.monitor.on_lost(17, now);
    let finding = only(&mut bed, Rule::LostHere);
    assert!(finding.what.starts_with("17 frames"), "{finding}");
}

#[test]
fn every_rule_has_a_test_here() {
    let text = include_str!("doctor.rs");
    for rule in Rule::ALL {
        assert!(text.contains(&format!("Rule::{rule:?}")), "{rule:?}");
    }
}
