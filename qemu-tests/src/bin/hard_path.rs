//! The hard real-time path of the core on a Cortex-M: two nodes, cycle by cycle, with exact instants.
//!
//! Time is a parameter of the core, so the instants here are those of the program, not the machine's:
//! what is printed is the same on any processor, to the nanosecond. The publisher's clock is global time;
//! the subscriber's is three seconds ahead and 20 ppm slow. How many instructions a call takes goes to
//! standard error.
#![no_std]
#![no_main]

use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::network::hard::{Attach, BufferId, CalendarStep, Counters, Dispatcher, HrtBuffers, Role};
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate, Uncertainty};
use qemu_tests::mono::Mono;
use qemu_tests::{count, measured, pass, println};

const SLOTS: [Slot; 1] = [Slot {
    etag: Etag::HARD_FIRST,
    publisher: TxNode::MIN,
    len: 8,
    omission_degree: 1,
    periodic: true,
    period: Duration::from_millis(10),
    phase: Duration::from_millis(1),
}];

const CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(10),
    &SLOTS,
);

/// What the bus makes of the frame of a cycle.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Bus {
    /// It is sent at the first try.
    Fine,
    /// It fails once: k = 1 covers that.
    OneFault,
    /// The publisher sees an error in the last bit and sends again; the subscriber has two copies.
    Twice,
    /// It fails at every try.
    Dead,
}

struct Node {
    name: &'static str,
    clock: GlobalClock,
    buffers: HrtBuffers<4>,
    dispatcher: Dispatcher<4>,
    buffer: BufferId,
    seen: Counters,
}

#[cortex_m_rt::entry]
fn main() -> ! {
    Mono::start();
    let mut publisher = Node::new("publisher", GlobalClock::free_running(), true);
    let mut subscriber = Node::new("subscriber", drifting(Uncertainty::NONE), false);

    let mut cycle = 0;
    let mut run = |title: &str, published: &[u8], bus, nodes: [&mut Node; 2]| {
        println!("cycle {}: {}", cycle, title);
        run_cycle(cycle, published, bus, nodes);
        cycle += 1;
    };
    run("sent at the first try", &[1], Bus::Fine, [&mut publisher, &mut subscriber]);
    run("sent at the second try", &[2], Bus::OneFault, [&mut publisher, &mut subscriber]);
    run("sent twice", &[3], Bus::Twice, [&mut publisher, &mut subscriber]);
    run("published twice", &[4, 5], Bus::Fine, [&mut publisher, &mut subscriber]);
    run("not published", &[], Bus::Fine, [&mut publisher, &mut subscriber]);
    run("more faults than k", &[6], Bus::Dead, [&mut publisher, &mut subscriber]);
    let vague = Uncertainty { error: Duration::from_micros(6), ..Uncertainty::NONE };
    subscriber.buffers.set_clock(drifting(vague));
    run("the subscriber's clock is out of bound", &[7], Bus::Fine, [&mut publisher, &mut subscriber]);
    subscriber.buffers.set_clock(drifting(Uncertainty::NONE));
    publisher.buffers.inhibit(true);
    run("the publisher's calendar is another", &[8], Bus::Fine, [&mut publisher, &mut subscriber]);
    publisher.buffers.inhibit(false);
    run("all is well again", &[9], Bus::Fine, [&mut publisher, &mut subscriber]);

    measure(&mut publisher, &mut subscriber);
    pass()
}

/// A clock that is three seconds ahead of global time and 20 ppm slower.
fn drifting(uncertainty: Uncertainty) -> GlobalClock {
    let ahead = Instant::from_epoch(Duration::from_secs(3));
    GlobalClock::new(ahead, GlobalInstant::EPOCH, Rate::from_parts_per_billion(20_000), uncertainty)
}

