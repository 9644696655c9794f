//! What the middleware costs, in instructions and in bytes of RAM. `cargo xtask bench` shows it as a table.
//!
//! Each piece of code runs on a node of its own that has not done it before, so that every run finds the
//! same state. Measured values go to standard error.
#![no_std]
#![no_main]

use core::hint::black_box;
use core::ptr::{addr_of_mut, write_volatile};

use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Event, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy, Publication,
    SoftAttributes, Subscription,
};
use cosmic_core::network::hard::{self, Dispatcher, HrtBuffers};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::{Delivered, EventHalf, Subject};
use qemu_tests::mono::Mono;
use qemu_tests::{count, measured, pass, println};

const PERIOD: Duration = Duration::from_millis(10);
const ME: TxNode = TxNode::new(1).unwrap();
const OTHER: TxNode = TxNode::new(2).unwrap();

/// One slot of this node and one of another.
static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    PERIOD,
    &[slot(0, ME, 2), slot(1, OTHER, 4)],
);

const fn slot(number: u16, publisher: TxNode, phase_ms: u64) -> Slot {
    Slot {
        etag: Etag::new(Etag::HARD_FIRST.get() + number).unwrap(),
        publisher,
        len: 8,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(phase_ms),
    }
}

const fn hard(number: u16) -> Channel<[u8; 8]> {
    let etag = Etag::new(Etag::HARD_FIRST.get() + number).unwrap();
    let attributes = HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 };
    Channel::hard(Subject::new(0x100 + number as u64).unwrap(), etag, attributes)
}

/// The etags of a cluster come from the top down.
const fn soft(number: u16) -> Channel<[u8; 8]> {
    let attributes =
        SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) };
    Channel::soft(Subject::new(0x1000 + number as u64).unwrap(), attributes)
        .with_etag(Etag::new(Etag::BOUND_LAST.get() - number).unwrap())
}

const BULK: Channel<[u8; 8]> = Channel::non_real_time(
    Subject::new(0x2000).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::BOUND_FIRST);

const NOW: Instant = Instant::from_epoch(Duration::from_millis(1));
const READY: Instant = Instant::from_epoch(Duration::from_millis(2));

struct Node<const CHANNELS: usize> {
    half: EventHalf<4, CHANNELS, CHANNELS, 16, 8, 8>,
    buffers: HrtBuffers<4>,
    dispatcher: Dispatcher<4>,
}

impl<const CHANNELS: usize> Node<CHANNELS> {
    fn new() -> Self {
        Self {
            half: EventHalf::new(Some(ME), &CALENDAR, ()),
            buffers: HrtBuffers::new(GlobalClock::free_running()),
            dispatcher: Dispatcher::new(&CALENDAR),
        }
    }

    fn announce(&mut self, channel: &Channel<[u8; 8]>) -> Publication<[u8; 8]> {
        self.half.announce(channel, &mut self.buffers).unwrap()
    }

    fn subscribe(&mut self, channel: &Channel<[u8; 8]>) -> Subscription<[u8; 8]> {
        let fifo = Policy::Fifo(Depth::new(8).unwrap());
        self.half.subscribe(channel, Filter::ALL, fifo, &mut self.buffers).unwrap()
    }

    #[inline]
    fn publish(&mut self, now: Instant, publication: &Publication<[u8; 8]>, content: &[u8; 8]) {
        let published = self.half.publish(now, publication, &Event::new(*content), &mut self.buffers);
        if let Ok(Some(Command::Load(mailbox, frame))) = published {
            store(mailbox, &frame);
        }
    }

    /// One call of the calendar task.
    #[inline]
    fn tick(&mut self, now: Instant) -> hard::Step {
        let step = self.dispatcher.poll(now, &mut self.buffers);
        if let hard::Step::Command(Command::Load(_, frame)) = step {
            store(Mailbox::Hard, &frame);
        }
        step
    }

    /// Has the dispatcher sleep until the next instant.
    fn settle(&mut self, now: Instant) {
        while !matches!(self.dispatcher.poll(now, &mut self.buffers), hard::Step::SleepUntil(_)) {}
    }
}

/// The registers of a mailbox as bxCAN has them: identifier, length, data low and high.
static mut MAILBOXES: [[u32; 4]; 3] = [[0; 4]; 3];

/// What a driver does to load a mailbox.
#[inline]
fn store(mailbox: Mailbox, frame: &Frame) {
    let [a, b, c, d, e, f, g, h] = frame.payload.padded();
    let values = [
        frame.payload.len() as u32,
        u32::from_le_bytes([a, b, c, d]),
        u32::from_le_bytes([e, f, g, h]),
        frame.id.raw() << 3 | 0b101,
    ];
    for (at, value) in values.into_iter().enumerate() {
        // SAFETY: both indices are within the array; nothing else uses it, and there is one thread.
        unsafe { write_volatile(addr_of_mut!(MAILBOXES[mailbox as usize][at]), value) };
    }
}

/// Counts `code` on nodes that `make` has prepared, a fresh one for each run.
fn bench<const CHANNELS: usize, H>(
    what: &str,
    make: impl Fn() -> (Node<CHANNELS>, H),
    mut code: impl FnMut(&mut Node<CHANNELS>, &mut H),
    done: impl Fn(&Node<CHANNELS>, &H) -> bool,
) {
    let mut nodes: [(Node<CHANNELS>, H); count::RUNS as usize] = core::array::from_fn(|_| make());
    let counted = count::each(black_box(&mut nodes), |(node, handle)| code(node, handle));
    assert!(nodes.iter().all(|(node, handle)| done(node, handle)), "{} did not do its work", what);
    measured!("{}: {} instructions, exact {}", what, counted.instructions, counted.exact);
}

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    publish();
    receive::<2>("receive, 1 channel", 1);
    receive::<16>("receive, 16 channels", 16);
    receive::<64>("receive, 64 channels", 64);
    hard_receive();
    ticks();
    memory();
    println!("measured");
    pass()
}

