//! What the monitor says of a healthy cluster: the rover of the planner's examples on the simulated bus.

mod bed;

use bed::Bed;
use cosmic_core::can::Frame;
use cosmic_core::time::Duration;
use cosmic_monitor::{ChannelClass, ChannelView, Meaning, NoticeKind};

fn running() -> Bed {
    let mut bed = Bed::rover().power_on();
    bed.run(3_000);
    bed
}

fn named<'a>(channels: &'a [ChannelView], name: &str) -> &'a ChannelView {
    channels.iter().find(|channel| channel.name.as_deref() == Some(name)).unwrap()
}

#[test]
fn nothing_is_wrong_with_it() {
    let mut bed = running();
    let findings = bed.findings();
    assert!(findings.is_empty(), "{findings:#?}");
    bed.run(4_000);
    let findings = bed.findings();
    assert!(findings.is_empty(), "{findings:#?}");
}

/// Whoever looks may have a clock that is ahead of the stamps of frames which the link still holds.
#[test]
fn looking_makes_nothing_late_that_is_still_to_come() {
    let mut bed = running();
    for _ in 0..20 {
        let ahead = bed.now() + Duration::from_millis(30);
        let findings = bed.monitor.doctor(ahead);
        assert!(findings.is_empty(), "{findings:#?}");
        bed.run(100);
    }
    let slots = bed.monitor.snapshot(bed.now()).slots;
    assert!(slots.iter().all(|slot| slot.frames > 200), "{slots:#?}");
    assert!(slots.iter().all(|slot| (slot.missed, slot.outside) == (0, 0)), "{slots:#?}");
}

#[test]
fn its_nodes_have_names_and_fare_well() {
    let mut bed = running();
    let snapshot = bed.monitor.snapshot(bed.now());
    assert_eq!(snapshot.segment.as_deref(), Some("rover"));
    let names: Vec<_> = snapshot.nodes.iter().filter_map(|node| node.name.as_deref()).collect();
    assert_eq!(names, ["base", "left_motor", "right_motor", "imu", "arm", "power"]);
    for node in &snapshot.nodes {
        assert!(node.alive && node.planned, "{node:?}");
        assert_eq!((node.state, node.uptime_s, node.restarts), (Some("operational"), Some(2), 0));
        assert_eq!((node.transmit_errors, node.receive_errors), (Some(0), Some(0)));
    }
    let masters: Vec<_> =
        snapshot.nodes.iter().filter(|node| node.is_master).map(|node| node.tx_node).collect();
    assert_eq!(masters, [snapshot.clock.master.unwrap()]);
    assert_eq!(snapshot.clock.calendar, snapshot.clock.planned_calendar);
    // Stamps of 1 µs, and one bit.
    assert!(snapshot.clock.uncertainty_ns.unwrap() < 50_000, "{:?}", snapshot.clock);
}

#[test]
fn its_channels_have_publishers_subscribers_rates_and_contents() {
    let mut bed = running();
    let snapshot = bed.monitor.snapshot(bed.now());
    let attitude = named(&snapshot.channels, "attitude");
    assert_eq!(attitude.class, Some(ChannelClass::Soft));
    assert!((attitude.rate - 100.0).abs() < 3.0, "{}", attitude.rate);
    let who: Vec<_> = attitude.publishers.iter().map(|publisher| publisher.name.as_deref()).collect();
    assert_eq!(who, [Some("imu")]);
    assert_eq!(attitude.publishers[0].planned, Some(true));
    assert!(attitude.publishers[0].lease_ns.is_some_and(|lease| lease > 5_000_000_000));
    let interval = attitude.publishers[0].interval_ns.unwrap();
    assert!(interval.abs_diff(10_000_000) < 500_000, "{interval}");
    let who: Vec<_> = attitude.subscribers.iter().map(|subscriber| subscriber.name.as_deref()).collect();
    assert_eq!(who, [Some("base")]);
    assert!(attitude.subscribers[0].lease_ns.is_some());
    let last = attitude.last.as_ref().unwrap();
    let fields: Vec<_> = last.fields.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(fields, ["roll", "pitch", "yaw", "quality", "calibrated"]);
    assert!(last.fields[0].to_string().ends_with(" °"), "{}", last.fields[0]);
    assert_eq!(named(&snapshot.channels, "drive").class, Some(ChannelClass::Hard));
    assert_eq!(named(&snapshot.channels, "battery").class, Some(ChannelClass::NonRealTime));
}

