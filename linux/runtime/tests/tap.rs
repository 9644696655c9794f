//! A tap on a simulated segment: hears all, sends as told, stamps as the segment does.

mod common;

use common::{Bed, HEAT, speed_frame};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::time::Instant;
use cosmic_linux::link::segment::SegmentLink;
use cosmic_linux::{NotSent, Tap, What};

async fn connected(bed: &Bed) -> Tap {
    let tap = Tap::start(SegmentLink::new(bed.path()));
    while tap.next().await.what != What::Connected {}
    tap
}

async fn frame(tap: &Tap) -> (Instant, Frame) {
    loop {
        let tapped = tap.next().await;
        if let What::Frame(frame) = tapped.what {
            return (tapped.at, frame);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn it_hears_a_node_and_is_no_node_itself() {
    let bed = Bed::start().await;
    let tap = connected(&bed).await;
    let node = bed.node(3);
    let heat = node.announce(&HEAT).unwrap();
    heat.bound().await;
    heat.publish(21).unwrap();
    let (mut published, mut nodes) = (None, Vec::new());
    while published.is_none() {
        let (_, frame) = frame(&tap).await;
        nodes.push(frame.id.tx_node());
        published = Some(frame).filter(|frame| frame.id.etag() == Etag::new(5000).unwrap());
    }
    assert_eq!(published.unwrap().payload.as_slice(), [0, 21]);
    assert!(nodes.iter().all(|tx_node| *tx_node == TxNode::new(3).unwrap()));
}

#[tokio::test(start_paused = true)]
async fn frames_keep_their_order_and_the_stamps_of_the_segment() {
    let bed = Bed::start().await;
    let (mut sender, listener) = (connected(&bed).await, connected(&bed).await);
    // The later ones would win arbitration.
    let frames = [255_u8, 200, 9, 0].map(|priority| {
        Frame::new(Id::new(Priority::new(priority), TxNode::MIN, Etag::BOUND_LAST), Payload::EMPTY)
    });
    for frame in frames {
        sender.send(frame).await.unwrap();
    }
    let mut before = Instant::EPOCH;
    for expected in frames {
        let (at, heard) = frame(&listener).await;
        assert_eq!(heard, expected);
        // A frame without data has 67 bits and more.
        assert!(before == Instant::EPOCH || at.saturating_since(before).as_micros() >= 67);
        before = at;
    }
}

#[tokio::test(start_paused = true)]
async fn what_nobody_fetches_is_counted() {
    let bed = Bed::start().await;
    let (mut sender, listener) = (connected(&bed).await, connected(&bed).await);
    let surplus = 100;
    for number in 0..Tap::MOST_WAITING + surplus {
        sender.send(speed_frame(number as u8)).await.unwrap();
    }
    let (mut frames, mut lost) = (0, 0);
    while frames + lost < Tap::MOST_WAITING + surplus {
        match listener.next().await.what {
            What::Frame(_) => frames += 1,
            What::Lost(count) => lost += count as usize,
            _ => {}
        }
    }
    assert_eq!((frames, lost), (Tap::MOST_WAITING, surplus));
}

#[tokio::test(start_paused = true)]
async fn a_lost_connection_is_told_and_made_again() {
    let bed = Bed::start().await;
    let mut tap = connected(&bed).await;
    bed.stop().await;
    let why = loop {
        if let What::Disconnected { why, ends: false } = tap.next().await.what {
            break why;
        }
    };
    assert!(why.to_string().starts_with("segment at "), "{why}");
    assert_eq!(tap.send(speed_frame(1)).await, Err(NotSent));
    bed.restart().await;
    while tap.next().await.what != What::Connected {}
    tap.send(speed_frame(2)).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_cancelled_send_is_out_of_the_way_of_the_next() {
    let bed = Bed::start().await;
    let (mut sender, listener) = (connected(&bed).await, connected(&bed).await);
    // Given up before the link could do anything, and given up when the link had the frame.
    for turn in [0, 1] {
        let given_up = async {
            for _ in 0..turn {
                tokio::task::yield_now().await;
            }
        };
        tokio::select! {
            biased;
            () = given_up => {}
            _ = sender.send(speed_frame(1)) => {}
        }
        sender.send(speed_frame(2 + turn)).await.unwrap();
    }
    let mut last = frame(&listener).await.1;
    while last != speed_frame(3) {
        last = frame(&listener).await.1;
    }
}
