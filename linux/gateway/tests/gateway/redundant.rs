//! Several gateways of a segment, and rings: an event once.

use std::collections::BTreeSet;
use std::process::Command;
use std::time::Duration as Span;

use crate::bed::{
    HEAT, HEAT_TABLE, Running, Segment, Setup, Stranger, count, fifo, frames, name, port, until,
};
use cosmic_core::can::{Etag, Frame};
use cosmic_core::event_layer::{Channel, SoftAttributes};
use cosmic_core::time::Duration;
use cosmic_gateway::Gateway;
use cosmic_gateway::config::{Config, GATEWAYS};
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_linux::Subscriber;

const ETAGS: &str = "etags = { heat = 5000, gateways = 5001 }";

fn drain(subscriber: &Subscriber<i16>, into: &mut Vec<i16>) {
    into.extend(std::iter::from_fn(|| subscriber.try_next()).map(|event| event.content));
}

fn assert_once(numbers: &[i16]) {
    let once: BTreeSet<_> = numbers.iter().collect();
    assert_eq!(once.len(), numbers.len(), "something came twice: {numbers:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn another_gateway_takes_over_and_states_what_was_perhaps_lost() {
    let (west, east) = (Segment::start().await, Segment::start().await);
    let folder = tempfile::tempdir().unwrap();
    let ports = [port(), port(), port()];
    let (more, channels) = (ETAGS, HEAT_TABLE);
    let of_east =
        Setup { segment: "east", bus: &east, tx_node: 100, listen: ports[0], connect: &[], more, channels };
    let of_east = of_east.start().await;
    // The first is a program of its own, to be killed; its TxNode is the lower one.
    let first = Setup {
        segment: "west",
        bus: &west,
        tx_node: 100,
        listen: ports[1],
        connect: &ports[..1],
        more,
        channels,
    };
    let file = folder.path().join("first.toml");
    std::fs::write(&file, first.text()).unwrap();
    let mut program = Running::start(Command::new(env!("CARGO_BIN_EXE_cosmic-gateway")).arg(&file));
    let heat = HEAT.with_etag(Etag::new(5000).unwrap());
    let publisher = west.node(1).announce(&heat).unwrap();
    let subscriber = east.node(1).subscribe(&heat, fifo(255)).unwrap();
    publisher.bound().await;
    let mut heard = Vec::new();
    let mut number = 0;
    until("the first forwards", || {
        number += 1;
        publisher.publish(number).unwrap();
        drain(&subscriber, &mut heard);
        !heard.is_empty()
    })
    .await;
    let second = Setup {
        segment: "west",
        bus: &west,
        tx_node: 101,
        listen: ports[2],
        connect: &ports[..1],
        more,
        channels,
    };
    let second = second.start().await;
    until("the second stands by", || {
        number += 1;
        publisher.publish(number).unwrap();
        drain(&subscriber, &mut heard);
        count(&second, "west", Direction::Out, Outcome::StandingBy) > 20
    })
    .await;
    assert!(!second.leads(&name("west")));
    program.kill();
    let killed_at = number;
    until("the second forwards", || {
        number += 1;
        publisher.publish(number).unwrap();
        drain(&subscriber, &mut heard);
        heard.iter().any(|heard| *heard > killed_at + 3)
    })
    .await;
    tokio::time::sleep(Span::from_millis(100)).await;
    drain(&subscriber, &mut heard);
    assert_once(&heard);
    let lost =
        (killed_at + 1..=*heard.iter().max().unwrap()).filter(|number| !heard.contains(number)).count();
    let told = count(&second, "west", Direction::Out, Outcome::PerhapsLost);
    let of_east = count(&of_east, "east", Direction::In, Outcome::Forwarded);
    assert!(told >= lost as u64, "{lost} lost, {told} told; {of_east} forwarded");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn who_leads_for_another_network_has_forwarded_nothing_of_ours() {
    let bus = Segment::start().await;
    let (listen, connect, channels) = (port(), &[], HEAT_TABLE);
    let tap = bus.tap().await;
    let setup = Setup { segment: "west", bus: &bus, tx_node: 101, listen, connect, more: ETAGS, channels };
    let gateway = setup.start().await;
    let stranger = Stranger::start(listen, "stranger").await;
    let _wanted = stranger.session.declare_subscriber(stranger.keys.events(HEAT.subject())).await.unwrap();
    // Two more gateways on the bus, of this network and of another one; what a beacon looks like ours shows.
    let mut beacon = None;
    until("a beacon is heard", || {
        let of_gateway = |frame: &Frame| frame.id.tx_node().get() == 101 && frame.payload.len() == 8;
        beacon = frames(&tap).into_iter().find(of_gateway);
        beacon.is_some()
    })
    .await;
    let mut ours: [u8; 8] = beacon.unwrap().payload.as_slice().try_into().unwrap();
    ours[1] = 3; // it leads, and is able to
    let theirs = [ours[0], 3, !ours[2], !ours[3], 0, 0, 0, 0];
    let quality = SoftAttributes { deadline: Duration::from_millis(20), validity: Duration::from_millis(80) };
    let beacons = Channel::<[u8; 8]>::soft(GATEWAYS, quality).with_etag(Etag::new(5001).unwrap());
    let of_ours = bus.node(1).announce(&beacons).unwrap();
    let of_theirs = bus.node(2).announce(&beacons).unwrap();
    let beat = |publisher: cosmic_linux::Publisher<[u8; 8]>, beacon| async move {
        loop {
            let _ = publisher.publish(beacon);
            tokio::time::sleep(Span::from_millis(50)).await;
        }
    };
    let ours = tokio::spawn(beat(of_ours, ours));
    let theirs = tokio::spawn(beat(of_theirs, theirs));
    let publisher = bus.node(3).announce(&HEAT.with_etag(Etag::new(5000).unwrap())).unwrap();
    publisher.bound().await;
    let told = |outcome| count(&gateway, "west", Direction::Out, outcome);
    // Longer than it only listens in any case.
    tokio::time::sleep(Span::from_secs(1)).await;
    let stood_by = told(Outcome::StandingBy);
    until("it stands by", || {
        let _ = publisher.publish(0);
        told(Outcome::StandingBy) > stood_by + 5
    })
    .await;
    let before = told(Outcome::PerhapsLost);
    ours.abort();
    for number in 0..20 {
        publisher.publish(number).unwrap();
        tokio::time::sleep(Span::from_millis(2)).await;
    }
    let forwarded = told(Outcome::Forwarded);
    until("it takes over", || {
        let _ = publisher.publish(0);
        told(Outcome::Forwarded) > forwarded
    })
    .await;
    theirs.abort();
    let perhaps = told(Outcome::PerhapsLost) - before;
    assert!(perhaps >= 20, "{perhaps} of 20; {} were left to the other", told(Outcome::StandingBy));
}

/// A gateway of two segments.
async fn between(segments: [(&str, &Segment); 2], tx_node: u8, listen: u16, connect: &[u16]) -> Gateway {
    let mut text = format!("network = \"test\"\n[ip]\nlisten = [\"tcp/127.0.0.1:{listen}\"]\nconnect = [");
    text += &connect.iter().map(|port| format!("\"tcp/127.0.0.1:{port}\"")).collect::<Vec<_>>().join(", ");
    text += "]\n";
    for (name, bus) in segments {
        let path = bus.path.display();
        text += &format!(
            "[[segment]]\nname = \"{name}\"\nlink = \"sim:{path}\"\nuid = \"{tx_node:X}\"\ntx-node = {tx_node}\n{ETAGS}\n"
        );
    }
    text += HEAT_TABLE;
    Gateway::start(&Config::parse("ring.toml", &text, std::path::Path::new(".")).unwrap()).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn in_a_ring_of_three_segments_an_event_comes_once_to_each() {
    let [a, b, c] = [Segment::start().await, Segment::start().await, Segment::start().await];
    let ports = [port(), port(), port()];
    let gateways = [
        between([("a", &a), ("b", &b)], 101, ports[0], &[]).await,
        between([("b", &b), ("c", &c)], 102, ports[1], &ports[..1]).await,
        between([("c", &c), ("a", &a)], 103, ports[2], &ports[..2]).await,
    ];
    let heat = HEAT.with_etag(Etag::new(5000).unwrap());
    let subscribers = [&a, &b, &c].map(|bus| bus.node(1).subscribe(&heat, fifo(255)).unwrap());
    let publisher = a.node(2).announce(&heat).unwrap();
    publisher.bound().await;
    for segment in ["a", "b", "c"] {
        until("somebody speaks", || gateways.iter().any(|gateway| gateway.leads(&name(segment)))).await;
    }
    let mut heard = [Vec::new(), Vec::new(), Vec::new()];
    let mut number = 0;
    until("events reach all", || {
        number += 1;
        publisher.publish(number).unwrap();
        for (subscriber, heard) in subscribers.iter().zip(&mut heard) {
            drain(subscriber, heard);
        }
        heard.iter().all(|heard| heard.len() > 30)
    })
    .await;
    for _ in 0..50 {
        number += 1;
        publisher.publish(number).unwrap();
        tokio::time::sleep(Span::from_millis(5)).await;
    }
    tokio::time::sleep(Span::from_millis(200)).await;
    for (subscriber, heard) in subscribers.iter().zip(&mut heard) {
        drain(subscriber, heard);
        assert_once(heard);
    }
    let of_gateways: u64 = gateways
        .iter()
        .flat_map(|gateway| ["a", "b", "c"].map(|segment| gateway.counters(&name(segment), Direction::Out)))
        .flatten()
        .map(|counters| counters.get(Outcome::OfGateway))
        .sum();
    // The other gateway of each segment has seen them, and has left them there.
    assert!(of_gateways > 0);
}

/// On a machine that is busy it may lead again in a moment; to declare all anew each time would keep it busy for good.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_loses_the_lead_keeps_for_a_while_what_it_has_declared() {
    let bus = Segment::start().await;
    let (listen, connect) = (port(), &[]);
    let channels = &format!("{HEAT_TABLE}unasked = [\"west\"]\n");
    let setup = Setup { segment: "west", bus: &bus, tx_node: 100, listen, connect, more: ETAGS, channels };
    let gateway = setup.start().await;
    let stranger = Stranger::start(listen, "stranger").await;
    let key = stranger.keys.event(HEAT.subject(), &stranger.segment);
    let publisher = stranger.session.declare_publisher(key).await.unwrap();
    let is_wanted = || zenoh::Wait::wait(publisher.matching_status()).unwrap().matching();
    until("it subscribes on IP", || gateway.leads(&name("west")) && is_wanted()).await;
    let begun = tokio::time::Instant::now();
    drop(bus);
    until("it does not lead any more", || !gateway.leads(&name("west"))).await;
    // Longer than it may take to look at that.
    tokio::time::sleep(Span::from_millis(1500)).await;
    assert!(is_wanted() || begun.elapsed() > Span::from_secs(4));
    until("it has given up", || !is_wanted()).await;
}
