//! The link over SocketCAN against a kernel that has it: nodes on the virtual interface `vcan0`. Not among the default
//! tests: `cargo xtask test socketcan` runs it in a small virtual machine.

mod common;

use std::process::Command;
use std::time::Duration;

use common::{HEAT, TEXT, uid};
use cosmic_core::can::TxNode;
use cosmic_core::event_layer::Policy;
use cosmic_linux::link::socketcan::SocketCan;
use cosmic_linux::{Config, Node, Tap, What};

const INTERFACE: &str = "vcan0";
const EVENTS: u16 = 1_000;
/// Only bounds what hangs: the machine is emulated.
const PATIENCE: Duration = Duration::from_secs(60);

fn node(number: u8) -> Node {
    let config = Config::new(uid(number.into())).tx_node(TxNode::new(number).unwrap());
    Node::start(config, SocketCan::new(INTERFACE)).unwrap()
}

async fn within<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("it comes")
}

fn set(state: &str) {
    let status = Command::new("/bin/busybox").args(["ip", "link", "set", INTERFACE, state]).status().unwrap();
    assert!(status.success(), "the interface goes {state}");
}

/// Each is published when the one before it has come. They keep for ever, so that an emulated machine may be slow.
#[tokio::test]
async fn events_cross_and_echoes_confirm_them() {
    let (sensor, display) = (node(1), node(2));
    let subscriber = display.subscribe(&TEXT, Policy::Fifo(common::depth(8))).unwrap();
    let text = sensor.announce(&TEXT).unwrap();
    within(text.bound()).await;
    within(display.connected()).await;
    for number in 0..EVENTS {
        text.publish(number).unwrap();
        let event = within(subscriber.next()).await;
        assert_eq!((event.content, event.publisher.get()), (number, 1));
    }
    let counters = sensor.channel_counters(TEXT.subject()).unwrap();
    within(async {
        while sensor.channel_counters(TEXT.subject()).unwrap().sent < u32::from(EVENTS) {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert_eq!((counters.published, counters.discarded), (u32::from(EVENTS), 0));
    let link = display.link_counters();
    assert_eq!((link.lost, link.malformed, link.foreign, link.repeated), (0, 0, 0, 0), "{link:?}");
}

#[tokio::test]
async fn a_burst_arrives_whole_and_in_its_order() {
    let (sensor, display) = (node(1), node(2));
    let subscriber = display.subscribe(&TEXT, Policy::Fifo(common::depth(200))).unwrap();
    let text = sensor.announce(&TEXT).unwrap();
    within(text.bound()).await;
    within(display.connected()).await;
    for number in 0..100 {
        text.publish(number).unwrap();
    }
    for number in 0..100 {
        assert_eq!(within(subscriber.next()).await.content, number);
    }
}

#[tokio::test]
async fn an_interface_that_goes_down_and_comes_back() {
    let (sensor, display) = (node(1), node(2));
    let subscriber = display.subscribe(&HEAT, Policy::Latest).unwrap();
    let heat = sensor.announce(&HEAT).unwrap();
    within(heat.bound()).await;
    within(display.connected()).await;
    set("down");
    within(async {
        while sensor.is_connected() || display.is_connected() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    })
    .await;
    assert!(sensor.link_error().unwrap().to_string().contains(INTERFACE));
    heat.publish(1).unwrap();
    // It expires while nothing can be sent.
    tokio::time::sleep(Duration::from_millis(100)).await;
    set("up");
    within(sensor.connected()).await;
    within(display.connected()).await;
    let event = loop {
        heat.publish(2).unwrap();
        if let Ok(event) = tokio::time::timeout(Duration::from_secs(1), subscriber.next()).await {
            break event;
        }
    };
    assert_eq!(event.content, 2, "what was stale has not been sent");
}

#[tokio::test]
async fn a_listener_sees_the_frames() {
    let tap = Tap::start(SocketCan::new(INTERFACE));
    while within(tap.next()).await.what != What::Connected {}
    let sensor = node(1);
    let text = sensor.announce(&TEXT).unwrap();
    within(text.bound()).await;
    text.publish(0xABCD).unwrap();
    let found = within(async {
        loop {
            if let What::Frame(frame) = tap.next().await.what
                && frame.id.etag().get() == 5001
            {
                return frame;
            }
        }
    });
    assert_eq!(found.await.payload.as_slice(), [0xAB, 0xCD]);
}

#[tokio::test]
async fn an_interface_that_is_not_there_is_named() {
    let node = Node::start(Config::new(uid(7)), SocketCan::new("can77")).unwrap();
    within(async {
        while node.link_error().is_none() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert!(node.link_error().unwrap().to_string().contains("can77"));
}
