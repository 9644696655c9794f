//! What README shows of an application, compiled and run.

use std::cell::RefCell;
use std::pin::pin;
use std::task::{Context, Waker};

use cosmic_core::Subject;
use cosmic_core::calendar::{Calendar, Slot};
use cosmic_core::can::Etag;
use cosmic_core::event_layer::{Channel, HardAttributes, PublishError};
use cosmic_core::plan::NodePlan;
use cosmic_rtic::prelude::*;
use cosmic_rtic::start;

use crate::bench::{Bench, OWN, PLAN, Room, SEGMENT, run};

struct Vehicle;

impl System for Vehicle {
    type Board = Bench;
    type Capacity = Room;
    type Services = ();
    type Observer = ();
}

fn log(error: PublishError) {
    panic!("it is published, or so README says: {error}");
}

fn apply(_speed: u32) {}

// As README shows it.
cosmic_core::content! {
    /// The speed of one wheel.
    #[derive(Clone, Copy)]
    pub struct WheelSpeed {
        /// In millimetres per second.
        pub speed: u32,
        /// Has the sensor found itself in order?
        pub valid: bool,
    }
}

const WHEEL_SPEED: Channel<WheelSpeed> = Channel::hard(
    Subject::new(0xC05A_1C00_0000_0001).unwrap(),
    Etag::new(100).unwrap(),
    HardAttributes { period: Duration::from_millis(10), periodic: true, omission_degree: 1 },
);

/// A task of the sensor. `node` is the resource that the tasks share by RTIC: the node, behind a lock.
async fn measure(mut node: impl Mutex<T = Node<Vehicle>>) {
    let wheel = Publisher::announce(&WHEEL_SPEED, &mut node).expect("it is planned");
    let published = wheel.publish(WheelSpeed { speed: 13_900, valid: true }, &mut node);
    published.unwrap_or_else(log); // why not, such as a queue that is full
}

/// A task of the brake.
async fn brake(mut node: impl Mutex<T = Node<Vehicle>>) {
    let wheel = Subscriber::subscribe(&WHEEL_SPEED, Policy::Latest, &mut node).expect("it is planned");
    loop {
        let event = wheel.next(&mut node).await; // event.content, event.publisher, event.received_at
        apply(event.content.speed);
    }
}
// Up to here.

static CALENDAR: Calendar = Calendar::checked(
    SEGMENT,
    Duration::from_millis(10),
    &[Slot {
        etag: Etag::HARD_FIRST,
        publisher: OWN,
        len: 5,
        omission_degree: 1,
        periodic: true,
        period: Duration::from_millis(10),
        phase: Duration::from_millis(2),
    }],
);

struct Resource<'a>(&'a RefCell<Node<Vehicle>>);

impl Mutex for Resource<'_> {
    type T = Node<Vehicle>;

    fn lock<R>(&mut self, work: impl FnOnce(&mut Self::T) -> R) -> R {
        work(&mut self.0.borrow_mut())
    }
}

#[test]
fn the_tasks_of_readme_publish_and_wait() {
    let plan = NodePlan { calendar: &CALENDAR, ..PLAN };
    let Parts { node, .. } = start(Bench, &plan, Box::leak(Box::new(Storage::new()))).unwrap();
    let node = RefCell::new(node);
    let measured = pin!(measure(Resource(&node))).poll(&mut Context::from_waker(Waker::noop()));
    assert!(measured.is_ready());
    let counters = node.borrow().channel_counters(WHEEL_SPEED.subject()).unwrap();
    assert_eq!(counters.published, 1);
    run(pin!(brake(Resource(&node))));
}

#[test]
fn readme_shows_this_code() {
    let (readme, here) = (include_str!("../../../README.md"), include_str!("readme.rs"));
    let shown = readme.split("```rust\n").nth(1).and_then(|rest| rest.split("```\n").next()).unwrap();
    let compiled = here.split("// As README shows it.\n").nth(1).unwrap();
    let compiled = compiled.split("// Up to here.\n").next().unwrap();
    assert_eq!(shown, compiled);
}
