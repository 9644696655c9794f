//! Nodes on IP alone.

use std::time::Duration as Span;

use crate::bed::{HEAT, HEAT_TABLE, Segment, Setup, fifo, name, port, until};
use cosmic_core::Subject;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::{
    Attribute, Bytes, Channel, Context, Event, HardAttributes, Importance, MessageChannel,
    NonRealTimeAttributes, Policy, PublishError,
};
use cosmic_core::protocol::Class;
use cosmic_core::time::Duration;
use cosmic_gateway::config::{Ip, Mode};
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::ip::{IpError, Node};
use cosmic_linux::AnnounceError;

fn at(port: u16) -> Ip {
    Ip { mode: Mode::Peer, connect: vec![format!("tcp/127.0.0.1:{port}")], ..Ip::default() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_on_ip_publishes_and_subscribes_as_one_on_a_segment() {
    let bus = Segment::start().await;
    let listen = port();
    let more = "etags = { heat = 5000, gateways = 5001 }";
    let gateway =
        Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect: &[], more, channels: HEAT_TABLE };
    let gateway = gateway.start().await;
    let node = Node::start(&at(listen), &name("test"), &name("desk")).await.unwrap();
    let heat = HEAT.with_etag(Etag::new(5000).unwrap());
    let on_bus = bus.node(7);
    let on_ip = node.subscribe(&HEAT, fifo(100)).await.unwrap();
    let second = node.subscribe(&HEAT, Policy::Latest).await.unwrap();
    let from_bus = on_bus.announce(&heat).unwrap();
    from_bus.bound().await;
    until("the clocks are known", || node.others().1 == 1 && gateway.others().1 == 1).await;
    let mut number = 0;
    until("an event reaches IP", || {
        number += 1;
        let _ = from_bus.publish(number);
        on_ip.try_next().is_some()
    })
    .await;
    // Both subscribers of the node have it.
    until("the second subscriber has it", || second.try_next().is_some()).await;
    tokio::time::sleep(Span::from_millis(100)).await;
    while on_ip.try_next().is_some() {}
    from_bus.publish(-40).unwrap();
    let event = tokio::time::timeout(crate::bed::PATIENCE, on_ip.next()).await.unwrap();
    assert_eq!((event.content, event.class), (-40, Class::Soft));
    assert_eq!((event.origin.segment, event.origin.node), (name("plant"), TxNode::new(7)));
    let (deadline, expires_at) = (event.deadline.unwrap(), event.expires_at.unwrap());
    assert_eq!(expires_at.saturating_since(deadline), Duration::from_millis(500));
    drop((on_ip, second));
    // The other way.
    let on_bus = on_bus.subscribe(&heat, fifo(100)).unwrap();
    let from_ip = node.announce(&HEAT).await.unwrap();
    tokio::time::timeout(crate::bed::PATIENCE, from_ip.wanted()).await.unwrap();
    from_ip.publish(77).unwrap();
    let event = tokio::time::timeout(crate::bed::PATIENCE, on_bus.next()).await.unwrap();
    assert_eq!((event.content, event.publisher), (77, TxNode::new(100).unwrap()));
    let past = node.now().saturating_sub(Duration::from_millis(1));
    assert_eq!(from_ip.publish_event(&Event::new(1).deadline(past)), Err(PublishError::Deadline));
    drop(on_bus);
    until("nobody wants it any more", || !from_ip.is_wanted()).await;
    assert_eq!(node.count(Direction::Out, Outcome::Forwarded), 1);
}

const LOG: MessageChannel<Bytes<200>, 200, 4> = MessageChannel::new(
    Subject::new(0xC05A_0000_0000_0003).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_come_whole_to_a_node_on_ip_and_from_it() {
    let (bus, listen) = (Segment::start().await, port());
    let more = "etags = { log = 5000, gateways = 5001 }";
    let channels = crate::messages::TABLE;
    let gateway = Setup { segment: "plant", bus: &bus, tx_node: 100, listen, connect: &[], more, channels };
    let gateway = gateway.start().await;
    let node = Node::start(&at(listen), &name("test"), &name("desk")).await.unwrap();
    let (log, on_bus) = (LOG.with_etag(Etag::new(5000).unwrap()), bus.node(7));
    let on_ip = node.subscribe_messages(&LOG, fifo(100)).await.unwrap();
    let from_bus = on_bus.announce_messages(&log).unwrap();
    from_bus.bound().await;
    until("the clocks are known", || node.others().1 == 1 && gateway.others().1 == 1).await;
    let long = Bytes::new(&[0xA5; 200]).unwrap();
    let mut message = None;
    until("a message reaches IP", || {
        let _ = from_bus.publish(&long);
        message = on_ip.try_next();
        message.is_some()
    })
    .await;
    let message = message.unwrap();
    assert_eq!((message.content, message.class, message.deadline), (long, Class::NonRealTime, None));
    assert_eq!((message.origin.segment, message.origin.node), (name("plant"), TxNode::new(7)));
    drop(on_ip);
    // The other way: one of several frames, and one that fits into a frame.
    let on_bus = on_bus.subscribe_messages(&log, fifo(100)).unwrap();
    let from_ip = node.announce_messages(&LOG).await.unwrap();
    tokio::time::timeout(crate::bed::PATIENCE, from_ip.wanted()).await.unwrap();
    for content in [[1; 200].as_slice(), b"short"] {
        let content = Bytes::new(content).unwrap();
        from_ip.publish(&content).unwrap();
        // What this node has published itself may still come behind.
        let from_gateway = async {
            loop {
                let message = on_bus.next().await;
                if message.publisher == TxNode::new(100).unwrap() {
                    return message;
                }
            }
        };
        let message = tokio::time::timeout(crate::bed::PATIENCE, from_gateway).await.unwrap();
        assert_eq!(message.content, content);
    }
    // One that is of no use any more when it comes.
    from_ip.publish_within(&long, Some(Duration::from_ticks(1))).unwrap();
    until("it has expired", || {
        let of_plant = crate::bed::count(&gateway, "plant", Direction::In, Outcome::Expired);
        of_plant + gateway.unassigned().get(Outcome::Expired) == 1
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_nodes_on_ip_need_no_gateway_and_hard_real_time_is_refused() {
    let listen = port();
    let server = Ip { mode: Mode::Router, listen: vec![format!("tcp/127.0.0.1:{listen}")], ..Ip::default() };
    let one = Node::start(&server, &name("test"), &name("one")).await.unwrap();
    let other = Node::start(&at(listen), &name("test"), &name("other")).await.unwrap();
    let subscriber = other.subscribe(&HEAT, fifo(10)).await.unwrap();
    let publisher = one.announce(&HEAT).await.unwrap();
    tokio::time::timeout(crate::bed::PATIENCE, publisher.wanted()).await.unwrap();
    until("the clock is known", || other.others().1 == 1).await;
    publisher.publish(5).unwrap();
    let event = tokio::time::timeout(crate::bed::PATIENCE, subscriber.next()).await.unwrap();
    assert_eq!((event.content, event.origin.segment, event.origin.node), (5, name("one"), None));
    // One that is refused draws no number: the others do not miss it.
    let unfit = Event::new(1).context(Context::EMPTY.with(Attribute::Confidence, 1).unwrap());
    assert_eq!(publisher.publish_event(&unfit), Err(PublishError::TooLong));
    publisher.publish(6).unwrap();
    let event = tokio::time::timeout(crate::bed::PATIENCE, subscriber.next()).await.unwrap();
    assert_eq!((event.content, other.count(Direction::In, Outcome::Missing)), (6, 0));
    let hard: Channel<u8> = Channel::hard(
        Subject::new(0x99).unwrap(),
        Etag::HARD_FIRST,
        HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
    );
    let refused = one.announce(&hard).await.err().unwrap();
    assert_eq!(refused, IpError::Announce(AnnounceError::HardRealTime));
    // The port is taken.
    let why = Node::start(&server, &name("test"), &name("third")).await.err().unwrap().to_string();
    assert!(why.contains("another program listens at tcp/127.0.0.1"), "{why}");
    one.stop().await;
}
