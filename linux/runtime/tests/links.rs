//! Links that are tried over sockets and files: what they carry, not how fast.

mod common;

use std::io::Write as _;
use std::time::Duration;

use common::{HEAT, TEXT, uid};
use cosmic_core::can::{BitRate, Etag, Frame, Mailbox, TxNode};
use cosmic_core::event_layer::Policy;
use cosmic_linux::link::candump::Candump;
use cosmic_linux::link::segment::{Record, SegmentLink, VERSION};
use cosmic_linux::link::slcan::Slcan;
use cosmic_linux::link::socketcand::Socketcand;
use cosmic_linux::{Config, Link, Node};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};

const PATIENCE: Duration = Duration::from_secs(20);

fn node(link: impl Link) -> Node {
    Node::start(Config::new(uid(7)).tx_node(TxNode::new(7).unwrap()), link).unwrap()
}

async fn within<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("it comes")
}

/// A server of one client, which greets and answers as socketcand does.
async fn greet(listener: &TcpListener) -> TcpStream {
    let (mut stream, _) = listener.accept().await.unwrap();
    stream.write_all(b"< hi >").await.unwrap();
    for command in ["< open can0 >", "< rawmode >"] {
        let mut bytes = vec![0; command.len()];
        stream.read_exact(&mut bytes).await.unwrap();
        assert_eq!(String::from_utf8(bytes).unwrap(), command);
        stream.write_all(b"< ok >").await.unwrap();
    }
    stream
}

async fn read_until(stream: &mut TcpStream, wanted: &str) -> String {
    let mut text = String::new();
    let mut buffer = [0; 256];
    while !text.contains(wanted) {
        let count = stream.read(&mut buffer).await.unwrap();
        assert!(count > 0, "closed behind {text}");
        text.push_str(std::str::from_utf8(&buffer[..count]).unwrap());
    }
    text
}

#[tokio::test]
async fn socketcand_carries_both_ways_and_connects_anew() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let node = node(Socketcand::new(address, "can0", BitRate::MAX));
    let subscriber = node.subscribe(&HEAT, Policy::Latest).unwrap();
    let heat = node.announce(&TEXT).unwrap();
    let mut server = within(greet(&listener)).await;
    within(heat.bound()).await;
    heat.publish(0xABCD).unwrap();
    // TEXT has importance 4, so priority 255, TxNode 7, etag 5001.
    within(read_until(&mut server, "< send 1FE1D389 2 AB CD >")).await;
    // Priority 3, TxNode 9, etag 5000; and in pieces.
    server.write_all(b"< frame 00625388 12.5 ").await.unwrap();
    server.write_all(b"002A >< frame 123 12.5 00 >nonsense>").await.unwrap();
    let event = within(subscriber.next()).await;
    assert_eq!((event.content, event.publisher.get()), (42, 9));
    while node.link_counters().malformed == 0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(node.link_counters().foreign, 1);
    drop(server);
    let mut server = within(greet(&listener)).await;
    server.write_all(b"< frame 00625388 12.5 002B >").await.unwrap();
    assert_eq!(within(subscriber.next()).await.content, 43);
    assert_eq!(node.link_counters().connections, 2);
}

/// With tokio's clock stopped, so that it does not matter how fast this runs.
#[tokio::test(start_paused = true)]
async fn a_log_is_replayed_and_cannot_be_sent_to() {
    let mut log = tempfile::NamedTempFile::new().unwrap();
    log.write_all(
        b"(10.000000) can0 00625388#002A\n\
          (10.000500) can1 00625388#0001\n\
          (10.001000) can0 123#00\n\
          rubbish\n\
          (10.002000) can0 00625388#002B\n",
    )
    .unwrap();
    let node = node(Candump::new(log.path()).interface("can0"));
    let subscriber = node.subscribe(&HEAT, Policy::Fifo(common::depth(4))).unwrap();
    let text = node.announce(&TEXT).unwrap();
    within(text.bound()).await;
    text.publish(1).unwrap();
    let (first, second) = (within(subscriber.next()).await, within(subscriber.next()).await);
    assert_eq!((first.content, second.content), (42, 43));
    let apart = second.received_at.saturating_since(first.received_at);
    assert!(apart >= cosmic_core::time::Duration::from_micros(1_900), "{apart}");
    let counters = node.link_counters();
    assert_eq!((counters.received, counters.foreign, counters.malformed), (2, 1, 1));
    assert!(counters.unsent >= 1);
    assert!(subscriber.try_next().is_none());
}

