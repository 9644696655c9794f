//! What the middleware costs, in instructions and in bytes of RAM. `cargo xtask bench` shows it as a table
//! and compares it with `bench-limits.json`.
//!
//! What is counted begins with the call of the middleware and ends when the last effect named is there:
//!
//! | line | until |
//! |---|---|
//! | publish | length, data and identifier have been written to the registers of a mailbox |
//! | publish behind 8 others | the event is in the queue; its deadline is earlier than theirs, the longest way |
//! | release | as for publish, from the wake-up of the calendar task |
//! | receive | each subscriber has the event, decoded, in its own memory |
//! | reject | the frame has been counted as foreign |
//! | deliver | as for receive, from the wake-up of the calendar task |
//! | tick | the calendar task knows how long to sleep, or what to do |
//!
//! Each run has a node of its own that has not done it before, so that all find the same state, and its
//! effect is checked afterwards. Measured values go to standard error.
#![no_std]
#![no_main]

use core::hint::black_box;
use core::ptr::{addr_of_mut, write_volatile};

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
use cosmic_core::event_half::{self, Delivered, EventHalf, Input};
use cosmic_core::event_layer::{
    Channel, Depth, Event, Filter, HardAttributes, Importance, NonRealTimeAttributes, Policy, Publication,
    SoftAttributes, Subscription,
};
use cosmic_core::network::hard::{self, Dispatcher, HrtBuffers};
use cosmic_core::time::{Duration, GlobalClock, Instant};
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
    half: EventHalf<4, CHANNELS, CHANNELS, 16, 16, 8>,
    dispatcher: Dispatcher<4>,
}

impl<const CHANNELS: usize> Node<CHANNELS> {
    fn new() -> Self {
        Self {
            half: EventHalf::new(Some(ME), &CALENDAR, (), HrtBuffers::new(GlobalClock::free_running())),
            dispatcher: Dispatcher::new(&CALENDAR),
        }
    }

    fn announce(&mut self, channel: &Channel<[u8; 8]>) -> Publication<[u8; 8]> {
        self.half.announce(channel).unwrap()
    }

    fn subscribe(&mut self, channel: &Channel<[u8; 8]>) -> Subscription<[u8; 8]> {
        let fifo = Policy::Fifo(Depth::new(8).unwrap());
        self.half.subscribe(channel, Filter::ALL, fifo).unwrap()
    }

    #[inline]
    fn publish(&mut self, now: Instant, publication: &Publication<[u8; 8]>, event: &Event<[u8; 8]>) {
        let Ok(due) = self.half.publish(now, publication, event) else { return };
        if let Some(Command::Load(mailbox, frame)) = due.command() {
            store(mailbox, &frame);
        }
    }

    /// One call of the calendar task.
    #[inline]
    fn tick(&mut self, now: Instant) -> hard::CalendarStep {
        let step = self.dispatcher.poll(now, self.half.hard_mut());
        if let hard::CalendarStep::Command(Command::Load(_, frame)) = step {
            store(Mailbox::Hard, &frame);
        }
        step
    }

    /// Has the dispatcher sleep until the next instant.
    fn settle(&mut self, now: Instant) {
        while !matches!(self.dispatcher.poll(now, self.half.hard_mut()), hard::CalendarStep::SleepUntil(_)) {}
    }
}

/// A node, and what an application on it holds.
// In this order the application's part is near the start, so that finding it is not counted either.
#[repr(C)]
struct Prepared<const CHANNELS: usize, H> {
    application: H,
    node: Node<CHANNELS>,
}

/// The registers of a mailbox as bxCAN has them: length, data low and high, identifier.
type Registers = [u32; 4];

static mut MAILBOXES: [Registers; 3] = [[0; 4]; 3];

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

/// Returns whether a frame with [`CONTENT`] has been stored since the last call.
fn take_stored(mailbox: Mailbox) -> bool {
    // SAFETY: as in `store`.
    let stored = unsafe { core::mem::take(&mut *addr_of_mut!(MAILBOXES[mailbox as usize])) };
    stored[..3] == [8, 0x5A5A_5A5A, 0x5A5A_5A5A] && stored[3] & 0b111 == 0b101
}

const CONTENT: [u8; 8] = [0x5A; 8];

