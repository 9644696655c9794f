//! A node on a board that is only values: what the parts of the runtime hand to each other.

mod bench;
mod filters;
mod loops;
mod messages;
mod readme;

use std::cell::RefCell;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use bench::*;
use cosmic_core::can::{Frame, Id, Mailbox, Outcome, Payload, Priority};
use cosmic_core::event_layer::ExceptionKind;
use cosmic_core::plan::NodePlan;
use cosmic_core::protocol::Rank;
use cosmic_core::seal::Seal;
use cosmic_core::services::{FollowingServices, PlannedServices};
use cosmic_core::sync::{SyncConfig, SyncConfigError};
use cosmic_core::time::Instant;
use cosmic_rtic::{Parts, Publisher, StartError, Subscriber, Timed as _};

#[test]
fn published_events_take_turns_in_the_mailbox() {
    let Parts { node, mut events, mut outcomes, .. } = parts();
    let node = RefCell::new(node);
    let heat = Publisher::announce(&HEAT, &mut Resource(&node)).unwrap();
    heat.publish(1, &mut Resource(&node)).unwrap();
    heat.publish(2, &mut Resource(&node)).unwrap();
    let loaded = LOADED.take();
    assert_eq!(loaded.len(), 1, "the second waits until the first has left");
    assert_eq!((loaded[0].0, loaded[0].1.payload.as_slice()), (Mailbox::Soft, &[0, 1][..]));
    OUTCOMES.with_borrow_mut(|outcomes| outcomes.push_back((Mailbox::Soft, Outcome::Sent)));
    outcomes.run();
    run_events(&mut events, &node);
    let loaded = LOADED.take();
    assert_eq!((loaded[0].0, loaded[0].1.payload.as_slice()), (Mailbox::Soft, &[0, 2][..]));
    assert_eq!(notes(&node), ["published 1", "published 2"]);
}

#[test]
fn received_frames_reach_the_subscriber_from_both_fifos() {
    let Parts { node, mut events, mut urgent, mut other, .. } = parts();
    let node = RefCell::new(node);
    let heat = Subscriber::subscribe(&HEAT, QUEUE, &mut Resource(&node)).unwrap();
    NOW.set(5_000);
    RECEIVED.with_borrow_mut(|received| received.push_back(frame(7)));
    other.run();
    NOW.set(9_000);
    RECEIVED.with_borrow_mut(|received| received.push_back(frame(8)));
    urgent.run();
    assert!(heat.try_next(&mut Resource(&node)).is_none());
    run_events(&mut events, &node);
    // The urgent FIFO comes first.
    let first = heat.try_next(&mut Resource(&node)).unwrap();
    assert_eq!((first.content, first.received_at.since_epoch().as_ticks()), (8, 9_000));
    let second = heat.try_next(&mut Resource(&node)).unwrap();
    assert_eq!((second.content, second.received_at.since_epoch().as_ticks()), (7, 5_000));
    assert_eq!(notes(&node), ["delivered 8", "delivered 7"]);
}

/// Counts how often a task is woken.
#[derive(Default)]
struct Woken(AtomicU32);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn a_frame_costs_no_more_than_it_concerns() {
    let Parts { node, mut events, mut other, .. } = parts();
    let node = RefCell::new(node);
    let mut task = pin!(events.run(Resource(&node)));
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(Arc::clone(&woken));
    let mut receive = |frame| {
        RECEIVED.with_borrow_mut(|received| received.push_back(frame));
        other.run();
        woken.0.swap(0, Ordering::Relaxed)
    };
    // Polls the event task; how often has it asked what is due?
    let mut run = || {
        assert!(task.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
        TURNS.take()
    };
    assert_eq!(run(), 1);
    // Nobody is subscribed to the channel: the event task sleeps on.
    assert_eq!((receive(frame(1)), run(), node.borrow().foreign_frames()), (0, 0, 1));
    // Another node has this one's TxNode: that concerns the services.
    let of_own = Frame::new(Id::new(Priority::new(100), OWN, ETAG), Payload::EMPTY);
    assert_eq!((receive(of_own), run()), (1, 1));
    let heat = Subscriber::subscribe(&HEAT, QUEUE, &mut Resource(&node)).unwrap();
    assert_eq!((woken.0.swap(0, Ordering::Relaxed), run()), (1, 1));
    // An event is delivered, and nothing more is due than before.
    assert_eq!((receive(frame(2)), run()), (1, 0));
    assert_eq!(heat.try_next(&mut Resource(&node)).unwrap().content, 2);
    // What is published may not have found the mailbox empty.
    let publisher = Publisher::announce(&HEAT, &mut Resource(&node)).unwrap();
    assert_eq!(run(), 1);
    publisher.publish(3, &mut Resource(&node)).unwrap();
    assert_eq!(run(), 1);
    assert_eq!(node.borrow().foreign_frames(), 1);
    LOADED.take();
}

#[test]
fn what_a_fifo_or_a_queue_loses_becomes_exceptions() {
    let Parts { node, mut events, mut urgent, .. } = parts();
    let node = RefCell::new(node);
    LOSSES.set(2);
    urgent.run();
    run_events(&mut events, &node);
    assert_eq!(exceptions(&node, ExceptionKind::ReceiveOverrun), 2);
    let _heat = Subscriber::subscribe(&HEAT, QUEUE, &mut Resource(&node)).unwrap();
    // The queue of the urgent FIFO has four places.
    for _ in 0..3 {
        RECEIVED.with_borrow_mut(|received| received.extend([frame(1), frame(2), frame(3)]));
        urgent.run();
    }
    run_events(&mut events, &node);
    assert_eq!(exceptions(&node, ExceptionKind::InputLost), 5);
    assert_eq!(exceptions(&node, ExceptionKind::ReceiveOverrun), 2);
}

#[test]
fn each_bus_off_becomes_an_exception() {
    let Parts { node, mut events, mut status, .. } = parts();
    let node = RefCell::new(node);
    for _ in 0..2 {
        IS_OFF.set(true);
        status.run();
    }
    status.run();
    run_events(&mut events, &node);
    assert_eq!(exceptions(&node, ExceptionKind::BusOff), 2);
    let mut resource = Resource(&node);
    let mut next = pin!(cosmic_rtic::next_exception(&mut resource));
    let Poll::Ready(exception) = next.as_mut().poll(&mut Context::from_waker(Waker::noop())) else {
        panic!("there is an exception");
    };
    assert_eq!(exception.kind, ExceptionKind::BusOff);
    assert_eq!(notes(&node), ["BusOff"]);
}

#[test]
fn services_that_cannot_keep_to_the_seal_of_a_plan_do_not_start() {
    static SEAL: Seal = Seal { nodes: &[], channels: &[], brokers: &[] };
    let sealed = NodePlan { seal: Some(&SEAL), ..PLAN };
    let start = |plan: &NodePlan| PlannedServices::<2, 4, 2, 4>::planned(plan, Instant::EPOCH).err();
    assert_eq!(start(&sealed), Some(StartError::Services));
    assert_eq!(start(&PLAN), Some(StartError::NoSync), "that plan has no clock");
}

#[test]
fn services_that_only_follow_do_not_start_with_a_rank() {
    let start = |rank| {
        let plan = NodePlan { sync: Some(SyncConfig { rank, ..SyncConfig::DEFAULT }), ..PLAN };
        FollowingServices::<2, 4, 2, 4>::planned(&plan, Instant::EPOCH).err()
    };
    assert_eq!(start(Some(Rank::FIRST)), Some(StartError::Sync(SyncConfigError::Rank)));
    assert_eq!(start(None), None);
}