fn publish() {
    let content = black_box([0x5A; 8]);
    let now = black_box(NOW);
    for (what, channel) in [("publish soft", soft(0)), ("publish non real-time", BULK)] {
        bench::<4, _>(
            what,
            || with(|node| node.announce(&channel)),
            |node, publication| node.publish(now, publication, &content),
            |_, _| true,
        );
    }
    let hard_publisher = || {
        with(|node: &mut Node<4>| {
            let publication = node.announce(&hard(0));
            node.settle(NOW);
            publication
        })
    };
    bench(
        "publish hard, into the buffer",
        hard_publisher,
        |node, publication| {
            node.publish(now, publication, &content);
        },
        |_, _| true,
    );
    bench(
        "publish hard, with the release",
        hard_publisher,
        |node, publication| {
            node.publish(now, publication, &content);
            let _ = black_box(node.tick(READY));
        },
        |_, _| true,
    );
}

fn receive<const CHANNELS: usize>(what: &str, channels: u16) {
    let subscribers = || {
        with(|node: &mut Node<CHANNELS>| {
            let mut last = node.subscribe(&soft(0));
            for number in 1..channels {
                last = node.subscribe(&soft(number));
            }
            last
        })
    };
    let frame = |etag| {
        let id = Id::new(Priority::new(30), OTHER, Etag::new(etag).unwrap());
        black_box(Frame::new(id, Payload::full([7; 8])))
    };
    let wanted = frame(Etag::BOUND_LAST.get() - channels + 1);
    let received_at = black_box(NOW);
    bench(
        what,
        || {
            let (node, subscription) = subscribers();
            (node, (subscription, None))
        },
        |node, (subscription, got)| {
            node.half.on_frame(&wanted, received_at);
            *got = node.half.next(subscription);
        },
        |_, (_, got)| got.is_some_and(|got: Delivered<_>| got.content == [7; 8]),
    );
    let foreign = frame(Etag::BOUND_LAST.get() - 1000);
    bench(
        rejects(channels),
        subscribers,
        |node, _| node.half.on_frame(&foreign, received_at),
        |node, _| node.half.foreign_frames() == 1,
    );
}

fn rejects(channels: u16) -> &'static str {
    match channels {
        1 => "reject, 1 channel",
        16 => "reject, 16 channels",
        _ => "reject, 64 channels",
    }
}

fn hard_receive() {
    let frame = Frame::new(Id::new(Priority::HARD, OTHER, slot(1, OTHER, 4).etag), Payload::full([7; 8]));
    let frame = black_box(frame);
    let arrived_at = Instant::from_epoch(Duration::from_micros(4_300));
    let subscriber = || {
        with(|node: &mut Node<4>| {
            let subscription = node.subscribe(&hard(1));
            node.settle(NOW);
            node.settle(Instant::from_epoch(Duration::from_millis(4)));
            subscription
        })
    };
    bench(
        "receive hard, in the interrupt",
        subscriber,
        |node, _| {
            assert!(node.buffers.on_frame(&frame, arrived_at));
        },
        |_, _| true,
    );
    let delivery = Instant::from_epoch(Duration::from_millis(5));
    bench(
        "receive hard, delivery to the subscriber",
        || {
            let (mut node, subscription) = subscriber();
            node.buffers.on_frame(&frame, arrived_at);
            (node, subscription)
        },
        |node, subscription| {
            if let hard::Step::Notify(buffer) = node.tick(delivery) {
                node.half.on_notify(buffer, delivery, &mut node.buffers);
            }
            assert!(black_box(node.half.next(subscription)).is_some());
        },
        |_, _| true,
    );
}

fn ticks() {
    let node = || {
        with(|node: &mut Node<4>| {
            node.announce(&hard(0));
            node.subscribe(&hard(1));
            node.settle(NOW);
        })
    };
    bench(
        "calendar tick, nothing due",
        node,
        |node, ()| {
            let _ = black_box(node.tick(NOW));
        },
        |_, _| true,
    );
    bench(
        "calendar tick, slot without event",
        node,
        |node, ()| {
            let _ = black_box(node.tick(READY));
        },
        |_, _| true,
    );
}

/// The differences of sizes of nodes with more and fewer places.
fn memory() {
    type Sized<const CH: usize, const SUBS: usize, const EV: usize> = EventHalf<4, CH, SUBS, EV, 8, 8>;
    let channel = (size_of::<Sized<32, 8, 16>>() - size_of::<Sized<16, 8, 16>>()) / 16;
    let subscription = (size_of::<Sized<16, 24, 16>>() - size_of::<Sized<16, 8, 16>>()) / 16;
    let event = (size_of::<Sized<16, 8, 32>>() - size_of::<Sized<16, 8, 16>>()) / 16;
    let slot = (size_of::<HrtBuffers<16>>() + size_of::<Dispatcher<16>>()
        - size_of::<HrtBuffers<8>>()
        - size_of::<Dispatcher<8>>())
        / 8;
    measured!("RAM of a channel: {} bytes", channel);
    measured!("RAM of a subscription: {} bytes", subscription);
    measured!("RAM of a queued event: {} bytes", event);
    measured!("RAM of a slot of the calendar: {} bytes", slot);
}

fn with<const CHANNELS: usize, H>(prepare: impl FnOnce(&mut Node<CHANNELS>) -> H) -> (Node<CHANNELS>, H) {
    let mut node = Node::new();
    let handle = prepare(&mut node);
    (node, handle)
}