#[tokio::test]
async fn a_log_that_is_not_there_is_said_to_be_missing() {
    let node = node(Candump::new("/nowhere/a.log"));
    let why = within(node.connected_or_failed()).await.unwrap_err();
    assert!(why.to_string().starts_with("log /nowhere/a.log: cannot be opened"), "{why}");
    assert_eq!(node.link_error(), Some(why));
}

#[tokio::test]
async fn a_device_that_is_not_there_is_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let node = node(Slcan::new(folder.path().join("tty"), BitRate::MAX).unwrap());
    assert!(tokio::time::timeout(Duration::from_millis(50), node.connected()).await.is_err());
    assert_eq!(node.link_counters().connections, 0);
    assert!(node.link_error().unwrap().to_string().contains("cannot be opened"));
    assert!(tokio::time::timeout(Duration::from_millis(50), node.connected_or_failed()).await.is_err());
}

#[tokio::test]
async fn a_log_of_another_kind_is_refused() {
    let mut log = tempfile::NamedTempFile::new().unwrap();
    log.write_all(b"\x0a\x0d\x0d\x0a\x1c\0\0\0").unwrap();
    let node = node(Candump::new(log.path()));
    let why = within(node.connected_or_failed()).await.unwrap_err().to_string();
    assert!(why.contains("it is pcapng") && why.contains("cosmic record"), "{why}");
}

/// A server of a segment, for one client.
async fn greet_on_segment(listener: &UnixListener) -> UnixStream {
    let (mut stream, _) = listener.accept().await.unwrap();
    let hello = Record::Hello { version: VERSION, bits_per_second: 1_000_000 };
    stream.write_all(&hello.encode()).await.unwrap();
    stream
}

/// Who publishes writes to the segment itself. What it has written when the connection breaks is written again to the next
/// server, and so is what is published meanwhile.
#[tokio::test]
async fn a_frame_that_was_under_way_when_a_segment_went_is_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("segment");
    let listener = UnixListener::bind(&path).unwrap();
    let node = node(SegmentLink::new(&path));
    let text = node.announce(&TEXT).unwrap();
    let mut server = within(greet_on_segment(&listener)).await;
    within(text.bound()).await;
    // Of what the node says of itself nothing is answered, so its mailbox stays full.
    let first = within(loaded(&mut server)).await;
    text.publish(1).unwrap();
    drop(server);
    text.publish(2).unwrap();
    let mut server = within(greet_on_segment(&listener)).await;
    let mut next = within(loaded(&mut server)).await;
    assert_eq!(next, first);
    assert_eq!(node.link_counters().repeated, 1);
    let mut contents = Vec::new();
    loop {
        let (mailbox, frame) = next;
        if frame.id.etag() == Etag::new(5001).unwrap() {
            contents.push(frame.payload.padded()[1]);
        }
        if contents.len() == 2 {
            break;
        }
        server.write_all(&Record::Sent { mailbox }.encode()).await.unwrap();
        next = within(loaded(&mut server)).await;
    }
    assert_eq!(contents, [1, 2]);
}

/// The next frame that is put into a mailbox.
async fn loaded(server: &mut UnixStream) -> (Mailbox, Frame) {
    let mut bytes = [0; Record::LEN];
    server.read_exact(&mut bytes).await.unwrap();
    match Record::decode(&bytes) {
        Some(Record::Load { mailbox, frame }) => (mailbox, Frame::try_from(frame).unwrap()),
        other => panic!("{other:?}"),
    }
}