#[test]
fn soft_events_are_as_old_as_their_priorities_say() {
    let mut bed = running();
    let snapshot = bed.monitor.snapshot(bed.now());
    let latency = named(&snapshot.channels, "attitude").latency.unwrap();
    // A deadline of 8 ms: loaded at once, or behind a few longer frames, and never late.
    let oldest = latency.oldest_ns.unwrap();
    assert!((100_000..2_500_000).contains(&oldest), "{latency:?}");
    assert_eq!((latency.at_the_limit, latency.least_urgent), (0, 0));
    assert!(latency.least_left_ns > 5_000_000, "{latency:?}");
}

#[test]
fn hard_events_stand_in_their_slots() {
    let mut bed = running();
    let snapshot = bed.monitor.snapshot(bed.now());
    assert_eq!(snapshot.slots.len(), 3);
    for slot in &snapshot.slots {
        assert!(slot.frames > 80, "{slot:?}");
        assert_eq!((slot.missed, slot.outside), (0, 0), "{slot:?}");
        let (earliest, latest) = (slot.earliest_ns.unwrap(), slot.latest_ns.unwrap());
        assert!(earliest > 0 && latest < slot.deadline_ns as i64, "{slot:?}");
    }
}

#[test]
fn the_load_is_that_of_the_bus() {
    let mut bed = running();
    let before = bed.cluster.bus().accounting().busy_bits();
    let snapshot = bed.monitor.snapshot(bed.now());
    assert_eq!(snapshot.load.bits, before, "bit for bit");
    bed.run(1_000);
    let used = bed.cluster.bus().accounting().busy_bits() - before;
    let share = bed.monitor.snapshot(bed.now()).load.now.total();
    assert!((share - used as f64 / 500_000.0).abs() < 0.01, "{share}");
}

#[test]
fn its_frames_are_read_out() {
    let bed = running();
    let frames: Vec<Frame> = bed.log.iter().filter_map(|(_, frame)| Frame::try_from(*frame).ok()).collect();
    let mut names = Vec::new();
    for frame in &frames {
        match bed.monitor.decode(frame).meaning {
            Meaning::Control { name, .. } if !names.contains(&name) => names.push(name),
            Meaning::Malformed => panic!("{frame} is a message of a node"),
            Meaning::Event { malformed: Some(why), .. } => panic!("{frame}: {why}"),
            _ => {}
        }
    }
    names.sort_unstable();
    assert_eq!(names, ["follow-up", "interest", "node identity", "node status", "sync"]);
    let line =
        frames.iter().map(|frame| bed.monitor.decode(frame).to_string()).find(|line| line.contains("drive "));
    let line = line.unwrap();
    assert!(
        line.starts_with("HRT   0  base ") && line.contains(" speed=") && line.ends_with("lights=true"),
        "{line}"
    );
}

#[test]
fn nodes_that_come_and_go_are_told() {
    let mut bed = running();
    let last = bed.monitor.notices(0).last().unwrap().sequence;
    let arm = bed.nodes[4];
    bed.cluster.power_off(arm);
    bed.run(4_500);
    let kinds = |bed: &Bed, after| -> Vec<(NoticeKind, Option<u8>)> {
        bed.monitor.notices(after).map(|notice| (notice.kind, notice.tx_node)).collect()
    };
    let number = Some(bed.plan.cluster().nodes[4].tx_node.get());
    assert_eq!(kinds(&bed, last), [(NoticeKind::NodeSilent, number)]);
    let last = bed.monitor.notices(0).last().unwrap().sequence;
    bed.cluster.power_on(arm);
    bed.run(1_000);
    assert!(kinds(&bed, last).contains(&(NoticeKind::NodeAppeared, number)));
    assert!(bed.monitor.snapshot(bed.now()).nodes[4].alive);
}

/// A node that counts missed events tells how many within half a second, before the monitor has looked at all slots.
#[test]
fn exceptions_of_missed_slots_are_explained_when_they_are_told() {
    let mut bed = running();
    let last = bed.monitor.notices(0).last().unwrap().sequence;
    let left_wheel = bed::channel_named(&bed.plan, "left_wheel");
    bed.orders.borrow_mut().mute = Some(left_wheel);
    bed.run(2_500);
    let mut told = 0;
    for notice in bed.monitor.notices(last).filter(|notice| notice.kind == NoticeKind::Exceptions) {
        let names: Vec<_> = notice.exceptions.iter().map(|exception| exception.name).collect();
        let explained = names.contains(&"missed event") || names.contains(&"nothing published for the slot");
        assert!(explained, "{notice:?}");
        told += 1;
    }
    assert!(told > 0);
}
