//! Publishing in each period, and in each slot.

use std::cell::RefCell;
use std::pin::pin;

use cosmic_core::Subject;
use cosmic_core::calendar::Slot;
use cosmic_core::event_layer::{Channel, HardAttributes};
use cosmic_core::time::Duration;
use cosmic_rtic::Parts;

use crate::bench::*;

#[test]
fn an_event_in_each_period() {
    let Parts { node, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut numbers = 1..;
    let count = |_: &mut Resource<'_>| numbers.next().unwrap();
    let mut task = pin!(cosmic_rtic::publish_every(&HEAT, Duration::from_micros(10), &mut resource, count));
    for (now, expected) in [
        (0, &[][..]),
        (9_999, &[]),
        (10_000, &["published 1"]),
        // Two instants late: both events, at once.
        (30_000, &["published 2", "published 3"]),
    ] {
        NOW.set(now);
        run(task.as_mut());
        assert_eq!(notes(&node), expected, "at {now}");
    }
    LOADED.take();
}

/// The channel is announced before its first slot and not earlier, since a slot without an event is an error.
#[test]
fn an_event_before_each_slot() {
    const SLOT: Slot = CALENDAR.slots()[0];
    const SPEED: Channel<u16> = Channel::hard(
        Subject::new(0xC4).unwrap(),
        SLOT.etag,
        HardAttributes { period: SLOT.period, periodic: true, omission_degree: 1 },
    );
    let Parts { node, .. } = parts();
    let node = RefCell::new(node);
    let mut resource = Resource(&node);
    let mut numbers = 1..;
    let count = |_: &mut Resource<'_>| numbers.next().unwrap();
    let lead = Duration::from_micros(300);
    let mut task = pin!(cosmic_rtic::publish_in_slots(&SPEED, &SLOT, lead, &mut resource, count));
    for (now, expected) in [
        (0, &[][..]),
        (1_699_999, &[]),
        (1_700_000, &["published 1"]),
        (11_699_999, &[]),
        (11_700_000, &["published 2"]),
    ] {
        NOW.set(now);
        run(task.as_mut());
        assert_eq!(notes(&node), expected, "at {now}");
        assert_eq!(node.borrow().channel_counters(SPEED.subject()).is_some(), now >= 1_700_000);
    }
}
