//! Two whole nodes of the core over two chips: hard events at their instants, soft events between them.

mod model;

use cosmic_bus::{BitPosition, Fault, FaultModel, Filter as Frames, Rule, VirtualInstant};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Controller, Etag, TxNode};
use cosmic_core::event_half::{EventHalf, Input, Step, outcome, receive};
use cosmic_core::event_layer::{
    Channel, Depth, Event, ExceptionKind, Filter, HardAttributes, Policy, SoftAttributes,
};
use cosmic_core::network::hard::{CalendarStep, Dispatcher, HrtBuffers};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use cosmic_mcp2515::{Config, Filters, Mcp2515};
use model::{NoDelay, Shared, Spi, World};

const PUBLISHER: TxNode = TxNode::new(1).unwrap();
const SUBSCRIBER: TxNode = TxNode::new(2).unwrap();
const PERIOD: Duration = Duration::from_millis(10);
const SPEED_ETAG: Etag = Etag::new(100).unwrap();

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(20),
    },
    PERIOD,
    &[Slot {
        etag: SPEED_ETAG,
        publisher: PUBLISHER,
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(2),
    }],
);

const SPEED: Channel<u16> = Channel::hard(
    Subject::new(0x100).unwrap(),
    SPEED_ETAG,
    HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 },
);
const HEAT: Channel<u16> = Channel::soft(
    Subject::new(0x200).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(3), validity: Duration::from_millis(8) },
)
.with_etag(Etag::new(5_000).unwrap());

type Half = EventHalf<1, 4, 4, 16, 6, 6>;

/// In microseconds: the phase, 191 for the wait, 100 and 131 for two attempts, a gap of 30, rounded up to the
/// step of the scene.
const DELIVERY: u64 = 2_460;

/// A host with one owner of everything.
struct Node {
    half: Half,
    dispatcher: Dispatcher<1>,
    chip: Mcp2515<Spi>,
}

impl Node {
    fn new(world: &Shared, name: &str, tx_node: TxNode) -> Self {
        let config = Config { oscillator_hz: 16_000_000, bit_rate: BitRate::MAX, filters: Filters::ALL };
        let chip = Mcp2515::new(model::attach(world, name), &mut NoDelay, &config).unwrap();
        let buffers = HrtBuffers::new(GlobalClock::free_running());
        let half = Half::new(Some(tx_node), &CALENDAR, (), buffers);
        Self { half, dispatcher: Dispatcher::new(&CALENDAR), chip }
    }

    /// All that is to be done at this instant.
    fn run(&mut self, now: Instant) {
        while let Some((mailbox, what)) = self.chip.outcome(now).unwrap() {
            if let Some(input) = outcome(mailbox, what, now, self.half.hard_mut()) {
                self.half.on_input(&input, now);
            }
        }
        while let Some(frame) = self.chip.receive().unwrap() {
            if let Some(input) = receive(&frame, now, self.half.hard_mut()) {
                self.half.on_input(&input, now);
            }
        }
        loop {
            match self.dispatcher.poll(now, self.half.hard_mut()) {
                CalendarStep::Command(command) => self.chip.execute(&command, now).unwrap(),
                CalendarStep::Notify(buffer) => _ = self.half.on_input(&Input::Notice(buffer), now),
                CalendarStep::Continue => {}
                CalendarStep::SleepUntil(_) => break,
            }
        }
        while let Step::Command(command) = self.half.poll(now) {
            self.chip.execute(&command, now).unwrap();
        }
    }
}

/// Publishes in every period for a quarter of a second; returns what arrived: hard, soft.
fn scene(faults: FaultModel) -> (Vec<u16>, Vec<u16>, [Node; 2]) {
    let world = World::new(BitRate::MAX, faults);
    let mut nodes = [Node::new(&world, "publisher", PUBLISHER), Node::new(&world, "subscriber", SUBSCRIBER)];
    let speed = nodes[0].half.announce(&SPEED).unwrap();
    let heat = nodes[0].half.announce(&HEAT).unwrap();
    let fifo = Policy::Fifo(Depth::new(4).unwrap());
    let speeds = nodes[1].half.subscribe(&SPEED, Filter::ALL, fifo).unwrap();
    let heats = nodes[1].half.subscribe(&HEAT, Filter::ALL, fifo).unwrap();
    let (mut hard, mut soft) = (Vec::new(), Vec::new());
    for step in 0..25_000_u64 {
        let microseconds = 10 * step;
        world.borrow_mut().run(VirtualInstant::from_ticks(microseconds * 1_000));
        let now = Instant::from_epoch(Duration::from_micros(microseconds));
        if step % 1_000 == 0 {
            let due = nodes[0].half.publish(now, &speed, &Event::new((step / 1_000) as u16)).unwrap();
            assert!(due.command().is_none());
        }
        if step % 250 == 100 {
            let due = nodes[0].half.publish(now, &heat, &Event::new((step / 250) as u16)).unwrap();
            if let Some(command) = due.command() {
                nodes[0].chip.execute(&command, now).unwrap();
            }
        }
        nodes.iter_mut().for_each(|node| node.run(now));
        while let Some(event) = nodes[1].half.next(&speeds) {
            assert_eq!((event.publisher, microseconds % 10_000), (PUBLISHER, DELIVERY), "its instant");
            hard.push(event.content);
        }
        soft.extend(std::iter::from_fn(|| nodes[1].half.next(&heats)).map(|event| event.content));
    }
    (hard, soft, nodes)
}

#[test]
fn hard_and_soft_events_flow() {
    let (hard, soft, mut nodes) = scene(FaultModel::none());
    assert_eq!(hard, (0..25).collect::<Vec<u16>>());
    assert_eq!(soft, (0..100).collect::<Vec<u16>>());
    for node in &mut nodes {
        assert_eq!(node.half.take_exception(), None);
        assert_eq!(node.chip.status().unwrap(), Default::default());
    }
}

#[test]
fn faults_within_the_omission_degree_do_not_show() {
    let fault = || Fault::Inverted(BitPosition::FromStart(40));
    // Every seventh of the first frames is destroyed.
    let rules = (1..12).map(|skip| Rule { frames: Frames::ANY, skip: 7 * skip, count: 1, fault: fault() });
    let (hard, soft, nodes) = scene(rules.fold(FaultModel::none(), FaultModel::with_rule));
    assert_eq!(hard, (0..25).collect::<Vec<u16>>());
    assert_eq!(soft, (0..100).collect::<Vec<u16>>());
    let omitted = nodes[0].half.exceptions(ExceptionKind::OmissionDegreeExceeded);
    assert_eq!(omitted, 0);
}