/// Runs both nodes through one period, from one event of a dispatcher or of the bus to the next.
fn run_cycle(cycle: u64, published: &[u8], bus: Bus, nodes: [&mut Node; 2]) {
    let [publisher, subscriber] = nodes;
    for &value in published {
        publisher.buffers.publish(publisher.buffer, Payload::full([value; 8]));
    }
    let start = GlobalInstant::EPOCH + Duration::from_millis(10 * cycle);
    let end = start + Duration::from_millis(10);
    let mut wakes = [start; 2];
    let mut frame: Option<(Frame, GlobalInstant)> = None;
    loop {
        let arrival = frame.map_or(GlobalInstant::FAR_FUTURE, |(_, at)| at);
        let now = wakes[0].min(wakes[1]).min(arrival);
        if now >= end {
            break;
        }
        if let Some((sent, at)) = frame
            && at == now
        {
            frame = None;
            publisher.buffers.on_outcome(Outcome::Sent, publisher.clock.to_local(now));
            for _ in 0..if bus == Bus::Twice { 2 } else { 1 } {
                assert!(subscriber.buffers.on_frame(&sent, subscriber.clock.to_local(now)));
            }
        }
        for (node, wake) in [&mut *publisher, &mut *subscriber].into_iter().zip(&mut wakes) {
            if *wake > now {
                continue;
            }
            let (next, command) = node.wake(now);
            *wake = next;
            match command {
                Some(Command::Load(mailbox, loaded)) => {
                    assert_eq!(mailbox, Mailbox::Hard);
                    frame = Some((loaded, arrival_of(bus, now)));
                }
                Some(Command::Withdraw(mailbox)) => {
                    assert_eq!(mailbox, Mailbox::Hard);
                    frame = None;
                    node.buffers.on_outcome(Outcome::Withdrawn, node.clock.to_local(now));
                }
                None => {}
            }
        }
    }
    publisher.print_counts();
    subscriber.print_counts();
}

/// The end of the frame on the wire, if it is loaded at `now` and behind the longest other frame.
fn arrival_of(bus: Bus, now: GlobalInstant) -> GlobalInstant {
    let times = CALENDAR.slot_times(&SLOTS[0]);
    let sent = now + times.latest_start + BitRate::MAX.longest_frame(8);
    match bus {
        Bus::Fine | Bus::Twice => sent,
        Bus::OneFault => sent + BitRate::MAX.bits(31) + BitRate::MAX.longest_frame(8),
        Bus::Dead => GlobalInstant::FAR_FUTURE,
    }
}

impl Node {
    fn new(name: &'static str, clock: GlobalClock, publishes: bool) -> Self {
        let mut buffers = HrtBuffers::new(clock);
        let role = Role { publishes, subscribes: !publishes };
        let buffer = buffers.attach(&Attach { calendar: &CALENDAR, slot: &SLOTS[0], role }).unwrap();
        let dispatcher = Dispatcher::new(&CALENDAR);
        Self { name, clock, buffers, dispatcher, buffer, seen: Counters::NONE }
    }

    /// The dispatcher's task at `now`, until it sleeps. Gives when it wants to wake up, and a command.
    fn wake(&mut self, now: GlobalInstant) -> (GlobalInstant, Option<Command>) {
        let mut command = None;
        loop {
            match self.dispatcher.poll(self.clock.to_local(now), &mut self.buffers) {
                CalendarStep::Command(next) => {
                    match next {
                        Command::Load(_, frame) => {
                            let value = frame.payload.as_slice()[0];
                            println!("  {:>8} ns {} loads {}", nanoseconds(now), self.name, value);
                        }
                        Command::Withdraw(_) => {
                            println!("  {:>8} ns {} withdraws", nanoseconds(now), self.name);
                        }
                    }
                    assert_eq!(command.replace(next), None);
                }
                CalendarStep::Notify(buffer) => {
                    assert_eq!(buffer, self.buffer);
                    if let Some(delivery) = self.buffers.take(buffer) {
                        println!(
                            "  {:>8} ns {} is delivered {}",
                            nanoseconds(now),
                            self.name,
                            delivery.payload.as_slice()[0]
                        );
                    }
                }
                CalendarStep::Continue => {}
                // Local instants are rounded down, so the next global nanosecond may be meant.
                CalendarStep::SleepUntil(wake) => {
                    let wake = self.clock.to_global(wake).max(now + Duration::from_ticks(1));
                    return (wake, command);
                }
            }
        }
    }

