//! The calendar dispatcher and the HRT message buffers, by literal frames in virtual time: clocks that are set,
//! and frames that are not what they seem to be.

use cosmic_core::calendar::{Calendar, Segment, Slot};
use cosmic_core::can::{BitRate, Command, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::network::hard::{Attach, BufferId, CalendarStep, Counters, Dispatcher, HrtBuffers, Role};
use cosmic_core::time::{Duration, GlobalClock, GlobalInstant, Instant, Rate, Uncertainty};

const ME: TxNode = TxNode::new(1).unwrap();
const OTHER: TxNode = TxNode::new(2).unwrap();

/// Windows reach from ready to 382 µs (deadline) and 402 µs (delivery) after it, for frames of two bytes.
static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(20),
    &[slot(100, ME, 10, 1), slot(101, ME, 20, 3), slot(102, OTHER, 10, 5)],
);

const fn slot(etag: u16, publisher: TxNode, period_ms: u64, phase_ms: u64) -> Slot {
    Slot {
        etag: Etag::new(etag).unwrap(),
        publisher,
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(period_ms),
        phase: Duration::from_millis(phase_ms),
    }
}

const PUBLISHES: Role = Role { publishes: true, subscribes: false };
const SUBSCRIBES: Role = Role { publishes: false, subscribes: true };
const BOTH: Role = Role { publishes: true, subscribes: true };

fn at(microseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(microseconds))
}

/// The clock that shows `global` at `local`, in microseconds.
fn clock(local: u64, global: u64) -> GlobalClock {
    let then = GlobalInstant::from_epoch(Duration::from_micros(global));
    GlobalClock::new(at(local), then, Rate::ZERO, Uncertainty::NONE)
}

fn frame(etag: u16, publisher: TxNode, bytes: [u8; 2]) -> Frame {
    let id = Id::new(Priority::HARD, publisher, Etag::new(etag).unwrap());
    Frame::new(id, Payload::new(&bytes).unwrap())
}

/// A node whose frames are sent 150 µs after they were loaded, unless the bus is stuck.
struct Node {
    dispatcher: Dispatcher<4>,
    buffers: HrtBuffers<4>,
    ids: [Option<BufferId>; 3],
    now: u64,
    stuck: bool,
    on_wire: Option<(u64, Frame)>,
    /// What was sent, by channel.
    sent: [u32; 3],
    withdrawn: u32,
    notified: u32,
    /// The most steps that were made before the dispatcher slept.
    longest_burst: u32,
}

impl Node {
    fn new(roles: [Option<Role>; 3]) -> Self {
        let mut node = Self {
            dispatcher: Dispatcher::new(&CALENDAR),
            buffers: HrtBuffers::new(GlobalClock::free_running()),
            ids: [None; 3],
            now: 0,
            stuck: false,
            on_wire: None,
            sent: [0; 3],
            withdrawn: 0,
            notified: 0,
            longest_burst: 0,
        };
        for (number, role) in roles.into_iter().enumerate() {
            if let Some(role) = role {
                node.attach(number, role);
            }
        }
        node
    }

    fn attach(&mut self, number: usize, role: Role) {
        let slot = &CALENDAR.slots()[number];
        self.ids[number] = Some(self.buffers.attach(&Attach { calendar: &CALENDAR, slot, role }).unwrap());
    }

    fn counters(&self, number: usize) -> Counters {
        self.buffers.counters(self.ids[number].unwrap()).unwrap()
    }

    /// Sets the clock, to microseconds.
    fn set(&mut self, global: u64) {
        self.buffers.set_clock(clock(self.now, global));
    }

    fn global(&self) -> u64 {
        self.buffers.clock().to_global(at(self.now)).since_epoch().as_micros()
    }

    /// Polls until nothing is due, at this very instant.
    fn poll(&mut self) -> u64 {
        for burst in 0..100 {
            self.longest_burst = self.longest_burst.max(burst);
            match self.dispatcher.poll(at(self.now), &mut self.buffers) {
                CalendarStep::Command(Command::Load(Mailbox::Hard, frame)) => {
                    assert_eq!(self.on_wire.replace((self.now + 150, frame)), None);
                }
                CalendarStep::Command(Command::Withdraw(Mailbox::Hard)) => {
                    self.withdrawn += 1;
                    self.on_wire = None;
                    let _ = self.buffers.on_outcome(Outcome::Withdrawn, at(self.now));
                }
                CalendarStep::Command(other) => panic!("{other:?}"),
                CalendarStep::Notify(_) => self.notified += 1,
                CalendarStep::Continue => {}
                CalendarStep::SleepUntil(wake) => return wake.since_epoch().as_micros().max(self.now + 1),
            }
        }
        panic!("the dispatcher does not come to rest");
    }

