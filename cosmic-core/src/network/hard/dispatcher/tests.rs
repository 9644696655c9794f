//! What the dispatcher keeps of the next instant is what the clock says of it; and a slot that is being given up holds
//! nobody up.

use super::super::attach::{Attach, Detaching};
use super::super::buffers::Role;
use super::*;
use crate::calendar::{Segment, Slot};
use crate::can::{BitRate, Etag, Outcome, Payload, TxNode};
use crate::time::{Rate, RateChange, Uncertainty};
use proptest::prelude::*;

const ME: TxNode = TxNode::new(1).unwrap();
const OTHER: TxNode = TxNode::new(2).unwrap();

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(10),
    },
    Duration::from_millis(10),
    &[slot(0, ME, 10, 2), slot(1, OTHER, 5, 4), slot(2, OTHER, 10, 7)],
);

const fn slot(number: u16, publisher: TxNode, period_ms: u64, phase_ms: u64) -> Slot {
    Slot {
        etag: Etag::new(Etag::HARD_FIRST.get() + number).unwrap(),
        publisher,
        len: 2,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(period_ms),
        phase: Duration::from_millis(phase_ms),
    }
}

struct Node {
    now: Instant,
    dispatcher: Dispatcher<4>,
    buffers: HrtBuffers<4>,
    ids: [BufferId; 3],
}

impl Node {
    fn new() -> Self {
        let mut buffers = HrtBuffers::new(GlobalClock::free_running());
        let ids = [0, 1, 2].map(|at| {
            let slot = &CALENDAR.slots()[at];
            let role = Role { publishes: at == 0, subscribes: true };
            buffers.attach(&Attach { calendar: &CALENDAR, slot, role }).unwrap()
        });
        Self { now: Instant::EPOCH, dispatcher: Dispatcher::new(&CALENDAR), buffers, ids }
    }

    /// Polls until there is nothing to do now, but not for ever.
    fn poll(&mut self) -> Instant {
        for _ in 0..100 {
            let knew = self.dispatcher.next.is_known && self.dispatcher.revision == self.buffers.revision;
            let step = self.dispatcher.poll(self.now, &mut self.buffers);
            if !knew && self.dispatcher.next.is_known {
                self.check_next();
            }
            match step {
                CalendarStep::SleepUntil(instant) => return instant,
                CalendarStep::Command(Command::Load(..)) => {
                    _ = self.buffers.on_outcome(Outcome::Sent, self.now);
                }
                CalendarStep::Command(Command::Withdraw(_)) => {
                    _ = self.buffers.on_outcome(Outcome::Withdrawn, self.now);
                }
                CalendarStep::Notify(_) | CalendarStep::Continue => {}
            }
        }
        panic!("the dispatcher never sleeps");
    }

    /// Against the clock as it is, without anything that was kept from earlier looks.
    fn check_next(&self) {
        let Next { at, stage, accurate, wake, latest, deadline, opened, .. } = self.dispatcher.next;
        let clock = &self.buffers.clock;
        let due = self.dispatcher.due[usize::from(at)];
        assert!(self.dispatcher.due.iter().all(|other| due <= *other));
        assert_eq!(wake, clock.to_local(due));
        let ready = self.dispatcher.occurrences[usize::from(at)].ready;
        let times = CALENDAR.slot_times(&CALENDAR.slots()[usize::from(at)]);
        let jitter = CALENDAR.segment().release_jitter;
        assert_eq!(latest, wake + jitter);
        match stage {
            Stage::Ready => assert_eq!(deadline, ready + times.deadline + jitter),
            Stage::Deadline => {}
            Stage::Delivery => {
                assert_eq!(opened, clock.to_local(ready.saturating_sub(CALENDAR.segment().gap())))
            }
        }
        if self.now <= latest {
            assert_eq!(accurate, clock.is_accurate(self.now, latest, CALENDAR.segment().accuracy));
        }
    }
}

#[test]
fn a_slot_that_is_being_given_up_does_not_keep_the_dispatcher_from_sleeping() {
    let mut node = Node::new();
    node.poll();
    let mut detaching = Detaching::new(node.ids[0], Role { publishes: false, subscribes: true });
    while !node.buffers.detach_step(&mut detaching) {}
    let mut detaching = Detaching::new(node.ids[1], Role { publishes: false, subscribes: true });
    // The roles are given up, then the slots, and last the buffer, which the dispatcher is told of.
    for _ in 0..4 {
        assert!(!node.buffers.detach_step(&mut detaching));
        for _ in 0..30 {
            node.now = node.poll();
        }
    }
    while !node.buffers.detach_step(&mut detaching) {}
    // The other slots go on.
    let counters = |node: &Node| node.buffers.counters(node.ids[2]).unwrap();
    let before = counters(&node).missed;
    for _ in 0..30 {
        node.now = node.poll();
    }
    assert!(counters(&node).missed > before);
}

fn clock() -> impl Strategy<Value = (i64, i32, u64, i32, u32, u64)> {
    let steps = prop_oneof![-2_000_i64..2_000, -20_000_000_i64..20_000_000];
    (steps, -100_000_i32..100_000, 0_u64..6_000, 0_i32..5_000, 0_u32..3_000, 1_u64..100)
}

proptest! {
    #[test]
    fn what_is_kept_of_the_next_instant_is_what_the_clock_says(
        steps in prop::collection::vec((0_u64..6_000_000, prop::option::weighted(0.1, clock()), any::<bool>()), 1..150)
    ) {
        let mut node = Node::new();
        for (ahead, clock, publishes) in steps {
            let due = node.poll();
            node.now = due.min(node.now + Duration::from_ticks(ahead));
            if publishes {
                node.buffers.publish(node.ids[0], Payload::new(&[1, 2]).unwrap());
            }
            if let Some((step, rate, error, rate_error, rate_change, valid_ms)) = clock {
                let global = node.buffers.clock.to_global(node.now).offset_by(step);
                let uncertainty = Uncertainty {
                    error: Duration::from_ticks(error),
                    rate_error: Rate::from_parts_per_billion(rate_error * 100),
                    rate_change: RateChange::from_parts_per_billion(rate_change * 100),
                    valid_until: node.now + Duration::from_millis(valid_ms),
                };
                let rate = Rate::from_parts_per_billion(rate);
                node.buffers.set_clock(GlobalClock::new(node.now, global, rate, uncertainty));
            }
        }
    }
}
