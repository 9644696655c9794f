//! One way through the house: whatever hosts a node, the same frames lead to the same counts.
//!
//! The simulated cluster hosts a node on the bit-accurate bus. Beside it stands the smallest host there is, which
//! does the three things that a host does: it hands in inputs, carries out commands, and polls at an instant.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, FaultModel, VirtualInstant, WireFrame};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Outcome, Payload, Priority, TxNode};
use cosmic_core::event_half::{EventHalf, Input, Step, outcome, receive};
use cosmic_core::event_layer::{
    Channel, ChannelCounters, Depth, ExceptionKind, Filter, HardAttributes, Policy, SoftAttributes,
};
use cosmic_core::network::hard::{self, Dispatcher, HrtBuffers};
use cosmic_core::time::{Duration, GlobalClock, Instant};
use rand_core::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

const ME: TxNode = TxNode::new(1).unwrap();
const PUBLISHER: TxNode = TxNode::new(2).unwrap();
const STRANGER: TxNode = TxNode::new(3).unwrap();
const PERIOD: Duration = Duration::from_millis(10);

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(5),
    },
    PERIOD,
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: PUBLISHER,
        len: 4,
        omission_degree: 1,
        periodic: true,
        period: PERIOD,
        phase: Duration::from_millis(2),
    }],
);

const SPEED: Channel<u32> = Channel::hard(
    Subject::new(0x5EED).unwrap(),
    Etag::HARD_FIRST,
    HardAttributes { period: PERIOD, periodic: true, omission_degree: 1 },
);
const TEMPERATURE: Channel<u16> = Channel::soft(
    Subject::new(0x7E39).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(5), validity: Duration::from_millis(20) },
)
.with_etag(Etag::BOUND_LAST);

/// Nobody fetches: queues overflow, in every host alike.
const SHORT: Policy = Policy::Fifo(Depth::new(3).unwrap());

/// What a node counted: each kind of exception, what happened on its channels, and what concerned nobody.
#[derive(PartialEq, Eq, Debug)]
struct Counts {
    exceptions: Vec<(&'static str, u32)>,
    channels: [Option<ChannelCounters>; 2],
    foreign: u32,
}

/// In both hosts: room for one slot, two channels, four waiting events.
macro_rules! counts {
    ($half:expr) => {{
        let half = $half;
        Counts {
            exceptions: ExceptionKind::ALL.iter().map(|kind| (kind.name(), half.exceptions(*kind))).collect(),
            channels: [SPEED.subject(), TEMPERATURE.subject()].map(|subject| half.channel_counters(subject)),
            foreign: half.foreign_frames(),
        }
    }};
}

/// Frames of all sorts, one every half a millisecond: wanted, foreign, malformed, with a hard real-time etag from
/// the wrong node, of the wrong priority, at the wrong time, with the node's own TxNode, control frames.
fn script(seed: u64) -> Vec<(u64, Frame)> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut pick = |from: &[u64]| from[(random.next_u64() % from.len() as u64) as usize];
    let frames = (0..400).map(|number| {
        let etag = [Etag::HARD_FIRST.get(), Etag::BOUND_LAST.get(), 5_000, 101, 18];
        let etag = Etag::new(pick(&etag.map(u64::from)) as u16).unwrap();
        let nodes = [PUBLISHER, PUBLISHER, STRANGER, ME].map(|node| u64::from(node.get()));
        let node = TxNode::new(pick(&nodes) as u8).unwrap();
        let priority = Priority::new(pick(&[0, 0, 9, 252]) as u8);
        let bytes = [number as u8; 8];
        let payload = Payload::new(&bytes[..pick(&[2, 2, 4, 8]) as usize]).unwrap();
        let id = if number % 40 == 4 {
            // Just behind the ready instant of a slot.
            Id::new(Priority::HARD, PUBLISHER, Etag::HARD_FIRST)
        } else {
            Id::new(priority, node, etag)
        };
        (number * 500 + 150, Frame::new(id, payload))
    });
    frames.collect()
}

const END: u64 = 205_000;

/// Subscribes, and does nothing more.
struct Idle;

impl Application<()> for Idle {
    fn start(&mut self, node: &mut Access<'_, ()>) -> Instant {
        node.subscribe(&SPEED, Filter::ALL, SHORT).unwrap();
        node.subscribe(&TEMPERATURE, Filter::ALL, SHORT).unwrap();
        Instant::FAR_FUTURE
    }

