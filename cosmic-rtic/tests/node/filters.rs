//! What the controller is told to accept, while names and subscriptions come and go.

use std::cell::RefCell;
use std::collections::VecDeque;

use cosmic_core::can::filter_banks::{Fifo, Wanted};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use cosmic_core::event_layer::{Channel, SoftAttributes};
use cosmic_core::plan::NodePlan;
use cosmic_core::services::{Declaration, NodeView, Request, Services, TooMany};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::uid::Subject;
use cosmic_rtic::{Node, Parts, Publisher, StartError, Storage, Subscriber, System, Timed, start};

use crate::bench::*;

/// Services that give the names that the test tells them.
struct Namer(VecDeque<Request>);

impl Services for Namer {
    const GIVES_TX_NODE: bool = true;

    fn on_frame(&mut self, _: &Frame, _: Instant) {}

    fn on_sent(&mut self, _: &Frame, _: Instant) {}

    fn declare(&mut self, _: &Declaration) -> Result<(), TooMany> {
        Ok(())
    }

    fn poll(&mut self, _: Instant, _: &NodeView) -> Option<Request> {
        self.0.pop_front()
    }

    fn next_wakeup(&self) -> Instant {
        Instant::FAR_FUTURE
    }

    fn global_clock(&self) -> GlobalClock {
        GlobalClock::free_running()
    }
}

impl Timed for Namer {
    fn planned(_: &NodePlan, _: Instant) -> Result<Self, StartError> {
        Ok(Self(VecDeque::new()))
    }
}

struct Named;

impl System for Named {
    type Board = Bench;
    type Capacity = Room;
    type Services = Namer;
    type Observer = ();
}

/// A broker names it.
const COLD: Channel<u16> = Channel::soft(
    Subject::new(0xC4).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(20) },
);
const LAST: TxNode = TxNode::new(0x7E).unwrap();

fn tx_node(tx_node: TxNode) -> Wanted {
    Wanted::tx_node(Fifo::Other, tx_node)
}

fn etag(value: u16) -> Wanted {
    Wanted::etag(Fifo::Other, Etag::new(value).unwrap())
}

fn bound(value: u16) -> Request {
    Request::Bound(COLD.subject(), Etag::new(value).unwrap())
}

/// What is wanted after the services have asked for this.
fn after(request: Request, events: &mut cosmic_rtic::Events, node: &RefCell<Node<Named>>) -> Vec<Wanted> {
    node.borrow_mut().ask_services(|services| services.0.push_back(request));
    run_events(events, node);
    WANTED.take().expect("something has changed")
}

#[test]
fn the_controller_accepts_what_is_subscribed_to_under_the_names_of_now() {
    let storage = Box::leak(Box::new(Storage::<Named>::new()));
    let Parts { node, mut events, mut other, .. } = start::<Named>(Bench, &PLAN, storage).unwrap();
    let node = RefCell::new(node);
    run_events(&mut events, &node);
    assert_eq!(WANTED.take(), Some(vec![tx_node(OWN)]));
    run_events(&mut events, &node);
    assert_eq!(WANTED.take(), None, "nothing has changed");

    // A channel that has no etag yet; then a broker gives it one, then a new broker another.
    let cold = Subscriber::subscribe(&COLD, QUEUE, &mut Resource(&node)).unwrap();
    assert_eq!(WANTED.take(), Some(vec![tx_node(OWN)]));
    assert_eq!(after(bound(5_000), &mut events, &node), [tx_node(OWN), etag(5_000)]);
    assert_eq!(after(bound(6_000), &mut events, &node), [tx_node(OWN), etag(6_000)]);
    let payload = Payload::new(&[0, 7]).unwrap();
    let frame = Frame::new(Id::new(Priority::new(100), OTHER, Etag::new(6_000).unwrap()), payload);
    RECEIVED.with_borrow_mut(|received| received.push_back(frame));
    other.run();
    run_events(&mut events, &node);
    assert_eq!(cold.try_next(&mut Resource(&node)).map(|event| event.content), Some(7));

    // Who only publishes on a channel does not want to hear others; who subscribes, too, does, until it cancels that.
    let heat = Publisher::announce(&HEAT, &mut Resource(&node)).unwrap();
    assert_eq!(WANTED.take(), Some(vec![tx_node(OWN), etag(6_000)]));
    let heard = Subscriber::subscribe(&HEAT, QUEUE, &mut Resource(&node)).unwrap();
    assert_eq!(WANTED.take(), Some(vec![tx_node(OWN), etag(6_000), etag(ETAG.get())]));
    heard.cancel(&mut Resource(&node));
    run_events(&mut events, &node);
    assert_eq!(WANTED.take(), Some(vec![tx_node(OWN), etag(6_000)]));
    heat.cancel(&mut Resource(&node));

    // The node is given another id, and loses it.
    assert_eq!(after(Request::TxNode(Some(LAST)), &mut events, &node), [tx_node(LAST), etag(6_000)]);
    assert_eq!(after(Request::TxNode(None), &mut events, &node), [etag(6_000)]);

    // The broker takes the etag back, or the channel is cancelled, and announced again.
    assert_eq!(after(Request::Unbound(COLD.subject()), &mut events, &node), []);
    assert_eq!(after(bound(0x3FFF), &mut events, &node), [etag(0x3FFF)]);
    cold.cancel(&mut Resource(&node));
    run_events(&mut events, &node);
    assert_eq!(WANTED.take(), Some(vec![]));
    let _cold = Subscriber::subscribe(&COLD, QUEUE, &mut Resource(&node)).unwrap();
    assert_eq!(after(bound(0x3FFF), &mut events, &node), [etag(0x3FFF)]);
}

#[test]
fn a_node_that_nobody_names_keeps_the_filters_of_its_plan() {
    let Parts { node, mut events, .. } = parts();
    let node = RefCell::new(node);
    let _heat = Subscriber::subscribe(&HEAT, QUEUE, &mut Resource(&node)).unwrap();
    run_events(&mut events, &node);
    assert_eq!(WANTED.take(), None);
}
