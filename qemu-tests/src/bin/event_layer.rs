//! Event channels from `publish` to `next` on a Cortex-M: two nodes, whose frames are carried across by
//! hand.
//!
//! Time is a parameter of the core, so what is printed is the same on any processor. How many
//! instructions an event takes goes to standard error.
#![no_std]
#![no_main]

use core::hint::black_box;

use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, TxNode};
use cosmic_core::event_layer::{
    Attribute, Channel, Content, Context, Depth, Event, Filter, HardAttributes, Importance,
    NonRealTimeAttributes, Policy, Publication, SoftAttributes, Subscription,
};
use cosmic_core::network::hard::HrtBuffers;
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_core::{Due, EventHalf, Input, Step, Subject};
use qemu_tests::mono::Mono;
use qemu_tests::{count, measured, pass, println};

cosmic_core::content! {
    /// How fast a wheel turns.
    #[derive(Clone, Copy, PartialEq, Debug)]
    pub struct WheelSpeed {
        /// In millimetres per second.
        pub speed: u16,
        /// Does the sensor trust itself?
        pub valid: bool,
    }
}

/// No hard real-time slots: their path has a test of its own.
const CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(10),
    &[],
);

const SPEED: Channel<WheelSpeed> = Channel::soft(
    Subject::new(0x1000).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(2), validity: Duration::from_millis(4) },
)
.with_etag(Etag::BOUND_FIRST)
.with_context();

const TEXT: Channel<[u8; 3]> = Channel::non_real_time(
    Subject::new(0x2000).unwrap(),
    NonRealTimeAttributes { importance: Importance::LEAST, validity: None },
)
.with_etag(Etag::BOUND_LAST);

const UNPLANNED: Channel<u8> = Channel::hard(
    Subject::new(0x3000).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
);

const NOW: Instant = Instant::EPOCH;

type Half = EventHalf<2, 4, 4, 8, 6, 6>;

struct Node {
    half: Half,
}

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    typed_content_and_filters();
    policies();
    local_subscribers();
    what_is_refused();
    measure();
    pass()
}

/// Subscribers get the events whose context their filters let through.
fn typed_content_and_filters() {
    println!("filters");
    let [mut sensor, mut display] = [Node::new(1), Node::new(2)];
    let speeds = sensor.announce(&SPEED);
    let fifo = Policy::Fifo(Depth::new(4).unwrap());
    let all = display.subscribe(&SPEED, Filter::ALL, fifo);
    let located = Filter::at_least(&[Attribute::Location]);
    let with_location = display.subscribe(&SPEED, located, fifo);
    let front = display.subscribe(&SPEED, located.with_range(Attribute::Location, 0, 1), fifo);
    let nameless = display.subscribe(&SPEED, Filter::at_most(&[]), fifo);

    let nowhere = Context::EMPTY;
    let [left, rear] = [0, 2].map(|place| nowhere.with(Attribute::Location, place).unwrap());
    for (speed, context) in [(100, nowhere), (200, left), (300, rear)] {
        let event = Event::new(WheelSpeed { speed, valid: true }).context(context);
        display.half.on_input(&Input::Frame(sensor.send(&speeds, &event)), NOW);
    }
    for (name, subscription) in
        [("all", &all), ("with a location", &with_location), ("in front", &front), ("without any", &nameless)]
    {
        while let Some(delivered) = display.half.next(subscription) {
            assert!(delivered.content.valid && delivered.publisher == TxNode::new(1).unwrap());
            println!("  {}: {} mm/s", name, delivered.content.speed);
        }
    }
    println!("  filtered: {}", display.half.channel_counters(SPEED.subject()).unwrap().filtered);
}

/// What becomes of events that nobody fetches.
fn policies() {
    println!("policies");
    let [mut logger, mut console] = [Node::new(1), Node::new(2)];
    let texts = logger.announce(&TEXT);
    let two = console.subscribe(&TEXT, Filter::ALL, Policy::Fifo(Depth::new(2).unwrap()));
    let latest = console.subscribe(&TEXT, Filter::ALL, Policy::Latest);
    for text in [*b"one", *b"two", *b"six"] {
        console.half.on_input(&Input::Frame(logger.send(&texts, &Event::new(text))), NOW);
    }
    for (name, subscription) in [("first in, first out", &two), ("latest", &latest)] {
        while let Some(delivered) = console.half.next(subscription) {
            println!("  {}: {}", name, core::str::from_utf8(&delivered.content).unwrap());
        }
    }
    console.print_exceptions();

    let frame = logger.send(&texts, &Event::new(*b"odd"));
    console.half.on_input(&Input::Frame(Frame::new(frame.id, Payload::full([0; 8]))), NOW);
    assert!(console.half.next(&two).is_none());
    console.print_exceptions();
}