    fn wake(&mut self, _: &mut Access<'_, ()>) -> Instant {
        Instant::FAR_FUTURE
    }

    fn notified(&mut self, _: &mut Access<'_, ()>) {}
}

fn in_the_cluster(script: &[(u64, Frame)]) -> Counts {
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()), 1);
    let node = cluster.add(NodeConfig {
        name: "node".into(),
        tx_node: Some(ME),
        calendar: &CALENDAR,
        clock: ClockErrors::NONE,
        services: Box::new(|_| ()),
        global_clock: GlobalClock::free_running(),
        application: Box::new(|| Box::new(Idle)),
    });
    let foreign = cluster.bus().attach("foreign");
    cluster.power_on(node);
    for (microsecond, frame) in script {
        let at = VirtualInstant::from_ticks(microsecond * 1_000);
        cluster.run_until(at);
        cluster.bus().load(at, foreign, 0, WireFrame::from(*frame)).expect("the last frame has gone");
    }
    cluster.run_until(VirtualInstant::from_ticks(END * 1_000));
    cluster.visit(node, |access| counts!(access.half())).expect("the node is on")
}

/// The smallest host.
struct Host {
    half: EventHalf<32, 64, 64, 200, 64, 64>,
    dispatcher: Dispatcher<32>,
}

impl Host {
    fn new() -> Self {
        let buffers = HrtBuffers::new(GlobalClock::free_running());
        let mut half = EventHalf::new(Some(ME), &CALENDAR, (), buffers);
        half.subscribe(&SPEED, Filter::ALL, SHORT).unwrap();
        half.subscribe(&TEMPERATURE, Filter::ALL, SHORT).unwrap();
        Self { half, dispatcher: Dispatcher::new(&CALENDAR) }
    }

    /// Does all that is due, instant after instant.
    fn run_until(&mut self, mut now: Instant, until: Instant) {
        while now <= until {
            let calendar = loop {
                match self.dispatcher.poll(now, self.half.hard_mut()) {
                    hard::CalendarStep::Command(command) => self.execute(command, now),
                    hard::CalendarStep::Notify(buffer) => _ = self.half.on_input(&Input::Notice(buffer), now),
                    hard::CalendarStep::Continue => {}
                    hard::CalendarStep::SleepUntil(instant) => break instant,
                }
            };
            let events = loop {
                match self.half.poll(now) {
                    Step::Command(command) => self.execute(command, now),
                    Step::SleepUntil(instant) => break instant,
                }
            };
            now = calendar.min(events);
        }
    }

    fn execute(&mut self, command: Command, now: Instant) {
        if let Command::Load(mailbox, _) = command
            && let Some(input) = outcome(mailbox, Outcome::Sent, now, self.half.hard_mut())
        {
            self.half.on_input(&input, now);
        }
    }
}

fn by_hand(script: &[(u64, Frame)]) -> Counts {
    let at = |microsecond| Instant::EPOCH + Duration::from_micros(microsecond);
    let mut host = Host::new();
    let mut now = Instant::EPOCH;
    for (microsecond, frame) in script {
        // At 1 Mbit/s; receivers have it in the last but one bit.
        let arrived = at(microsecond + u64::from(WireFrame::from(*frame).bit_count()) - 1);
        host.run_until(now, arrived);
        now = arrived;
        if let Some(input) = receive(frame, arrived, host.half.hard_mut()) {
            host.half.on_input(&input, arrived);
        }
    }
    host.run_until(now, at(END));
    counts!(&host.half)
}

#[test]
fn every_host_counts_the_same() {
    for seed in 0..8 {
        let script = script(seed);
        let counts = by_hand(&script);
        assert_eq!(in_the_cluster(&script), counts, "seed {seed}");
        let what: Vec<_> = counts.exceptions.iter().filter(|(_, count)| *count > 0).collect();
        assert!(what.len() >= 2 && counts.foreign > 100, "seed {seed} tries too little: {what:?}");
        // Nothing vanishes: a frame of a channel was delivered, or it is counted.
        let delivered = counts.channels.map(|channel| channel.unwrap().delivered);
        assert!(delivered.iter().all(|count| *count > 0), "{delivered:?}");
    }
}