    /// Prints the counts that have changed.
    fn print_counts(&mut self) {
        let counts = self.buffers.counters(self.buffer).unwrap();
        let named = |c: &Counters| {
            [
                ("sent", c.sent),
                ("omitted", c.omitted),
                ("unused", c.unused),
                ("replaced", c.replaced),
                ("skipped", c.skipped),
                ("inhibited", c.inhibited),
                ("delivered", c.delivered),
                ("missed", c.missed),
                ("duplicates", c.duplicates),
                ("untimely", c.untimely),
                ("overrun", c.overrun),
            ]
        };
        for ((name, now), (_, before)) in named(&counts).into_iter().zip(named(&self.seen)) {
            if now != before {
                println!("  {}: {} +{}", self.name, name, now - before);
            }
        }
        self.seen = counts;
    }
}

fn nanoseconds(at: GlobalInstant) -> u64 {
    at.since_epoch().as_ticks()
}

/// What an event costs either node, all calls on its way together.
fn measure(publisher: &mut Node, subscriber: &mut Node) {
    let times = CALENDAR.slot_times(&SLOTS[0]);
    let frame = Frame::new(Id::new(Priority::HARD, TxNode::MIN, Etag::HARD_FIRST), Payload::full([1; 8]));
    let mut slot = GlobalInstant::EPOCH + Duration::from_millis(91);
    let period = SLOTS[0].period;

    let Node { clock, buffers, dispatcher, buffer, .. } = publisher;
    look(dispatcher, clock.to_local(slot.saturating_sub(Duration::from_millis(5))), buffers);
    print_measured(
        "publisher: publish, ready, sent, deadline",
        count::instructions(|| {
            buffers.publish(*buffer, frame.payload);
            let loaded = dispatcher.poll(clock.to_local(slot), buffers);
            assert!(matches!(loaded, CalendarStep::Command(Command::Load(..))));
            look(dispatcher, clock.to_local(slot), buffers);
            buffers.on_outcome(Outcome::Sent, clock.to_local(slot + times.latest_start));
            let asleep = dispatcher.poll(clock.to_local(slot + times.delivery), buffers);
            assert!(asleep == CalendarStep::Continue);
            look(dispatcher, clock.to_local(slot + times.delivery), buffers);
            slot = slot + period;
        }),
    );

    let mut slot = GlobalInstant::EPOCH + Duration::from_millis(91);
    let Node { clock, buffers, dispatcher, buffer, .. } = subscriber;
    look(dispatcher, clock.to_local(slot.saturating_sub(Duration::from_millis(5))), buffers);
    print_measured(
        "subscriber: ready, arrival, delivery, take",
        count::instructions(|| {
            let opened = dispatcher.poll(clock.to_local(slot), buffers);
            assert!(opened == CalendarStep::Continue);
            look(dispatcher, clock.to_local(slot), buffers);
            assert!(buffers.on_frame(&frame, clock.to_local(slot + times.latest_start)));
            let delivered = dispatcher.poll(clock.to_local(slot + times.delivery), buffers);
            assert!(delivered == CalendarStep::Notify(*buffer));
            assert!(buffers.take(*buffer).is_some());
            look(dispatcher, clock.to_local(slot + times.delivery), buffers);
            slot = slot + period;
        }),
    );
    let asleep = clock.to_local(slot.saturating_sub(Duration::from_millis(5)));
    print_measured(
        "poll, nothing due",
        count::instructions(|| {
            assert!(matches!(dispatcher.poll(asleep, buffers), CalendarStep::SleepUntil(_)));
        }),
    );
}

/// The dispatcher looks for its next instant, which is still to come.
fn look(dispatcher: &mut Dispatcher<4>, now: Instant, buffers: &mut HrtBuffers<4>) {
    assert!(matches!(dispatcher.poll(now, buffers), CalendarStep::SleepUntil(_)));
}

fn print_measured(name: &str, count: count::Count) {
    measured!("{}: {} instructions, exact {}", name, count.instructions, count.exact);
}
