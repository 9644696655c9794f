//! A socket pair stands in for the kernel, which has no CAN everywhere: same bytes, same order of calls.

use std::os::fd::OwnedFd;
use std::os::unix::net::UnixDatagram;
use std::time::Duration;

use cosmic_core::NodeUid;
use cosmic_core::Subject;
use cosmic_core::can::{Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, ExceptionKind, Importance, NonRealTimeAttributes, Policy, SoftAttributes,
};

use super::*;
use crate::{Config, Node};

const HEAT: Channel<u8> = Channel::soft(
    Subject::new(0x2A).unwrap(),
    SoftAttributes {
        deadline: cosmic_core::time::Duration::from_millis(20),
        validity: cosmic_core::time::Duration::from_millis(50),
    },
)
.with_etag(Etag::new(5000).unwrap());
const TEXT: Channel<u8> = Channel::non_real_time(
    Subject::new(0x2B).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::new(5001).unwrap());

/// Hands out the near end of a socket pair for each connection.
struct Pair(Vec<OwnedFd>);

impl Link for Pair {
    async fn run(&mut self, port: &Port) -> LinkError {
        match self.0.pop() {
            Some(socket) => LinkError::new(carry(socket, port).await.unwrap_err()),
            None => LinkError::last("no more sockets"),
        }
    }
}

/// The kernel's side of a pair.
struct Kernel(UnixDatagram);

impl Kernel {
    fn pair() -> (Self, OwnedFd) {
        let (far, near) = UnixDatagram::pair().unwrap();
        for socket in [&far, &near] {
            socket.set_nonblocking(true).unwrap();
        }
        (Self(far), near.into())
    }

    /// The next event that the node has handed over, no control frames.
    async fn event(&self) -> Option<[u8; CAN_FRAME]> {
        for _ in 0..200 {
            let mut bytes = [0; CAN_FRAME];
            match self.0.recv(&mut bytes) {
                Ok(_) => match decode(&bytes) {
                    Decoded::Frame(frame) if !frame.id.etag().is_reserved() => return Some(bytes),
                    _ => self.echo(bytes),
                },
                Err(_) => tokio::time::sleep(Duration::from_micros(500)).await,
            }
        }
        None
    }

    fn echo(&self, mut bytes: [u8; CAN_FRAME]) {
        bytes[5] = ECHO_IN_TESTS;
        self.0.send(&bytes).unwrap();
    }
}

fn node(sockets: Vec<OwnedFd>) -> Node {
    let config = Config::new(NodeUid::new(7).unwrap()).tx_node(TxNode::new(7).unwrap());
    Node::start(config, Pair(sockets)).unwrap()
}

fn content(bytes: [u8; CAN_FRAME]) -> u8 {
    bytes[8]
}

#[tokio::test(start_paused = true)]
async fn one_frame_of_each_class_is_in_the_kernel_until_its_echo() {
    let (kernel, near) = Kernel::pair();
    let node = node(vec![near]);
    let (heat, text) = (node.announce(&HEAT).unwrap(), node.announce(&TEXT).unwrap());
    heat.bound().await;
    for number in [1, 2] {
        text.publish(10 + number).unwrap();
        heat.publish(number).unwrap();
    }
    let (first, second) = (kernel.event().await.unwrap(), kernel.event().await.unwrap());
    let mut contents = [content(first), content(second)];
    contents.sort();
    assert_eq!(contents, [1, 11], "one of each class");
    assert_eq!(kernel.event().await, None, "the others wait for the echo");
    let sent = node.link_counters().sent;
    kernel.echo(if content(first) == 11 { first } else { second });
    assert_eq!(kernel.event().await.map(content), Some(12));
    assert_eq!(node.link_counters().sent, sent + 1);
    // The soft one waited in the node and has expired by now; it is not handed over any more.
    kernel.echo(if content(first) == 1 { first } else { second });
    assert_eq!(kernel.event().await, None);
    assert_eq!(node.exceptions(ExceptionKind::ValidityExpired), 1);
}

#[tokio::test(start_paused = true)]
async fn frames_of_others_and_echoes_are_told_apart() {
    let (kernel, near) = Kernel::pair();
    let node = node(vec![near]);
    let heat = node.subscribe(&HEAT, Policy::Latest).unwrap();
    let id = Id::new(cosmic_core::can::Priority::new(3), TxNode::new(9).unwrap(), Etag::new(5000).unwrap());
    let theirs = encode(&Frame::new(id, Payload::new(&[42]).unwrap()));
    kernel.0.send(&theirs).unwrap();
    assert_eq!(heat.next().await.content, 42);
    // An echo of nothing, a standard frame, a length of nine, half a frame.
    kernel.echo(theirs);
    let mut standard = theirs;
    standard[..4].copy_from_slice(&0x123_u32.to_ne_bytes());
    let mut nine = theirs;
    nine[4] = 9;
    for bytes in [&standard[..], &nine, &theirs[..9]] {
        kernel.0.send(bytes).unwrap();
    }
    tokio::time::sleep(Duration::from_millis(5)).await;
    assert!(heat.try_next().is_none());
    let counters = node.link_counters();
    assert_eq!((counters.foreign, counters.malformed), (1, 2));
}

#[tokio::test(start_paused = true)]
async fn a_controller_that_leaves_the_bus_is_told_and_the_link_connects_anew() {
    let (first, near_first) = Kernel::pair();
    let (second, near_second) = Kernel::pair();
    let node = node(vec![near_second, near_first]);
    let text = node.announce(&TEXT).unwrap();
    text.bound().await;
    text.publish(1).unwrap();
    assert_eq!(first.event().await.map(content), Some(1));
    let mut bus_off = [0; CAN_FRAME];
    let id = libc::CAN_ERR_FLAG | CAN_ERR_BUSOFF | CAN_ERR_CNT;
    bus_off[..4].copy_from_slice(&id.to_ne_bytes());
    bus_off[4] = 8;
    first.0.send(&bus_off).unwrap();
    assert_eq!(second.event().await.map(content), Some(1), "the kernel has dropped it");
    assert_eq!(node.exceptions(ExceptionKind::BusOff), 1);
    let counters = node.link_counters();
    assert_eq!(counters.connections, 2);
    assert!(counters.repeated >= 1);
}

#[test]
fn an_interface_that_is_not_there_gets_one_clear_line() {
    let why = open("no-such-interface").unwrap_err();
    assert!(
        why.starts_with("there is no such interface") || why.starts_with("the kernel has no CAN"),
        "{why}"
    );
}
