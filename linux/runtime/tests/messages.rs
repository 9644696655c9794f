//! Messages of up to 1024 bytes from node to node, in virtual time.

mod common;

use std::time::Duration as Span;

use common::{Bed, depth};
use cosmic_core::Subject;
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::event_layer::{
    Bytes, Importance, MessageChannel, NonRealTimeAttributes, Policy, PublishError,
};
use cosmic_core::time::Duration;
use cosmic_linux::{Node, WAITING_MESSAGES};

type Journal = MessageChannel<Bytes<1024>, 1024, 4>;

const JOURNAL: Journal = MessageChannel::new(
    Subject::new(0x60).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::new(6000).unwrap());

fn bytes(length: usize, seed: u8) -> Bytes<1024> {
    let bytes: Vec<u8> = (0..length).map(|at| (at as u8).wrapping_mul(31).wrapping_add(seed)).collect();
    Bytes::new(&bytes).unwrap()
}

/// A station that joins takes part once it has seen eleven recessive bits.
async fn settled(node: &Node) {
    node.connected().await;
    tokio::time::sleep(Span::from_millis(1)).await;
}

#[tokio::test(start_paused = true)]
async fn messages_of_every_length_arrive_whole_and_in_their_order() {
    let bed = Bed::start().await;
    let (base, display) = (bed.node(1), bed.node(2));
    let journal = base.announce_messages(&JOURNAL).unwrap();
    let subscriber = display.subscribe_messages(&JOURNAL, Policy::Fifo(depth(20))).unwrap();
    journal.bound().await;
    settled(&display).await;
    let lengths = [0, 1, 7, 8, 12, 13, 100, 1023, 1024];
    let mut sent = lengths.iter();
    let mut next = sent.next();
    let mut got = Vec::new();
    while got.len() < lengths.len() {
        if let Some(length) = next {
            match journal.publish(&bytes(*length, 5)) {
                Ok(()) => next = sent.next(),
                Err(why) => assert_eq!(why, PublishError::QueueFull),
            }
        }
        while let Some(message) = subscriber.try_next() {
            assert_eq!(message.publisher, TxNode::new(1).unwrap());
            got.push(message.content.as_slice().len());
            assert_eq!(message.content, bytes(*got.last().unwrap(), 5));
        }
        tokio::time::sleep(Span::from_millis(1)).await;
    }
    assert_eq!(got, lengths);
    assert!(journal.is_idle());
    assert_eq!(subscriber.reassembly().delivered, lengths.len() as u32);
}

#[tokio::test(start_paused = true)]
async fn messages_of_several_nodes_are_told_apart() {
    let bed = Bed::start().await;
    let nodes = [1, 2, 3].map(|number| bed.node(number));
    let publishers = nodes.each_ref().map(|node| node.announce_messages(&JOURNAL).unwrap());
    let subscriber = nodes[0].subscribe_messages(&JOURNAL, Policy::Fifo(depth(20))).unwrap();
    for (node, publisher) in nodes.iter().zip(&publishers) {
        settled(node).await;
        publisher.bound().await;
    }
    for (seed, publisher) in (1..).zip(&publishers) {
        publisher.publish(&bytes(200, seed)).unwrap();
    }
    let mut seen = Vec::new();
    for _ in 0..3 {
        let message = subscriber.next().await;
        assert_eq!(message.content, bytes(200, message.publisher.get()));
        seen.push(message.publisher.get());
    }
    // Its own is among them.
    seen.sort_unstable();
    assert_eq!(seen, [1, 2, 3]);
}

#[tokio::test(start_paused = true)]
async fn what_finds_no_place_or_comes_too_late_is_counted() {
    let bed = Bed::start().await;
    let (base, display) = (bed.node(1), bed.node(2));
    let journal = base.announce_messages(&JOURNAL).unwrap();
    let also = base.announce_messages(&JOURNAL).unwrap();
    let few = display.subscribe_messages(&JOURNAL, Policy::Fifo(depth(2))).unwrap();
    let latest = display.subscribe_messages(&JOURNAL, Policy::Latest).unwrap();
    journal.bound().await;
    settled(&display).await;
    // It is of no use any more when the one before it has left.
    journal.publish(&bytes(1000, 0)).unwrap();
    also.publish_within(&bytes(9, 1), Some(Duration::from_millis(2))).unwrap();
    for seed in 2..=WAITING_MESSAGES as u8 {
        journal.publish(&bytes(9, seed)).unwrap();
    }
    assert_eq!(journal.publish(&bytes(9, 99)), Err(PublishError::QueueFull));
    while !journal.is_idle() {
        tokio::time::sleep(Span::from_millis(1)).await;
    }
    tokio::time::sleep(Span::from_millis(1)).await;
    assert_eq!(
        [few.try_next(), few.try_next(), few.try_next()].map(|it| it.map(|it| it.content)),
        [Some(bytes(1000, 0)), Some(bytes(9, 2)), None]
    );
    assert_eq!(latest.next().await.content, bytes(9, WAITING_MESSAGES as u8));
    let (sent, got) = (
        base.channel_counters(JOURNAL.subject()).unwrap(),
        display.channel_counters(JOURNAL.subject()).unwrap(),
    );
    assert_eq!((sent.refused, sent.discarded), (1, 1));
    let whole = WAITING_MESSAGES as u32;
    assert_eq!((got.overflowed, got.replaced), (whole - 2, whole - 1));
    // Who goes takes with him what waits, and the other goes on.
    drop(also);
    journal.publish(&bytes(9, 7)).unwrap();
    assert_eq!(latest.next().await.content, bytes(9, 7));
    drop(few);
    drop(journal);
    assert!(base.announce_messages(&JOURNAL).is_ok());
}

/// A sender that stops in the middle, and one that sends what no fragmenter makes.
#[tokio::test(start_paused = true)]
async fn a_message_that_stops_is_given_up() {
    let bed = Bed::start().await;
    let display = bed.node(2);
    let subscriber = display.subscribe_messages(&JOURNAL, Policy::Fifo(depth(2))).unwrap();
    settled(&display).await;
    let mut raw = bed.raw().await;
    let id = Id::new(Priority::LEAST, TxNode::new(9).unwrap(), Etag::new(6000).unwrap());
    raw.send(Frame::new(id, Payload::new(&[0x80, 1, 2, 3, 4, 5, 6, 7]).unwrap())).await;
    raw.send(Frame::new(id, Payload::EMPTY)).await;
    tokio::time::sleep(Span::from_secs(3)).await;
    let seen = subscriber.reassembly();
    assert_eq!((seen.delivered, seen.timed_out, seen.malformed), (0, 1, 1));
    assert!(subscriber.try_next().is_none());
}
