//! A node on a board that is only values: what the parts of the runtime hand to each other.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{
    BitRate, ErrorCounters, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode,
};
use cosmic_core::event_layer::{
    Channel, Delivered, Depth, Exception, ExceptionKind, HardAttributes, Policy, PublishError, SoftAttributes,
};
use cosmic_core::plan::NodePlan;
use cosmic_core::time::{Duration, Instant};
use cosmic_core::uid::NodeUid;
use cosmic_rtic::board::{BoardParts, BusChanges, BusStatus, RxFifo, TxMailbox, TxOutcomes};
use cosmic_rtic::{
    Board, Node, Observer, Observes, Parts, Publisher, Storage, Subscriber, System, start_observed,
};
use rtic_core::Mutex;

thread_local! {
    static NOW: Cell<u64> = const { Cell::new(0) };
    static LOADED: RefCell<Vec<(Mailbox, Frame)>> = const { RefCell::new(Vec::new()) };
    static OUTCOMES: RefCell<VecDeque<(Mailbox, Outcome)>> = const { RefCell::new(VecDeque::new()) };
    static RECEIVED: RefCell<VecDeque<Frame>> = const { RefCell::new(VecDeque::new()) };
    static LOSSES: Cell<u32> = const { Cell::new(0) };
    static IS_OFF: Cell<bool> = const { Cell::new(false) };
}

/// Memory of this thread in place of hardware.
struct Bench;

struct MailboxOf<const N: usize>;

impl<const N: usize> TxMailbox for MailboxOf<N> {
    fn load(&mut self, frame: &Frame) {
        LOADED.with_borrow_mut(|loaded| loaded.push((Mailbox::ALL[N], *frame)));
    }

    fn withdraw(&mut self) {}
}

impl TxOutcomes for Bench {
    fn take(&mut self) -> Option<(Mailbox, Outcome)> {
        OUTCOMES.with_borrow_mut(VecDeque::pop_front)
    }
}

impl RxFifo for Bench {
    const DEPTH: usize = 3;

    fn read(&mut self) -> Option<Frame> {
        RECEIVED.with_borrow_mut(VecDeque::pop_front)
    }

    fn take_losses(&mut self) -> u32 {
        LOSSES.take()
    }
}

impl BusStatus for Bench {
    fn errors(&self) -> ErrorCounters {
        ErrorCounters::NONE
    }
}

impl BusChanges for Bench {
    fn take_bus_off(&mut self) -> bool {
        IS_OFF.take()
    }
}

impl Board for Bench {
    type Hard = MailboxOf<0>;
    type Soft = MailboxOf<1>;
    type NonRealTime = MailboxOf<2>;
    type Outcomes = Self;
    type Urgent = Self;
    type Other = Self;
    type Status = Self;
    type Changes = Self;

    fn now() -> Instant {
        Instant::from_epoch(Duration::from_ticks(NOW.get()))
    }

    async fn delay_until(instant: Instant) {
        std::future::poll_fn(|_| if Self::now() >= instant { Poll::Ready(()) } else { Poll::Pending }).await;
    }

    fn split(self) -> BoardParts<Self> {
        BoardParts {
            hard: MailboxOf,
            soft: MailboxOf,
            non_real_time: MailboxOf,
            outcomes: Self,
            urgent: Self,
            other: Self,
            status: Self,
            changes: Self,
        }
    }
}

cosmic_core::capacity! {
    Room { slots: 2, channels: 4, subscriptions: 4, events: 8, soft: 8, non_real_time: 8 }
}

struct Tested;

impl System for Tested {
    type Board = Bench;
    type Capacity = Room;
    type Services = ();
    type Observer = Notes;
}

/// An observer who writes down what it is told.
#[derive(Default)]
struct Notes(Vec<String>);

impl Observer for Notes {
    type Calendar = ();

    fn exception(&mut self, exception: &Exception) {
        self.0.push(format!("{:?}", exception.kind));
    }
}

impl Observes<u16> for Notes {
    fn published(&mut self, _: &Channel<u16>, content: &u16, _: Instant, result: Result<(), PublishError>) {
        self.0.push(match result {
            Ok(()) => format!("published {content}"),
            Err(error) => format!("refused {content}: {error:?}"),
        });
    }

    fn delivered(&mut self, _: &Channel<u16>, event: &Delivered<u16>, _: Instant) {
        self.0.push(format!("delivered {}", event.content));
    }
}

