//! Who sends when.

mod common;

use common::{bit, bus_of, event, events_until, extended, received, remote, sent, standard};
use cosmic_bus::{EventKind, FaultModel, Filter, Filters, LoadError, WireFrame};
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use proptest::prelude::*;

#[test]
fn receivers_accept_one_bit_before_the_transmitter() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    let frame = standard(0, &[]);
    bus.load(bit(100), a, 1, frame).unwrap();
    let expected = [
        event(bit(149), b, EventKind::Received(frame)),
        event(bit(149), c, EventKind::Received(frame)),
        event(bit(150), a, EventKind::Sent { mailbox: 1 }),
    ];
    assert_eq!(events_until(&mut bus, bit(1_000)), expected);
    assert_eq!(bus.next_event(), None);
}

#[test]
fn a_frame_loaded_at_the_start_of_another_takes_part() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(100), a, 0, standard(0x101, &[])).unwrap();
    assert_eq!(events_until(&mut bus, bit(100)), []);
    let urgent = standard(0x100, &[]);
    bus.load(bit(100), b, 0, urgent).unwrap();
    let accepted = bit(100 + u64::from(urgent.bit_count()) - 1);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(events[0], event(accepted, a, EventKind::Received(urgent)));
}

#[test]
fn a_frame_loaded_later_waits_however_urgent_it_is() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    let (long, urgent) = (extended(0x1FFF_FFFF, &[0x3C; 8]), standard(0, &[]));
    let len = u64::from(long.bit_count());
    bus.load(bit(100), a, 0, long).unwrap();
    let just_after = bit(100) + cosmic_core::time::Duration::from_ticks(1);
    bus.load(just_after, b, 0, urgent).unwrap();
    let expected = [
        event(bit(100 + len - 1), b, EventKind::Received(long)),
        event(bit(100 + len), a, EventKind::Sent { mailbox: 0 }),
        event(bit(100 + len + 3 + 49), a, EventKind::Received(urgent)),
        event(bit(100 + len + 3 + 50), b, EventKind::Sent { mailbox: 0 }),
    ];
    assert_eq!(events_until(&mut bus, bit(1_000)), expected);
}

#[test]
fn frames_loaded_during_intermission_compete_at_its_end() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    bus.load(bit(51), b, 0, standard(0x300, &[])).unwrap();
    bus.load(bit(53), c, 0, standard(0x200, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    let sent: Vec<_> = events.iter().filter(|it| matches!(it.kind, EventKind::Sent { .. })).collect();
    assert_eq!(sent.iter().map(|it| it.station).collect::<Vec<_>>(), [a, c, b]);
    assert_eq!(sent[1].at, bit(53 + u64::from(standard(0x200, &[]).bit_count())));
}

#[test]
fn among_mailboxes_the_identifier_counts_then_the_number() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), b, 0, standard(0, &[])).unwrap();
    bus.load(bit(10), a, 0, standard(0x300, &[0])).unwrap();
    bus.load(bit(10), a, 1, standard(0x200, &[1])).unwrap();
    bus.load(bit(10), a, 2, standard(0x200, &[2])).unwrap();
    assert_eq!(bus.load(bit(10), a, 2, standard(0, &[])), Err(LoadError::Occupied));
    assert_eq!(bus.load(bit(10), a, 3, standard(0, &[])), Err(LoadError::NoSuchMailbox));
    let events = events_until(&mut bus, bit(1_000));
    let mailboxes: Vec<usize> = events
        .iter()
        .filter(|event| event.station == a)
        .filter_map(|event| if let EventKind::Sent { mailbox } = event.kind { Some(mailbox) } else { None })
        .collect();
    assert_eq!(mailboxes, [1, 2, 0]);
}

#[test]
fn equal_frames_merge() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    let frame = extended(0x1234, &[]);
    let len = u64::from(frame.bit_count());
    bus.load(bit(0), a, 0, frame).unwrap();
    bus.load(bit(0), b, 2, frame).unwrap();
    let expected = [
        event(bit(len - 1), c, EventKind::Received(frame)),
        event(bit(len), a, EventKind::Sent { mailbox: 0 }),
        event(bit(len), b, EventKind::Sent { mailbox: 2 }),
    ];
    assert_eq!(events_until(&mut bus, bit(1_000)), expected);
}

#[test]
fn filtered_frames_are_acknowledged_but_not_reported() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    let id = Id::Standard(StandardId::new(0x123).unwrap());
    bus.set_filters(b, Filters::from_iter([Filter::exactly(id)]));
    bus.load(bit(0), a, 0, standard(0x124, &[])).unwrap();
    bus.load(bit(0), a, 1, standard(0x123, &[])).unwrap();
    bus.load(bit(0), a, 2, remote(id, 0)).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(sent(&events, a), 3);
    assert_eq!(received(&events, b), 1);
}

fn any_frame() -> impl Strategy<Value = WireFrame> {
    // Few identifiers, many of them with the same base, so that RTR, SRR and IDE decide often.
    let id = (0..4_u32, 0..3_u32, any::<bool>()).prop_map(|(base, extension, is_extended)| {
        if is_extended {
            Id::Extended(ExtendedId::new(base << 18 | extension).unwrap())
        } else {
            Id::Standard(StandardId::new(base as u16).unwrap())
        }
    });
    // The length depends on the identifier alone: frames with the same identifier are the same frame.
    (id, any::<bool>()).prop_map(|(id, is_remote)| match is_remote {
        true => WireFrame::new_remote(id, 4).unwrap(),
        false => WireFrame::new(id, &[1]).unwrap(),
    })
}

/// The level at which frames of this kind compete, written down bit by bit.
fn arbitration_field(frame: &WireFrame) -> String {
    let rtr = u8::from(frame.is_remote_frame());
    match frame.id() {
        Id::Standard(id) => format!("{:011b}{rtr}0", id.as_raw()),
        Id::Extended(id) => {
            format!("{:011b}11{:018b}{rtr}", id.as_raw() >> 18, id.as_raw() & 0x3_FFFF)
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn frames_that_wait_are_sent_in_the_order_of_arbitration(
        frames in prop::collection::vec(any_frame(), 1..40),
    ) {
        let (mut bus, [witness]) = bus_of(FaultModel::none());
        let mut in_turn = Vec::new();
        for frame in &frames {
            let station = bus.attach("sender");
            bus.load(bit(0), station, 0, *frame).unwrap();
            in_turn.push(*frame);
        }
        // Equal frames merge into one.
        in_turn.sort_by_key(arbitration_field);
        in_turn.dedup();
        let events = events_until(&mut bus, bit(100_000));
        let seen: Vec<WireFrame> = events
            .iter()
            .filter(|event| event.station == witness)
            .filter_map(|event| if let EventKind::Received(frame) = event.kind { Some(frame) } else { None })
            .collect();
        prop_assert_eq!(seen, in_turn);
    }
}