/// Counts `code` on nodes that `make` has prepared, a fresh one for each run, and prints the count. `done`
/// tells whether it did on a node what it should.
fn bench<const CHANNELS: usize, H>(
    what: impl core::fmt::Display,
    make: impl Fn() -> Prepared<CHANNELS, H>,
    mut code: impl FnMut(&mut Node<CHANNELS>, &mut H),
    done: impl Fn(&Node<CHANNELS>, &H) -> bool,
) {
    let mut nodes: [Prepared<CHANNELS, H>; count::RUNS as usize] = core::array::from_fn(|_| make());
    let counted = count::each(black_box(&mut nodes), move |it| code(&mut it.node, &mut it.application));
    assert!(nodes.iter().all(|it| done(&it.node, &it.application)), "{}: not done", what);
    measured!("{}: {} instructions, exact {}", what, counted.instructions, counted.exact);
}

/// A new node, on which an application does this before.
fn with<const CHANNELS: usize, H>(prepare: impl FnOnce(&mut Node<CHANNELS>) -> H) -> Prepared<CHANNELS, H> {
    let mut node = Node::new();
    Prepared { application: prepare(&mut node), node }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    publish();
    publish_behind_others();
    publish_hard();
    receive::<2>("1 channel", 1);
    receive::<16>("16 channels", 16);
    receive::<64>("64 channels", 64);
    receive_by_four();
    receive_hard();
    ticks();
    memory();
    println!("measured");
    pass()
}

fn publish() {
    let (now, content) = black_box((NOW, CONTENT));
    for (what, channel, mailbox) in [
        ("publish, soft real-time", soft(0), Mailbox::Soft),
        ("publish, non real-time", BULK, Mailbox::NonRealTime),
    ] {
        bench::<4, _>(
            what,
            || with(|node| node.announce(&channel)),
            move |node, publication| node.publish(now, publication, &Event::new(content)),
            |_, _| true,
        );
        assert!(take_stored(mailbox), "{}: nothing stored", what);
    }
}

fn publish_behind_others() {
    let (now, content) = black_box((NOW, CONTENT));
    let earlier = |step: u64| NOW + Duration::from_millis(20 - step);
    bench::<4, _>(
        "publish, soft real-time, behind 8 others",
        || {
            with(|node| {
                let publication = node.announce(&soft(0));
                // The first goes to the mailbox.
                for step in 0..9 {
                    node.publish(NOW, &publication, &Event::new(CONTENT).deadline(earlier(step)));
                }
                publication
            })
        },
        move |node, publication| node.publish(now, publication, &Event::new(content)),
        |node, _| node.half.waiting() == 10,
    );
}

fn publish_hard() {
    let (now, ready, content) = black_box((NOW, READY, CONTENT));
    let publisher = || {
        with(|node: &mut Node<4>| {
            let publication = node.announce(&hard(0));
            node.settle(NOW);
            publication
        })
    };
    bench(
        "publish, hard real-time, into the buffer",
        publisher,
        move |node, publication| node.publish(now, publication, &Event::new(content)),
        |_, _| true,
    );
    bench(
        "publish, hard real-time, and release",
        publisher,
        move |node, publication| {
            node.publish(now, publication, &Event::new(content));
            let _ = node.tick(ready);
        },
        |_, _| true,
    );
    assert!(take_stored(Mailbox::Hard), "hard real-time: nothing stored");
}

/// A frame on a soft real-time channel.
fn frame(etag: Etag) -> Frame {
    Frame::new(Id::new(Priority::new(30), OTHER, etag), Payload::full(CONTENT))
}