const SEGMENT: Segment = Segment {
    bit_rate: BitRate::MAX,
    accuracy: Duration::from_micros(50),
    release_jitter: Duration::from_micros(20),
};
static CALENDAR: Calendar = Calendar::checked(
    SEGMENT,
    Duration::from_millis(10),
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: OWN,
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(2),
    }],
);
const OWN: TxNode = TxNode::new(3).unwrap();
const OTHER: TxNode = TxNode::new(4).unwrap();
const ETAG: Etag = Etag::new(2_000).unwrap();
const PLAN: NodePlan = NodePlan {
    name: "tested",
    uid: NodeUid::new(7).unwrap(),
    tx_node: OWN,
    sync: None,
    filters: &[],
    calendar: &CALENDAR,
    publishes: &[],
    subscribes: &[],
};
const HEAT: Channel<u16> = Channel::soft(
    Subject::new(0xC3).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(20) },
)
.with_etag(ETAG);
const QUEUE: Policy = Policy::Fifo(Depth::new(4).unwrap());

/// A resource of RTIC's, on one thread.
struct Resource<'a>(&'a RefCell<Node<Tested>>);

impl Mutex for Resource<'_> {
    type T = Node<Tested>;

    fn lock<R>(&mut self, work: impl FnOnce(&mut Self::T) -> R) -> R {
        work(&mut self.0.borrow_mut())
    }
}

fn parts() -> Parts<Tested> {
    let storage = Box::leak(Box::new(Storage::new()));
    start_observed(Bench, &PLAN, storage, Notes::default(), ()).unwrap()
}

/// Lets the event task run until it waits.
fn run_events(events: &mut cosmic_rtic::Events, node: &RefCell<Node<Tested>>) {
    let mut task = pin!(events.run(Resource(node)));
    let _ = task.as_mut().poll(&mut Context::from_waker(Waker::noop()));
}

fn notes(node: &RefCell<Node<Tested>>) -> Vec<String> {
    std::mem::take(&mut node.borrow_mut().observer().0)
}

fn exceptions(node: &RefCell<Node<Tested>>, kind: ExceptionKind) -> u32 {
    node.borrow().exceptions(kind)
}

/// Lets a task of the application run until it waits.
fn run(task: std::pin::Pin<&mut impl Future>) {
    assert!(task.poll(&mut Context::from_waker(Waker::noop())).is_pending());
}

fn frame(number: u16) -> Frame {
    let payload = Payload::new(&number.to_be_bytes()).unwrap();
    Frame::new(Id::new(Priority::new(100), OTHER, ETAG), payload)
}

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

#[test]
fn what_a_fifo_or_a_queue_loses_becomes_exceptions() {
    let Parts { node, mut events, mut urgent, .. } = parts();
    let node = RefCell::new(node);
    LOSSES.set(2);
    urgent.run();
    run_events(&mut events, &node);
    assert_eq!(exceptions(&node, ExceptionKind::InputLost), 2);
    // The queue of the urgent FIFO has seven places.
    for _ in 0..3 {
        RECEIVED.with_borrow_mut(|received| received.extend([frame(1), frame(2), frame(3)]));
        urgent.run();
    }
    run_events(&mut events, &node);
    assert_eq!(exceptions(&node, ExceptionKind::InputLost), 4);
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
fn an_event_in_each_period() {
    let Parts { node, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut numbers = 1..;
    let count = |_: &mut Resource<'_>| numbers.next().unwrap();
    let mut task = pin!(cosmic_rtic::publish_every(&HEAT, Duration::from_micros(10), &mut resource, count));
    for (now, expected) in [
        (0, &[][..]),
        (9_999, &[]),
        (10_000, &["published 1"]),
        // Two instants late: both events, at once.
        (30_000, &["published 2", "published 3"]),
    ] {
        NOW.set(now);
        run(task.as_mut());
        assert_eq!(notes(&node), expected, "at {now}");
    }
    LOADED.take();
}

/// The channel is announced before its first slot and not earlier, since a slot without an event is an error.
#[test]
fn an_event_before_each_slot() {
    const SLOT: Slot = CALENDAR.slots()[0];
    const SPEED: Channel<u16> = Channel::hard(
        Subject::new(0xC4).unwrap(),
        SLOT.etag,
        HardAttributes { period: SLOT.period, periodic: true, omission_degree: 1 },
    );
    let Parts { node, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut numbers = 1..;
    let count = |_: &mut Resource<'_>| numbers.next().unwrap();
    let lead = Duration::from_micros(300);
    let mut task = pin!(cosmic_rtic::publish_in_slots(&SPEED, &SLOT, lead, &mut resource, count));
    for (now, expected) in [
        (0, &[][..]),
        (1_699_999, &[]),
        (1_700_000, &["published 1"]),
        (11_699_999, &[]),
        (11_700_000, &["published 2"]),
    ] {
        NOW.set(now);
        run(task.as_mut());
        assert_eq!(notes(&node), expected, "at {now}");
        assert_eq!(node.borrow().channel_counters(SPEED.subject()).is_some(), now >= 1_700_000);
    }
}
