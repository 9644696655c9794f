//! What crosses between two segments, and what does not.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration as Span;

use crate::bed::{
    HEAT, HEAT_TABLE, Pair, Segment, Setup, Stranger, count, fifo, frames, port, until, with_etag,
};
use cosmic_core::can::Etag;
use cosmic_core::event_layer::{Event, Policy};
use cosmic_core::time::Duration;
use cosmic_gateway::config::Config;
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::{Crossing, Gateway};

const ETAG_WEST: u16 = 5000;
const ETAG_EAST: u16 = 7000;

fn etags(heat: u16) -> String {
    format!("etags = {{ heat = {heat}, gateways = {} }}", heat + 1)
}

async fn start(channels: &str) -> Pair {
    Pair::start(channels, [&etags(ETAG_WEST), &etags(ETAG_EAST)]).await
}

fn etag(number: u16) -> Etag {
    Etag::new(number).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_event_crosses_in_both_directions_under_the_etag_of_each_segment() {
    let bed = start(HEAT_TABLE).await;
    let (west, east) = (HEAT.with_etag(etag(ETAG_WEST)), HEAT.with_etag(etag(ETAG_EAST)));
    let tap = bed.east.tap().await;
    let (in_west, in_east) = (bed.west.node(1), bed.east.node(1));
    let from_west = in_west.subscribe(&west, fifo(100)).unwrap();
    let from_east = in_east.subscribe(&east, fifo(100)).unwrap();
    let (out_of_west, out_of_east) = (in_west.announce(&west).unwrap(), in_east.announce(&east).unwrap());
    out_of_west.bound().await;
    out_of_east.bound().await;
    // Interest goes from the subscriber to the publisher's gateway, which subscribes then.
    let gateways = [etag(ETAG_WEST), etag(ETAG_EAST)];
    let is_read = |node: &cosmic_linux::Node, etag| {
        let readers = node.interested(etag, cosmic_core::protocol::Side::Subscriber);
        readers.iter().any(|node| node.get() >= 100)
    };
    until("west's gateway subscribes", || is_read(&in_west, gateways[0])).await;
    until("east's gateway subscribes", || is_read(&in_east, gateways[1])).await;
    let tokio_time = Span::from_millis(2);
    for number in 0..50 {
        out_of_west.publish(number).unwrap();
        out_of_east.publish(1000 + number).unwrap();
        tokio::time::sleep(tokio_time).await;
    }
    // On a machine that is busy a gateway may have stood still for a moment: then it says what it did not forward.
    let ways = [("west", &bed.of_west, "east", &bed.of_east), ("east", &bed.of_east, "west", &bed.of_west)];
    let mut forwarded = [0; 2];
    for (at, (from, out, to, into)) in ways.into_iter().enumerate() {
        let forwarded_and_not = || {
            let sum = |direction, gateway, segment| {
                // What is perhaps lost stood by before.
                let others = Outcome::ALL.iter().filter(|it| {
                    !matches!(it, Outcome::Forwarded | Outcome::OfGateway | Outcome::PerhapsLost)
                });
                others.map(|outcome| count(gateway, segment, direction, *outcome)).sum::<u64>()
            };
            let of_ip: u64 = Outcome::ALL.iter().map(|outcome| into.unassigned().get(*outcome)).sum();
            let passed = count(into, to, Direction::In, Outcome::Forwarded);
            (passed, sum(Direction::Out, out, from) + sum(Direction::In, into, to) + of_ip)
        };
        until("all are accounted for", || {
            let (passed, told) = forwarded_and_not();
            passed + told >= 50
        })
        .await;
        let (passed, told) = forwarded_and_not();
        assert_eq!(passed + told, 50, "{}", into.metrics());
        forwarded[at] = passed as usize;
    }
    tokio::time::sleep(Span::from_millis(100)).await;
    let collect = |subscriber: &cosmic_linux::Subscriber<i16>| {
        let mut all: Vec<_> =
            std::iter::from_fn(|| subscriber.try_next()).map(|event| event.content).collect();
        let len = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), len, "nothing came twice");
        len
    };
    assert_eq!(collect(&from_east), 50 + forwarded[0], "own events, and those of the west");
    assert_eq!(collect(&from_west), 50 + forwarded[1]);
    assert!(forwarded.iter().all(|forwarded| *forwarded > 0));
    let heard = frames(&tap);
    assert_eq!(with_etag(&heard, etag(ETAG_EAST)).len(), 50 + forwarded[0]);
    assert_eq!(with_etag(&heard, etag(ETAG_WEST)), [], "each segment keeps its own etags");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_what_somebody_wants_crosses_and_it_stops_when_interest_ends() {
    let bed = start(HEAT_TABLE).await;
    let tap = bed.east.tap().await;
    let (sensor, display) = (bed.west.node(1), bed.east.node(1));
    let heat = sensor.announce(&HEAT.with_etag(etag(ETAG_WEST))).unwrap();
    heat.bound().await;
    let east = etag(ETAG_EAST);
    for number in 0..20 {
        heat.publish(number).unwrap();
        tokio::time::sleep(Span::from_millis(5)).await;
    }
    assert_eq!(with_etag(&frames(&tap), east), [], "nobody subscribes");
    assert_eq!(count(&bed.of_west, "west", Direction::Out, Outcome::Forwarded), 0, "it did not even leave");
    let subscriber = display.subscribe(&HEAT.with_etag(east), Policy::Latest).unwrap();
    let mut number = 100;
    until("an event crosses", || {
        number += 1;
        let _ = heat.publish(number);
        subscriber.try_next().is_some()
    })
    .await;
    drop(subscriber);
    until("the way is closed", || {
        let before = count(&bed.of_west, "west", Direction::Out, Outcome::Forwarded);
        let _ = heat.publish(number);
        std::thread::sleep(Span::from_millis(20));
        count(&bed.of_west, "west", Direction::Out, Outcome::Forwarded) == before
    })
    .await;
    tokio::time::sleep(Span::from_millis(50)).await;
    let _ = frames(&tap);
    for _ in 0..20 {
        heat.publish(number).unwrap();
        tokio::time::sleep(Span::from_millis(5)).await;
    }
    assert_eq!(with_etag(&frames(&tap), east), []);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_deadline_on_the_far_bus_is_what_is_left_of_it() {
    // So short that the priority tells it: 30 ms are 187 steps of 160 µs.
    let table = HEAT_TABLE.replace("\"500 ms\"", "\"30 ms\"");
    let bed = start(&table).await;
    let (sensor, display) = (bed.west.node(1), bed.east.node(1));
    let quality = cosmic_core::event_layer::SoftAttributes {
        deadline: Duration::from_millis(30),
        validity: Duration::from_millis(1000),
    };
    let heat = cosmic_core::event_layer::Channel::<i16>::soft(HEAT.subject(), quality);
    let publisher = sensor.announce(&heat.with_etag(etag(ETAG_WEST))).unwrap();
    let subscriber = display.subscribe(&heat.with_etag(etag(ETAG_EAST)), fifo(100)).unwrap();
    publisher.bound().await;
    let mut number = 0;
    until("the way is open", || {
        number += 1;
        let _ = publisher.publish(number);
        subscriber.try_next().is_some()
    })
    .await;
    tokio::time::sleep(Span::from_millis(100)).await;
    while subscriber.try_next().is_some() {}
    let mut most = 0;
    for number in 1000..1020 {
        publisher.publish(number).unwrap();
        let event = tokio::time::timeout(crate::bed::PATIENCE, subscriber.next()).await.unwrap();
        assert_eq!(event.content, number);
        most = most.max(event.id.priority().get());
    }
    // Fresh events: some of the way has been charged, and not more than there was.
    assert!((1..=188).contains(&most), "{most}");
    // An event that had two milliseconds left when it was published has less than that when it arrives.
    let soon = sensor.now() + Duration::from_millis(2);
    let late = Event::new(7).deadline(soon).expires_at(soon + Duration::from_millis(900));
    publisher.publish_event(&late).unwrap();
    let event = tokio::time::timeout(crate::bed::PATIENCE, subscriber.next()).await.unwrap();
    assert_eq!(event.content, 7);
    assert!(event.id.priority().get() <= 14, "{:?}", event.id);
}

/// Who watches must not wait. Here it does, so that events come faster than they leave.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_finds_no_place_among_those_that_leave_is_counted() {
    let west = Segment::start().await;
    let (listen, channels) = (port(), HEAT_TABLE);
    let more = "etags = { heat = 5000, gateways = 5001 }";
    let setup = Setup { segment: "west", bus: &west, tx_node: 100, listen, connect: &[], more, channels };
    let config = Config::parse("test.toml", &setup.text(), std::path::Path::new(".")).unwrap();
    let is_shut = Arc::new(AtomicBool::new(false));
    let shut = Arc::clone(&is_shut);
    let watch = move |_: &Crossing<'_>, _| {
        // Other tasks go on meanwhile.
        tokio::task::block_in_place(|| {
            while shut.load(Ordering::Relaxed) {
                std::thread::sleep(Span::from_millis(1));
            }
        });
    };
    let gateway = Gateway::start_watched(&config, Box::new(watch)).await.unwrap();
    let stranger = Stranger::start(listen, "stranger").await;
    let _wanted = stranger.session.declare_subscriber(stranger.keys.events(HEAT.subject())).await.unwrap();
    let publisher = west.node(1).announce(&HEAT.with_etag(etag(5000))).unwrap();
    publisher.bound().await;
    let of = |outcome: &Outcome| count(&gateway, "west", Direction::Out, *outcome);
    let all = || Outcome::ALL.iter().map(of).sum::<u64>();
    until("the way is open", || {
        publisher.publish(0).unwrap();
        of(&Outcome::Forwarded) > 0
    })
    .await;
    let counters = || publisher.node().channel_counters(publisher.subject()).unwrap();
    let all_sent = || counters().sent + counters().discarded == counters().published;
    until("all is sent", all_sent).await;
    tokio::time::sleep(Span::from_millis(200)).await;
    let before = (all(), counters().sent);
    is_shut.store(true, Ordering::Relaxed);
    for number in 0..200 {
        publisher.publish(number).unwrap();
        until("it is sent", all_sent).await;
    }
    is_shut.store(false, Ordering::Relaxed);
    let sent = u64::from(counters().sent - before.1);
    until("each is counted", || all() == before.0 + sent).await;
    // One was on its way, and 128 waited.
    assert_eq!(of(&Outcome::QueueFull), sent - 129);
}