/// A node that subscribes to some channels. The event is one of the last of them, and the foreign ones
/// are the first that follows, whose place in the map is among the others, and one far away.
fn receive<const CHANNELS: usize>(channels: &str, number: u16) {
    let last = soft(number - 1);
    let subscriber = || {
        with(|node: &mut Node<CHANNELS>| {
            for other in 0..number - 1 {
                node.subscribe(&soft(other));
            }
            (node.subscribe(&last), None)
        })
    };
    let received_at = black_box(NOW);
    let below = |distance| Etag::new(Etag::BOUND_LAST.get() - distance).unwrap();
    let wanted = black_box(frame(below(number - 1)));
    bench(
        Name("receive", channels),
        subscriber,
        move |node, (subscription, got)| {
            node.half.on_frame(&wanted, received_at);
            *got = node.half.next(subscription);
        },
        |_, (_, got): &(_, Option<Delivered<_>>)| got.is_some_and(|got| got.content == CONTENT),
    );
    for (what, distance) in [("reject", 1000), ("reject a neighbour", number)] {
        let foreign = black_box(frame(below(distance)));
        bench(
            Name(what, channels),
            subscriber,
            move |node, _| _ = node.half.on_frame(&foreign, received_at),
            |node, _: &(_, Option<Delivered<_>>)| node.half.foreign_frames() == 1,
        );
    }
}

fn receive_by_four() {
    let received_at = black_box(NOW);
    let wanted = black_box(frame(Etag::BOUND_LAST));
    bench::<4, _>(
        "receive, 4 subscribers",
        || with(|node| [(); 4].map(|()| (node.subscribe(&soft(0)), None))),
        move |node, subscribers| {
            node.half.on_frame(&wanted, received_at);
            for (subscription, got) in subscribers {
                *got = node.half.next(subscription);
            }
        },
        |_, subscribers: &[(_, Option<Delivered<_>>); 4]| subscribers.iter().all(|(_, got)| got.is_some()),
    );
}

fn receive_hard() {
    let arrived_at = Instant::from_epoch(Duration::from_micros(4_300));
    let of_other = slot(1, OTHER, 4);
    let id = Id::new(Priority::HARD, OTHER, of_other.etag);
    let delivery = Instant::from_epoch(of_other.phase) + CALENDAR.slot_times(&of_other).delivery;
    let (frame, arrived_at, delivery) =
        black_box((Frame::new(id, Payload::full(CONTENT)), arrived_at, delivery));
    let subscriber = || {
        with(|node: &mut Node<4>| {
            let subscription = node.subscribe(&hard(1));
            node.settle(NOW);
            node.settle(Instant::from_epoch(Duration::from_millis(4)));
            (subscription, None)
        })
    };
    bench(
        "receive, hard real-time, in the interrupt",
        subscriber,
        move |node, _| _ = event_half::receive(&frame, arrived_at, node.half.hard_mut()),
        |_, _: &(_, Option<Delivered<_>>)| true,
    );
    bench(
        "deliver, hard real-time",
        || {
            let mut prepared = subscriber();
            let _ = event_half::receive(&frame, arrived_at, prepared.node.half.hard_mut());
            prepared
        },
        move |node, (subscription, got)| {
            if let hard::CalendarStep::Notify(buffer) = node.tick(delivery) {
                node.half.on_input(&Input::Notice(buffer), delivery);
            }
            *got = node.half.next(subscription);
        },
        |_, (_, got)| got.is_some_and(|got| got.content == CONTENT),
    );
}

fn ticks() {
    let (now, ready) = black_box((NOW, READY));
    let node = || {
        with(|node: &mut Node<4>| {
            node.announce(&hard(0));
            node.subscribe(&hard(1));
            node.settle(NOW);
            hard::CalendarStep::Continue
        })
    };
    let sleeps = |_: &Node<4>, step: &hard::CalendarStep| matches!(step, hard::CalendarStep::SleepUntil(_));
    bench("tick, nothing due", node, move |node, step| *step = node.tick(now), sleeps);
    bench(
        "tick, slot without event",
        node,
        move |node, step| *step = node.tick(ready),
        |_, step| matches!(step, hard::CalendarStep::Notify(_)),
    );
    let after_slot = || {
        let mut prepared = node();
        let _ = prepared.node.tick(READY);
        prepared
    };
    bench("tick, looks for the next instant", after_slot, move |node, step| *step = node.tick(ready), sleeps);
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
    measured!("RAM, channel: {} bytes", channel);
    measured!("RAM, subscription: {} bytes", subscription);
    measured!("RAM, queued event: {} bytes", event);
    measured!("RAM, slot of the calendar: {} bytes", slot);
}

/// What is measured, and with how many channels.
struct Name<'a>(&'a str, &'a str);

impl core::fmt::Display for Name<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}, {}", self.0, self.1)
    }
}
