//! Withdrawal: of a pending frame, of one on the wire, of one on the wire that fails.

mod common;

use common::{bit, bus_of, event, events_until, failed, received, sent, standard, withdrawn};
use cosmic_bus::{BitPosition, ErrorCause, EventKind, Fault, FaultModel, Filter, Rule};

fn destroys_the_first(count: u32) -> FaultModel {
    let fault = Fault::Inverted(BitPosition::FromStart(20));
    FaultModel::none().with_rule(Rule { frames: Filter::ANY, skip: 0, count, fault })
}

#[test]
fn a_pending_frame_leaves_at_once() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), b, 0, standard(0, &[])).unwrap();
    bus.load(bit(10), a, 0, standard(1, &[])).unwrap();
    bus.withdraw(bit(20), a, 0);
    assert_eq!(bus.next_event(), Some(bit(20)));
    let events = events_until(&mut bus, bit(20));
    assert_eq!(events, [event(bit(20), a, EventKind::Withdrawn { mailbox: 0 })]);
    bus.load(bit(20), a, 0, standard(2, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((sent(&events, a), sent(&events, b), received(&events, b)), (1, 1, 1));
}

#[test]
fn a_frame_is_pending_until_its_start_has_passed() {
    let (mut bus, [a, _]) = bus_of::<2>(FaultModel::none());
    bus.load(bit(5), a, 0, standard(1, &[])).unwrap();
    bus.withdraw(bit(5), a, 0);
    assert_eq!(events_until(&mut bus, bit(1_000)), [event(bit(5), a, EventKind::Withdrawn { mailbox: 0 })]);
    assert_eq!(bus.next_event(), None);
}

#[test]
fn withdrawing_one_frame_lets_the_station_send_another() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), b, 0, standard(0, &[])).unwrap();
    bus.load(bit(1), a, 0, standard(1, &[])).unwrap();
    bus.load(bit(1), a, 1, standard(2, &[])).unwrap();
    bus.withdraw(bit(2), a, 0);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((withdrawn(&events, a), sent(&events, a), received(&events, b)), (1, 1, 1));
    assert!(events.iter().any(|it| it.kind == EventKind::Received(standard(2, &[]))));
}

#[test]
fn a_frame_on_the_wire_completes() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    bus.withdraw(bit(10), a, 0);
    let expected = [
        event(bit(49), b, EventKind::Received(standard(0, &[]))),
        event(bit(50), a, EventKind::Sent { mailbox: 0 }),
    ];
    assert_eq!(events_until(&mut bus, bit(1_000)), expected);
}

#[test]
fn a_frame_on_the_wire_that_fails_is_dropped() {
    let (mut bus, [a, b]) = bus_of(destroys_the_first(1));
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    bus.withdraw(bit(10), a, 0);
    // Bit 20 of 000001000001000001000 is the third dominant one in a row, inverted it is recessive: the
    // sender's flag is six bits, and the receiver answers it with six more, then the delimiter.
    let over = bit(21 + 12 + 8);
    let expected = [
        event(over, a, EventKind::Failed { mailbox: 0, cause: ErrorCause::Bit }),
        event(over, a, EventKind::Withdrawn { mailbox: 0 }),
    ];
    assert_eq!(events_until(&mut bus, bit(1_000)), expected);
    assert_eq!(bus.next_event(), None);
    assert_eq!(bus.error_state(b).receive_errors, 1);
}

#[test]
fn a_frame_that_waits_for_its_next_attempt_is_pending() {
    let (mut bus, [a, b]) = bus_of(destroys_the_first(1));
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(41));
    assert_eq!(failed(&events, a), 1);
    bus.withdraw(bit(42), a, 0);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(events, [event(bit(42), a, EventKind::Withdrawn { mailbox: 0 })]);
    assert_eq!(received(&events, b), 0);
}

#[test]
fn withdrawal_from_an_empty_mailbox_does_nothing() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.withdraw(bit(0), a, 0);
    bus.withdraw(bit(0), a, 7);
    bus.load(bit(1), b, 0, standard(0, &[])).unwrap();
    bus.withdraw(bit(2), a, 0);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((withdrawn(&events, a), received(&events, a)), (0, 1));
}

#[test]
fn a_late_command_counts_as_now() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    assert_eq!(events_until(&mut bus, bit(100)), []);
    bus.load(bit(3), a, 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(events[0], event(bit(149), b, EventKind::Received(standard(0, &[]))));
}

#[test]
fn reset_empties_the_mailboxes_in_silence() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0x700, &[])).unwrap();
    bus.load(bit(0), a, 1, standard(0x701, &[])).unwrap();
    bus.reset(bit(20), a);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(events, []);
    assert_eq!(bus.error_state(b).receive_errors, 1, "the frame broke off");
    bus.load(bit(1_000), a, 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(2_000));
    assert_eq!((sent(&events, a), received(&events, b)), (1, 1));
}