/// A publication also reaches the node's own subscribers.
fn local_subscribers() {
    println!("local delivery");
    let mut node = Node::new(1);
    let texts = node.announce(&TEXT);
    let own = node.subscribe(&TEXT, Filter::ALL, Policy::Latest);
    let frame = node.send(&texts, &Event::new(*b"own"));
    println!("  identifier {:#010X}", frame.id.raw());
    let delivered = node.half.next(&own).unwrap();
    println!("  {}", core::str::from_utf8(&delivered.content).unwrap());
}

fn what_is_refused() {
    println!("refused");
    let mut node = Node::new(1);
    println!("  {:?}", node.half.announce(&UNPLANNED).unwrap_err());
    let other_quality: Channel<WheelSpeed> = Channel::soft(
        SPEED.subject(),
        SoftAttributes { deadline: Duration::from_millis(1), validity: Duration::from_millis(1) },
    );
    let speeds = node.announce(&SPEED);
    println!("  {:?}", node.half.announce(&other_quality).unwrap_err());
    let event = Event::new(WheelSpeed { speed: 1, valid: true });
    let later = NOW + Duration::from_millis(1);
    for event in [event.deadline(NOW), event.deadline(later).expires_at(NOW), full_context(event)] {
        let refused = node.half.publish(later, &speeds, &event);
        println!("  {:?}", refused.unwrap_err());
    }
    let texts = node.announce(&TEXT);
    for _ in 0..4 {
        assert!(node.half.publish(NOW, &texts, &Event::new(*b"txt")).is_ok());
    }
    let refused = node.half.publish(NOW, &texts, &Event::new(*b"txt"));
    println!("  {:?}", refused.unwrap_err());
    node.print_exceptions();
}

/// More context than fits in a frame beside the content.
fn full_context(event: Event<WheelSpeed>) -> Event<WheelSpeed> {
    let context = Context::EMPTY.with(Attribute::TimeOfOccurrence, 1).unwrap();
    event.context(context.with(Attribute::Sensor, 1).unwrap())
}

impl Node {
    fn new(tx_node: u8) -> Self {
        Self {
            half: Half::new(
                TxNode::new(tx_node),
                &CALENDAR,
                (),
                HrtBuffers::new(GlobalClock::free_running()),
            ),
        }
    }

    fn announce<C: Content>(&mut self, channel: &Channel<C>) -> Publication<C> {
        self.half.announce(channel).unwrap()
    }

    fn subscribe<C: Content>(
        &mut self,
        channel: &Channel<C>,
        filter: Filter,
        policy: Policy,
    ) -> Subscription<C> {
        self.half.subscribe(channel, filter, policy).unwrap()
    }

    /// Publishes an event on the idle node, which then sends it at once.
    fn send<C: Content>(&mut self, publication: &Publication<C>, event: &Event<C>) -> Frame {
        let command = self.half.publish(NOW, publication, event).ok().and_then(Due::command);
        let Some(Command::Load(mailbox, frame)) = command else { panic!("not loaded: {command:?}") };
        assert_ne!(mailbox, Mailbox::Hard);
        assert!(matches!(self.half.poll(NOW), Step::SleepUntil(_)));
        self.half.on_input(&Input::Outcome(mailbox, Outcome::Sent), NOW);
        frame
    }

    fn print_exceptions(&mut self) {
        while let Some(exception) = self.half.take_exception() {
            let subject = exception.subject.map_or(0, Subject::get);
            println!("  exception: {:?} of {:#x}", exception.kind, subject);
        }
    }
}

/// What an event costs, on an idle node.
fn measure() {
    let [mut sensor, mut display] = [Node::new(1), Node::new(2)];
    let texts = sensor.announce(&TEXT);
    let subscription = display.subscribe(&TEXT, Filter::ALL, Policy::Latest);
    let event = Event::new(*b"txt");
    let frame = sensor.send(&texts, &event);
    print_measured(
        "publish, sent, poll",
        count::instructions(|| {
            let Ok(due) = sensor.half.publish(NOW, &texts, &event) else { return };
            let _ = black_box(due);
            sensor.half.on_input(&Input::Outcome(Mailbox::NonRealTime, Outcome::Sent), NOW);
            let _ = black_box(sensor.half.poll(NOW));
        }),
    );
    print_measured(
        "received frame, next",
        count::instructions(|| {
            display.half.on_input(&Input::Frame(black_box(frame)), NOW);
            assert!(display.half.next(&subscription).is_some());
        }),
    );
    let foreign = Id::new(frame.id.priority(), frame.id.tx_node(), Etag::HARD_LAST);
    let foreign = Frame::new(foreign, frame.payload);
    print_measured(
        "received frame of a channel that does not concern the node",
        count::instructions(|| {
            display.half.on_input(&Input::Frame(black_box(foreign)), NOW);
        }),
    );
}

fn print_measured(name: &str, count: count::Count) {
    measured!("{}: {} instructions, exact {}", name, count.instructions, count.exact);
}
