//! python-can, a client that others wrote, exchanges frames with a node: by slcan over pseudo terminals, and by
//! socketcand over TCP.
//!
//! `COSMIC_PYTHON` names a Python that has python-can; `cargo xtask test linux` makes one.

mod common;

use std::process::Stdio;
use std::time::Duration;

use common::{HEAT, TEXT, uid};
use cosmic_core::can::{BitRate, TxNode};
use cosmic_core::event_layer::Policy;
use cosmic_linux::link::slcan::Slcan;
use cosmic_linux::link::socketcand::Socketcand;
use cosmic_linux::{Config, Link, Node};
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, Command};

const EVENTS: u16 = 500;
const PATIENCE: Duration = Duration::from_secs(60);

/// The far end, and where it is.
async fn far_end(kind: &str) -> (Child, String) {
    let python = std::env::var_os("COSMIC_PYTHON").expect("COSMIC_PYTHON names a Python with python-can");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/python_can.py");
    let mut command = Command::new(python);
    command.args([script, kind, &EVENTS.to_string()]).kill_on_drop(true);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("Python runs");
    let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
    let line = tokio::time::timeout(PATIENCE, lines.next_line()).await.expect("it starts");
    (child, line.expect("text").expect("it says where it is"))
}

/// Each event is published when the one before it has been answered, so nothing depends on who is faster.
async fn exchange(link: impl Link, mut far_end: Child) {
    let node = Node::start(Config::new(uid(7)).tx_node(TxNode::new(7).unwrap()), link).unwrap();
    let answers = node.subscribe(&TEXT, Policy::Fifo(common::depth(8))).unwrap();
    let heat = node.announce(&HEAT).unwrap();
    tokio::time::timeout(PATIENCE, async {
        heat.bound().await;
        node.connected().await;
        for number in 0..EVENTS {
            // An event on a busy machine may expire before its link takes it; nothing else may happen to it.
            let answer = loop {
                heat.publish(number.cast_signed()).unwrap();
                match tokio::time::timeout(Duration::from_secs(5), answers.next()).await {
                    Ok(answer) => break answer,
                    Err(_) => {
                        let counters = node.channel_counters(HEAT.subject()).unwrap();
                        assert!(counters.discarded > 0, "sent, and not answered: {counters:?}");
                    }
                }
            };
            assert_eq!((answer.content, answer.publisher.get()), (number, 9));
        }
    })
    .await
    .expect("all are answered");
    let counters = node.link_counters();
    assert_eq!((counters.foreign, counters.malformed, counters.lost), (0, 0, 0), "{counters:?}");
    drop(far_end.stdin.take());
    assert!(far_end.wait().await.unwrap().success());
}

#[tokio::test]
#[ignore = "needs python-can: cargo xtask test linux"]
async fn slcan_over_a_pseudo_terminal() {
    let (child, path) = far_end("slcan").await;
    exchange(Slcan::new(path, BitRate::MAX).unwrap(), child).await;
}

#[tokio::test]
#[ignore = "needs python-can: cargo xtask test linux"]
async fn socketcand_over_tcp() {
    let (child, address) = far_end("socketcand").await;
    exchange(Socketcand::new(address, "can0", BitRate::MAX), child).await;
}
