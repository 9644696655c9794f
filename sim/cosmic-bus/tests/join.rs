//! Two running buses become one.

mod common;

use common::{bit, bus_of, events_until, received, sent, standard};
use cosmic_bus::{BitPosition, Bus, Fault, FaultModel, Filter, Rule};
use cosmic_core::can::BitRate;

#[test]
fn stations_of_both_hear_each_other_and_keep_what_they_have() {
    // The other's station has failed once.
    let fault = Fault::Inverted(BitPosition::FromStart(20));
    let once = FaultModel::none().with_rule(Rule { frames: Filter::ANY, skip: 0, count: 1, fault });
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    let (mut other, [c, d]) = bus_of(once);
    other.load(bit(0), c, 0, standard(3, &[])).unwrap();
    let before = events_until(&mut other, bit(400));
    assert_eq!((sent(&before, c), received(&before, d)), (1, 1));
    let errors = other.error_state(c);
    assert_ne!(errors, bus.error_state(a));
    bus.load(bit(0), a, 0, standard(1, &[])).unwrap();
    let before = events_until(&mut bus, bit(400));
    assert_eq!((sent(&before, a), received(&before, b)), (1, 1));

    let theirs = bus.join(other).unwrap();
    let [c, d] = theirs[..] else { panic!("{theirs:?}") };
    assert_eq!((bus.name(c), bus.name(d)), ("station 0", "station 1"));
    assert_eq!(bus.error_state(c), errors);
    bus.load(bit(500), a, 0, standard(1, &[])).unwrap();
    bus.load(bit(500), c, 0, standard(2, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((sent(&events, a), sent(&events, c)), (1, 1));
    assert_eq!([a, b, c, d].map(|station| received(&events, station)), [1, 2, 1, 2]);
}

#[test]
fn what_does_not_fit_is_given_back() {
    let (mut bus, _) = bus_of::<1>(FaultModel::none());
    let (mut busy, [a]) = bus_of(FaultModel::none());
    busy.load(bit(0), a, 0, standard(1, &[])).unwrap();
    events_until(&mut busy, bit(10));
    events_until(&mut bus, bit(10));
    assert!(bus.is_free() && !busy.is_free());
    let busy = bus.join(busy).expect_err("a frame is on the wire");
    assert_eq!(busy.name(a), "station 0");
    // Another instant, another rate.
    assert!(bus.join(Bus::new(BitRate::MAX, FaultModel::none())).is_err());
    let mut slow = Bus::new(BitRate::new(500_000).unwrap(), FaultModel::none());
    events_until(&mut slow, bit(10));
    assert!(bus.join(slow).is_err());
    assert_eq!(bus.stations().count(), 1);
}
