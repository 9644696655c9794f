//! An application that runs wild on a cluster: what it does to the others, with and without an announced rate.

use cosmic_bus::cluster::{Access, Application, ClockErrors, Cluster, NodeConfig};
use cosmic_bus::{Bus, FaultModel, VirtualInstant};
use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Segment};
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{
    Channel, Depth, Event, EventRate, ExceptionKind, Filter, Policy, Publication, SoftAttributes,
    Subscription,
};
use cosmic_core::time::{Duration, GlobalClock, Instant, Rate};
use std::cell::RefCell;
use std::rc::Rc;

static CALENDAR: Calendar = Calendar::checked(
    Segment {
        bit_rate: BitRate::MAX,
        accuracy: Duration::from_micros(5),
        release_jitter: Duration::from_micros(5),
    },
    Duration::from_millis(10),
    &[],
);

const fn soft(number: u64, deadline_ms: u64) -> Channel<u64> {
    let deadline = Duration::from_millis(deadline_ms);
    Channel::soft(
        Subject::new(0x1000 + number).unwrap(),
        SoftAttributes { deadline, validity: Duration::from_millis(2 * deadline_ms) },
    )
    .with_etag(Etag::new(5_000 + number as u16).unwrap())
}

/// The honest one: every 5 ms, sent within 2 ms.
const PRESSURE: Channel<u64> = soft(1, 2)
    .with_rate(EventRate::periodic(Duration::from_millis(5)).with_jitter(Duration::from_micros(100)));
/// Of the wild one: with an earlier deadline than any other.
const ALARM: Channel<u64> = soft(2, 1);
const RATE: EventRate = EventRate::sporadic(Duration::from_millis(20)).with_burst(3);

struct Honest(Option<Publication<u64>>);

impl Application<()> for Honest {
    fn start(&mut self, node: &mut Access<'_, ()>) -> Instant {
        self.0 = Some(node.announce(&PRESSURE).unwrap());
        node.now + Duration::from_millis(5)
    }

    fn wake(&mut self, node: &mut Access<'_, ()>) -> Instant {
        node.publish(self.0.as_ref().unwrap(), &Event::new(7)).unwrap();
        node.now + Duration::from_millis(5)
    }

    fn notified(&mut self, _: &mut Access<'_, ()>) {}
}

/// Publishes without pause, whatever it is told.
struct Wild(Channel<u64>, Option<Publication<u64>>);

impl Application<()> for Wild {
    fn start(&mut self, node: &mut Access<'_, ()>) -> Instant {
        self.1 = Some(node.announce(&self.0).unwrap());
        node.now + Duration::from_millis(1)
    }

    fn wake(&mut self, node: &mut Access<'_, ()>) -> Instant {
        for _ in 0..4 {
            let _ = node.publish(self.1.as_ref().unwrap(), &Event::new(u64::MAX));
        }
        node.now + Duration::from_micros(200)
    }

    fn notified(&mut self, _: &mut Access<'_, ()>) {}
}

#[derive(Default)]
struct Listener {
    pressure: Option<Subscription<u64>>,
    seen: Rc<RefCell<u64>>,
}

impl Application<()> for Listener {
    fn start(&mut self, node: &mut Access<'_, ()>) -> Instant {
        let fifo = Policy::Fifo(Depth::new(16).unwrap());
        self.pressure = Some(node.subscribe(&PRESSURE, Filter::ALL, fifo).unwrap());
        Instant::FAR_FUTURE
    }

    fn wake(&mut self, _: &mut Access<'_, ()>) -> Instant {
        Instant::FAR_FUTURE
    }

    fn notified(&mut self, node: &mut Access<'_, ()>) {
        while node.next(self.pressure.as_ref().unwrap()).is_some() {
            *self.seen.borrow_mut() += 1;
        }
    }
}

#[derive(PartialEq, Debug)]
struct Outcome {
    /// Of the honest channel: received, missed deadlines at its publisher, overdue at its subscriber.
    received: u64,
    missed: u32,
    overdue: u32,
    /// Of the wild one: frames that reached the bus.
    alarms: u32,
}

/// Ten seconds of the honest node, its subscriber, and a wild one with this channel. The honest node is off for a
/// tenth of a second if it fails.
fn run(alarm: Channel<u64>, fails: bool) -> Outcome {
    let seen = Rc::new(RefCell::new(0));
    let mut cluster = Cluster::new(Bus::new(BitRate::MAX, FaultModel::none()), 1);
    let node = |number: u8, application: Box<dyn Fn() -> Box<dyn Application<()>>>| NodeConfig {
        name: format!("node {number}"),
        tx_node: TxNode::new(number),
        calendar: &CALENDAR,
        clock: ClockErrors::realistic(Rate::from_parts_per_billion(i32::from(number) * 20_000)),
        services: Box::new(|_| ()),
        global_clock: GlobalClock::free_running(),
        application,
    };
    let honest = cluster.add(node(1, Box::new(|| Box::new(Honest(None)))));
    let wild = cluster.add(node(2, Box::new(move || Box::new(Wild(alarm, None)))));
    let counted = seen.clone();
    let listener =
        cluster.add(node(3, Box::new(move || Box::new(Listener { seen: counted.clone(), pressure: None }))));
    for station in [honest, wild, listener] {
        cluster.power_on(station);
    }
    let at = |milliseconds: u64| VirtualInstant::from_ticks(milliseconds * 1_000_000);
    cluster.run_until(at(4_000));
    if fails {
        cluster.power_off(honest);
        cluster.run_until(at(4_100));
        cluster.power_on(honest);
    }
    cluster.run_until(at(10_000));
    let missed = cluster.visit(honest, |it| it.half().exceptions(ExceptionKind::MissedDeadline)).unwrap();
    let overdue = cluster.visit(listener, |it| it.half().exceptions(ExceptionKind::EventOverdue)).unwrap();
    let alarms = cluster.visit(wild, |it| it.half().channel_counters(ALARM.subject()).unwrap().sent).unwrap();
    let received = *seen.borrow();
    Outcome { received, missed, overdue, alarms }
}

#[test]
fn without_a_rate_a_wild_application_makes_the_others_late() {
    let outcome = run(ALARM, false);
    assert!(outcome.missed > 1_000, "{outcome:?}");
    assert!(outcome.alarms > 60_000, "{outcome:?}");
}

#[test]
fn with_a_rate_it_is_contained() {
    let outcome = run(ALARM.with_rate(RATE), false);
    // Three at once, then one every 20 ms.
    assert_eq!(outcome, Outcome { received: 2_000, missed: 0, overdue: 0, alarms: 503 });
}

#[test]
fn a_subscriber_notices_by_its_own_clock_that_a_periodic_publisher_is_gone() {
    let outcome = run(ALARM.with_rate(RATE), true);
    assert_eq!((outcome.missed, outcome.received), (0, 1_978));
    // Off from 4000 to 4100 ms: the last event before is that of 3995 ms, the first one after that of 4105 ms.
    assert_eq!(outcome.overdue, 21);
}