    /// Lets that many microseconds pass; publishes whatever can be published, always.
    fn run(&mut self, microseconds: u64) {
        let end = self.now + microseconds;
        while self.now < end {
            for (number, id) in self.ids.into_iter().enumerate() {
                if let Some(id) = id.filter(|_| CALENDAR.slots()[number].publisher == ME) {
                    self.buffers.publish(id, Payload::new(&[0xAB, 0xCD]).unwrap());
                }
            }
            let wake = self.poll();
            self.now = wake.min(end).min(self.on_wire.map_or(end, |(done, _)| done.max(self.now)));
            if let Some((done, frame)) = self.on_wire
                && done <= self.now
                && !self.stuck
            {
                self.on_wire = None;
                self.sent[usize::from(frame.id.etag().get() - 100)] += 1;
                let _ = self.buffers.on_outcome(Outcome::Sent, at(self.now));
            } else if self.on_wire.is_some_and(|(done, _)| done <= self.now) {
                self.on_wire = self.on_wire.map(|(_, frame)| (end, frame));
            }
        }
    }
}

#[test]
fn every_slot_runs_again_after_the_clock_was_set_in_either_direction() {
    for global in [50_000_000, 150_000_000] {
        let mut node = Node::new([Some(PUBLISHES), Some(PUBLISHES), None]);
        node.set(100_000_000);
        node.run(2_000_000);
        assert_eq!(node.sent, [200, 100, 0]);
        node.set(global);
        node.run(2_000_000);
        assert_eq!(node.sent, [400, 200, 0], "set to {global}");
        assert_eq!((node.counters(0).omitted, node.counters(1).omitted), (0, 0));
    }
}

#[test]
fn subscribers_hear_all_slots_again_after_the_clock_was_set_back() {
    let mut node = Node::new([None, None, Some(SUBSCRIBES)]);
    node.attach(0, BOTH);
    node.set(102_000_000);
    node.run(1_000_000);
    assert_eq!((node.counters(0).delivered, node.counters(2).missed), (100, 100));
    node.set(50_000_000);
    node.run(1_000_000);
    // A periodic channel with nothing received says so in each of its slots.
    assert_eq!((node.counters(0).delivered, node.counters(2).missed), (200, 200));
}

#[test]
fn steps_shorter_than_a_period_and_repeated_ones_leave_no_slot_behind() {
    let mut node = Node::new([Some(BOTH), Some(PUBLISHES), Some(SUBSCRIBES)]);
    node.set(100_000_000);
    node.run(100_000);
    for step in [-30, -400, -3_000, -9_999, -35_000, 30, 400, 3_000, 9_999, 35_000i64] {
        for _ in 0..3 {
            let before = [node.sent[0], node.sent[1]];
            let delivered = node.counters(0).delivered;
            let global = node.global().wrapping_add_signed(step);
            node.set(global);
            node.run(40_000);
            // A window that is cut at either end is not used.
            let ran = [node.sent[0] - before[0], node.sent[1] - before[1]];
            assert!((3..=5).contains(&ran[0]) && (1..=3).contains(&ran[1]), "{step} µs: {ran:?}");
            assert!(node.counters(0).delivered - delivered >= 3);
        }
    }
    // Steps while no poll comes in between are one step.
    node.set(90_000_000);
    node.set(40_000_000);
    let before = node.sent;
    node.run(40_000);
    assert_eq!((node.sent[0] - before[0], node.sent[1] - before[1]), (4, 2));
}

#[test]
fn a_correction_within_the_accuracy_repeats_no_slot() {
    let mut node = Node::new([Some(PUBLISHES), None, None]);
    node.set(100_000_990);
    node.run(20);
    assert!(node.on_wire.is_some());
    // The ready instant lies in the future once more.
    node.set(100_000_995);
    node.run(400);
    assert_eq!((node.sent[0], node.withdrawn, node.counters(0).skipped), (1, 0, 0));
    node.run(9_000);
    assert_eq!(node.sent[0], 1);
}

#[test]
fn what_is_loaded_when_the_clock_is_set_is_withdrawn_and_counted() {
    let mut node = Node::new([Some(BOTH), Some(PUBLISHES), None]);
    node.set(100_000_000);
    node.stuck = true;
    node.run(1_100);
    assert!(node.on_wire.is_some());
    node.set(50_000_000);
    node.stuck = false;
    node.poll();
    assert_eq!((node.withdrawn, node.on_wire), (1, None));
    let counters = node.counters(0);
    assert_eq!((counters.omitted, counters.skipped, counters.sent), (1, 1, 0));
    assert_eq!(node.notified, 1);
    assert_eq!((node.counters(1).omitted, node.counters(1).skipped), (0, 0));
    node.run(20_000);
    assert_eq!((node.sent[0], node.sent[1]), (2, 1));
}

