//! The board, and a node on it.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::filter_banks::Wanted;
use cosmic_core::can::{
    BitRate, ErrorCounters, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode,
};
use cosmic_core::event_layer::{
    Channel, Delivered, Depth, Exception, ExceptionKind, Policy, PublishError, SoftAttributes,
};
use cosmic_core::plan::NodePlan;
use cosmic_core::time::{Duration, Instant};
use cosmic_core::uid::NodeUid;
use cosmic_rtic::board::{BoardParts, BusChanges, BusStatus, Filters, RxFifo, TxMailbox, TxOutcomes};
use cosmic_rtic::{Board, Node, Observer, Observes, Parts, Storage, System, start_observed};
use rtic_core::Mutex;

thread_local! {
    pub(crate) static NOW: Cell<u64> = const { Cell::new(0) };
    pub(crate) static LOADED: RefCell<Vec<(Mailbox, Frame)>> = const { RefCell::new(Vec::new()) };
    pub(crate) static OUTCOMES: RefCell<VecDeque<(Mailbox, Outcome)>> = const { RefCell::new(VecDeque::new()) };
    pub(crate) static RECEIVED: RefCell<VecDeque<Frame>> = const { RefCell::new(VecDeque::new()) };
    pub(crate) static LOSSES: Cell<u32> = const { Cell::new(0) };
    pub(crate) static TURNS: Cell<u32> = const { Cell::new(0) };
    pub(crate) static IS_OFF: Cell<bool> = const { Cell::new(false) };
    pub(crate) static WANTED: RefCell<Option<Vec<Wanted>>> = const { RefCell::new(None) };
}

/// Memory of this thread in place of hardware.
pub(crate) struct Bench;

pub(crate) struct MailboxOf<const N: usize>;

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
    const AT_ONCE: usize = 3;

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

impl Filters for Bench {
    fn set(&mut self, wanted: impl Iterator<Item = Wanted>) {
        WANTED.set(Some(wanted.collect()));
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
    type Filters = Self;

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
            filters: Self,
        }
    }
}

cosmic_core::capacity! {
    pub(crate) Room { slots: 2, channels: 4, subscriptions: 4, events: 8, soft: 8, non_real_time: 8 }
}

pub(crate) struct Tested;

impl System for Tested {
    type Board = Bench;
    type Capacity = Room;
    type Services = ();
    type Observer = Notes;
}

/// An observer who writes down what it is told.
#[derive(Default)]
pub(crate) struct Notes(pub(crate) Vec<String>);

impl Observer for Notes {
    type Calendar = ();

    fn attended(&mut self) {
        TURNS.set(TURNS.get() + 1);
    }

    fn exception(&mut self, exception: &Exception) {
        self.0.push(format!("{:?}", exception.kind));
    }
}

impl Observes<u16> for Notes {
    fn published(&mut self, _: Subject, content: &u16, _: Instant, result: Result<(), PublishError>) {
        self.0.push(match result {
            Ok(()) => format!("published {content}"),
            Err(error) => format!("refused {content}: {error:?}"),
        });
    }

    fn delivered(&mut self, _: Subject, event: &Delivered<u16>, _: Instant) {
        self.0.push(format!("delivered {}", event.content));
    }
}

/// Of the frames of messages it writes the header.
impl Observes<Payload> for Notes {
    fn published(&mut self, _: Subject, piece: &Payload, _: Instant, result: Result<(), PublishError>) {
        self.0.push(format!("published {:02X} {}", piece.as_slice()[0], result.is_ok()));
    }

    fn delivered(&mut self, _: Subject, piece: &Delivered<Payload>, _: Instant) {
        self.0.push(format!("delivered {:02X}", piece.content.as_slice()[0]));
    }
}

pub(crate) const SEGMENT: Segment = Segment {
    bit_rate: BitRate::MAX,
    accuracy: Duration::from_micros(50),
    release_jitter: Duration::from_micros(20),
};
pub(crate) static CALENDAR: Calendar = Calendar::checked(
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
pub(crate) const OWN: TxNode = TxNode::new(3).unwrap();
pub(crate) const OTHER: TxNode = TxNode::new(4).unwrap();
pub(crate) const ETAG: Etag = Etag::new(2_000).unwrap();
pub(crate) const PLAN: NodePlan = NodePlan {
    name: "tested",
    uid: NodeUid::new(7).unwrap(),
    tx_node: Some(OWN),
    sync: None,
    filters: &[],
    named_at_run_time: false,
    calendar: &CALENDAR,
    seal: None,
    admission: None,
    publishes: &[],
    subscribes: &[],
};
pub(crate) const HEAT: Channel<u16> = Channel::soft(
    Subject::new(0xC3).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(10), validity: Duration::from_millis(20) },
)
.with_etag(ETAG);
pub(crate) const QUEUE: Policy = Policy::Fifo(Depth::new(4).unwrap());

/// A resource of RTIC's, on one thread.
pub(crate) struct Resource<'a, T: System = Tested>(pub(crate) &'a RefCell<Node<T>>);

impl<T: System> Mutex for Resource<'_, T> {
    type T = Node<T>;

    fn lock<R>(&mut self, work: impl FnOnce(&mut Self::T) -> R) -> R {
        work(&mut self.0.borrow_mut())
    }
}

pub(crate) fn parts() -> Parts<Tested> {
    let storage = Box::leak(Box::new(Storage::new()));
    start_observed(Bench, &PLAN, storage, Notes::default(), ()).unwrap()
}

/// Lets the event task run until it waits.
pub(crate) fn run_events<T: System>(events: &mut cosmic_rtic::Events, node: &RefCell<Node<T>>) {
    let mut task = pin!(events.run(Resource(node)));
    let _ = task.as_mut().poll(&mut Context::from_waker(Waker::noop()));
}

pub(crate) fn notes(node: &RefCell<Node<Tested>>) -> Vec<String> {
    std::mem::take(&mut node.borrow_mut().observer().0)
}

pub(crate) fn exceptions(node: &RefCell<Node<Tested>>, kind: ExceptionKind) -> u32 {
    node.borrow().exceptions(kind)
}

/// Lets a task of the application run until it waits.
pub(crate) fn run(task: std::pin::Pin<&mut impl Future>) {
    assert!(task.poll(&mut Context::from_waker(Waker::noop())).is_pending());
}

pub(crate) fn frame(number: u16) -> Frame {
    let payload = Payload::new(&number.to_be_bytes()).unwrap();
    Frame::new(Id::new(Priority::new(100), OTHER, ETAG), payload)
}