#[test]
fn a_frame_that_is_sent_in_spite_of_its_withdrawal_is_of_no_slot() {
    let mut node = Node::new([Some(BOTH), None, None]);
    node.set(100_000_000);
    node.stuck = true;
    node.run(1_100);
    // Loaded, and 100 µs later the clock is set to just before the ready instant.
    node.set(100_000_900);
    assert_eq!(
        node.dispatcher.poll(at(node.now), &mut node.buffers),
        CalendarStep::Command(Command::Withdraw(Mailbox::Hard))
    );
    assert_eq!(node.buffers.on_outcome(Outcome::Sent, at(node.now + 10)), None);
    (node.on_wire, node.stuck) = (None, false);
    node.run(1_000);
    let counters = node.counters(0);
    assert_eq!((counters.sent, counters.delivered, counters.duplicates, counters.omitted), (1, 1, 0, 1));
}

#[test]
fn what_has_arrived_when_the_clock_is_set_is_not_delivered() {
    let mut node = Node::new([None, None, Some(SUBSCRIBES)]);
    node.set(100_004_900);
    node.run(300);
    assert!(node.buffers.on_frame(&frame(102, OTHER, [1, 1]), at(node.now)));
    node.set(50_004_900);
    node.poll();
    let counters = node.counters(2);
    assert_eq!((counters.untimely, counters.skipped, counters.delivered), (1, 1, 0));
    // The slot of the new scale follows at once; its frame is the first, not a copy.
    node.run(300);
    assert!(node.buffers.on_frame(&frame(102, OTHER, [2, 2]), at(node.now)));
    node.run(300);
    let delivery = node.buffers.take(node.ids[2].unwrap()).unwrap();
    assert_eq!(delivery.payload.as_slice(), [2, 2]);
    assert_eq!((node.counters(2).duplicates, node.counters(2).missed), (0, 0));
}

#[test]
fn a_slot_that_is_attached_while_the_clock_is_set_runs_in_the_new_time() {
    let mut node = Node::new([Some(PUBLISHES), None, None]);
    node.set(100_000_000);
    node.run(10_000);
    node.attach(1, PUBLISHES);
    node.set(50_000_000);
    node.attach(2, SUBSCRIBES);
    node.run(40_000);
    assert_eq!(node.sent, [1 + 4, 2, 0]);
    assert_eq!(node.counters(2).missed, 4);
    // One step for each slot at most, and the instants that are due.
    assert!(node.longest_burst <= 4 + 2, "{}", node.longest_burst);
}

#[test]
fn a_frame_whose_buffer_is_given_up_is_withdrawn_and_counts_for_nobody_else() {
    let mut node = Node::new([Some(PUBLISHES), None, None]);
    node.set(100_000_000);
    node.stuck = true;
    node.run(1_100);
    node.buffers.detach(node.ids[0].take().unwrap(), PUBLISHES);
    // The place is free, and another channel takes it.
    node.attach(2, SUBSCRIBES);
    assert_eq!(
        node.dispatcher.poll(at(node.now), &mut node.buffers),
        CalendarStep::Command(Command::Withdraw(Mailbox::Hard))
    );
    assert_eq!(node.buffers.on_outcome(Outcome::Sent, at(node.now)), None);
    assert_eq!(node.counters(2), Counters::NONE);
}

#[test]
fn a_second_frame_in_a_slot_is_a_copy_or_a_contradiction() {
    let mut node = Node::new([None, None, Some(SUBSCRIBES)]);
    node.run(5_000);
    for bytes in [[1, 2], [1, 2], [1, 3], [1, 2]] {
        node.run(100);
        assert!(node.buffers.on_frame(&frame(102, OTHER, bytes), at(node.now)));
    }
    node.run(100);
    let counters = node.counters(2);
    assert_eq!((counters.duplicates, counters.contradictory, counters.delivered), (2, 1, 1));
    assert_eq!(node.buffers.take(node.ids[2].unwrap()).unwrap().payload.as_slice(), [1, 2]);
}

#[test]
fn a_frame_with_the_nodes_own_tx_node_is_not_taken_for_its_own() {
    for role in [PUBLISHES, BOTH] {
        let mut node = Node::new([Some(role), None, None]);
        node.run(1_200);
        assert!(!node.buffers.on_frame(&frame(100, ME, [6, 6]), at(node.now)));
        node.run(400);
        // Its own has been sent; subscribers on the node get that one.
        assert_eq!((node.counters(0).sent, node.counters(0).contradictory), (1, 0));
        let delivery = node.buffers.take(node.ids[0].unwrap());
        assert_eq!(
            delivery.map(|it| it.payload.as_slice().to_vec()),
            role.subscribes.then(|| vec![0xAB, 0xCD])
        );
    }
}
