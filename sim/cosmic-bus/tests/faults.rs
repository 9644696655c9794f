//! Faults of every kind, and fault confinement.

mod common;

use common::{bit, bus_of, event, events_until, extended, failed, received, sent, standard};
use cosmic_bus::trace::{BusError, Origin, TraceEvent, TraceKind};
use cosmic_bus::{
    BitPosition, Bus, BusOffRecovery, Chance, ErrorCause, ErrorLevel, Event, EventKind, Fault, FaultModel,
    Field, Filter, Rule, StationId, TrafficClass, Transmitter, Victims,
};
use embedded_can::StandardId;

fn rule(skip: u32, count: u32, fault: Fault) -> FaultModel {
    FaultModel::none().with_rule(Rule { frames: Filter::ANY, skip, count, fault })
}

fn inverted(bit: u32) -> Fault {
    Fault::Inverted(BitPosition::FromStart(bit))
}

fn omission(victims: &[StationId], transmitter: Transmitter) -> Fault {
    Fault::InconsistentOmission { victims: Victims::These(victims.to_vec()), transmitter }
}

fn errors(bus: &mut Bus) -> Vec<BusError> {
    let mut trace: Vec<TraceEvent> = Vec::new();
    bus.take_trace(&mut trace);
    let errors = trace.into_iter();
    errors.filter_map(|it| if let TraceKind::Error(error) = it.kind { Some(error) } else { None }).collect()
}

fn counters(bus: &Bus, station: StationId) -> (u16, u16) {
    let state = bus.error_state(station);
    (state.transmit_errors, state.receive_errors)
}

/// Sends the frame of zeros, 50 bits, with the fault at its first attempt.
fn zeros_with(fault: Fault) -> (Bus, [StationId; 3], Vec<Event>) {
    let (mut bus, stations) = bus_of(rule(0, 1, fault));
    bus.record_trace(true);
    bus.load(bit(0), stations[0], 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    (bus, stations, events)
}

#[test]
fn an_inverted_bit_is_an_error_frame_and_a_retransmission() {
    // Bit 1 is the second of five dominant ones; inverted it is recessive. The sender's flag begins in bit
    // 2; the receivers see six equal bits in bit 7, so their flags end with bit 13. Delimiter, intermission.
    let (mut bus, [a, b, c], events) = zeros_with(inverted(1));
    let again = 14 + 8 + 3;
    let expected = [
        event(bit(22), a, EventKind::Failed { mailbox: 0, cause: ErrorCause::Bit }),
        event(bit(again + 49), b, EventKind::Received(standard(0, &[]))),
        event(bit(again + 49), c, EventKind::Received(standard(0, &[]))),
        event(bit(again + 50), a, EventKind::Sent { mailbox: 0 }),
    ];
    assert_eq!(events, expected);
    // Eight up for the failure, one down for the success; the receivers one up, one down.
    assert_eq!((counters(&bus, a), counters(&bus, b), counters(&bus, c)), ((7, 0), (0, 0), (0, 0)));
    let error = BusError {
        number: 0,
        station: a,
        bit: 1,
        field: Field::Arbitration,
        cause: ErrorCause::Bit,
        origin: Origin::Fault,
    };
    assert_eq!(errors(&mut bus), [error]);
    let accounting = bus.accounting();
    assert_eq!((accounting.inverted(), accounting.failed_attempts()), (1, 1));
    assert_eq!((accounting.error_bits(), accounting.bits(TrafficClass::Foreign)), (25, 53));
    assert_eq!(accounting.omission_degrees(), [0, 1]);
}

#[test]
fn a_stuff_bit_lost_in_arbitration_is_not_counted_by_the_sender() {
    let (mut bus, [a, b, _], events) = zeros_with(inverted(5));
    assert_eq!(errors(&mut bus)[0].cause, ErrorCause::Stuff);
    assert_eq!(events[0].at, bit(6 + 6 + 8), "all see it at once: one flag long");
    assert_eq!((counters(&bus, a), counters(&bus, b)), ((0, 0), (0, 0)));
    assert_eq!(received(&events, b), 1);
}

#[test]
fn a_recessive_bit_lost_in_arbitration_silences_the_sender() {
    let (mut bus, [a, b]) = bus_of(rule(0, 1, inverted(11)));
    bus.record_trace(true);
    bus.load(bit(0), a, 0, standard(0x7FB, &[])).unwrap();
    // 0 11111(0)11101... : bit 11 is a recessive one of the identifier. The bus stays recessive behind it, and
    // the sixth such bit is an error to all.
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(standard(0x7FB, &[]).wire_bits().to_string()[..13], *"0111110111011");
    let error = errors(&mut bus)[0];
    assert_eq!((error.bit, error.cause), (17, ErrorCause::Stuff));
    assert_eq!(events[0], event(bit(32), a, EventKind::Failed { mailbox: 0, cause: ErrorCause::Stuff }));
    assert_eq!(counters(&bus, a), (0, 1), "it took itself for a receiver");
    assert_eq!((sent(&events, a), received(&events, b)), (1, 1));
}

#[test]
fn errors_in_the_tail_are_seen_by_all_at_once() {
    for position in [40, 42, 43, 48] {
        let (mut bus, [a, b, _], events) = zeros_with(inverted(position));
        let over = u64::from(position) + 1 + 6 + 8;
        assert_eq!(events[0].at, bit(over), "bit {position}");
        assert_eq!((failed(&events, a), sent(&events, a), received(&events, b)), (1, 1, 1));
        assert_eq!(errors(&mut bus)[0].cause, ErrorCause::Bit);
    }
    let (mut bus, [a, b, _], events) = zeros_with(inverted(41));
    assert_eq!(errors(&mut bus)[0].cause, ErrorCause::Acknowledgement);
    assert_eq!((failed(&events, a), received(&events, b)), (1, 1));
}

#[test]
fn an_error_in_the_last_bit_makes_duplicates_everywhere() {
    let (bus, [a, b, c], events) = zeros_with(Fault::Inverted(BitPosition::FromEnd(0)));
    assert_eq!((received(&events, b), received(&events, c)), (2, 2));
    assert_eq!((failed(&events, a), sent(&events, a)), (1, 1));
    assert_eq!(counters(&bus, b), (0, 0), "an overload to them, no error");
}

#[test]
fn an_inconsistent_omission_makes_duplicates_for_who_had_accepted() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    bus.faults_mut().add_rule(Rule {
        frames: Filter::ANY,
        skip: 0,
        count: 1,
        fault: omission(&[b], Transmitter::Retransmits),
    });
    let frame = standard(0, &[]);
    bus.load(bit(0), a, 0, frame).unwrap();
    // Flags from bit 49 to bit 55, delimiter, intermission.
    let again = 50 + 6 + 8 + 3;
    let expected = [
        event(bit(49), c, EventKind::Received(frame)),
        event(bit(64), a, EventKind::Failed { mailbox: 0, cause: ErrorCause::Form }),
        event(bit(again + 49), b, EventKind::Received(frame)),
        event(bit(again + 49), c, EventKind::Received(frame)),
        event(bit(again + 50), a, EventKind::Sent { mailbox: 0 }),
    ];
    assert_eq!(events_until(&mut bus, bit(1_000)), expected);
    assert_eq!(counters(&bus, b), (0, 8), "one and eight up, one down");
    assert_eq!(bus.accounting().omitted(), 1);
}

#[test]
fn an_omission_that_the_transmitter_does_not_see_is_final() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    let fault = omission(&[b], Transmitter::Accepts);
    bus.faults_mut().add_rule(Rule { frames: Filter::ANY, skip: 0, count: 1, fault });
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    bus.load(bit(0), a, 1, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((sent(&events, a), failed(&events, a)), (2, 0));
    assert_eq!((received(&events, b), received(&events, c)), (1, 2));
    // Overload flags delay the second frame: to bit 56, delimiter, intermission.
    assert_eq!(events.last().unwrap().at, bit(57 + 8 + 3 + 50));
}

#[test]
fn a_transmitter_that_crashes_after_an_omission_leaves_some_without_the_frame() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    let fault = omission(&[b], Transmitter::Retransmits);
    bus.faults_mut().add_rule(Rule { frames: Filter::ANY, skip: 0, count: 1, fault });
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    let mut events = events_until(&mut bus, bit(60));
    bus.disconnect(bit(60), a);
    events.extend(events_until(&mut bus, bit(1_000)));
    assert_eq!((received(&events, b), received(&events, c), sent(&events, a)), (0, 1, 0));
}

#[test]
fn the_flags_of_an_error_passive_victim_disturb_nobody() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    // Nine for each omission: passive after fifteen.
    let fault = omission(&[b], Transmitter::Retransmits);
    bus.faults_mut().add_rule(Rule { frames: Filter::ANY, skip: 0, count: 16, fault: fault.clone() });
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(5_000));
    assert_eq!((failed(&events, a), sent(&events, a)), (15, 1), "the sixteenth found it passive");
    assert_eq!(bus.error_state(b).level(), ErrorLevel::Passive);
    assert_eq!((received(&events, b), received(&events, c)), (0, 16));
}

#[test]
fn rules_hit_the_frames_they_name() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    let id = StandardId::new(0x200).unwrap();
    let frames = Filter::exactly(id.into());
    bus.faults_mut().add_rule(Rule { frames, skip: 1, count: 2, fault: inverted(15) });
    bus.load(bit(0), a, 0, standard(0x100, &[])).unwrap();
    bus.load(bit(0), a, 1, standard(0x200, &[])).unwrap();
    bus.load(bit(0), a, 2, standard(0x201, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((failed(&events, a), received(&events, b)), (0, 3), "one passes first");
    bus.load(bit(1_000), a, 1, standard(0x200, &[])).unwrap();
    let events = events_until(&mut bus, bit(2_000));
    assert_eq!((failed(&events, a), received(&events, b)), (2, 1));
    assert_eq!(bus.accounting().omission_degrees(), [3, 0, 1]);
}

#[test]
fn a_lone_station_becomes_passive_but_not_bus_off() {
    let (mut bus, [a]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(20_000));
    assert_eq!(
        events[0],
        event(bit(42 + 6 + 8), a, EventKind::Failed { mailbox: 0, cause: ErrorCause::Acknowledgement },)
    );
    assert!(failed(&events, a) > 200);
    assert_eq!(counters(&bus, a), (128, 0));
    assert_eq!(bus.error_state(a).level(), ErrorLevel::Passive);
    // A passive transmitter pauses: 56 bits of failed frame, intermission, suspension.
    let last: Vec<_> = events.iter().rev().take(2).collect();
    assert_eq!(last[0].at.checked_duration_since(last[1].at).unwrap().as_micros(), 56 + 3 + 8);
    // A second station ends it.
    let b = bus.attach("late");
    let events = events_until(&mut bus, bit(21_000));
    assert_eq!((sent(&events, a), received(&events, b)), (1, 1));
    assert_eq!(counters(&bus, a), (127, 0));
}

#[test]
fn different_frames_with_one_identifier_collide() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    bus.record_trace(true);
    bus.load(bit(0), a, 0, standard(0x2AA, &[])).unwrap();
    bus.load(bit(0), b, 0, standard(0x2AA, &[0])).unwrap();
    let events = events_until(&mut bus, bit(60));
    // SOF and identifier are bits 0 to 11, RTR, IDE, r0 and the first bit of the length code 12 to 15. That is
    // the fifth dominant bit in a row, so 16 is a stuff bit. The length codes 0000 and 0001 differ in bit 19.
    let error = errors(&mut bus)[0];
    assert_eq!((error.bit, error.origin, error.cause), (19, Origin::Collision, ErrorCause::Bit));
    assert_eq!((failed(&events, a), failed(&events, b), received(&events, c)), (1, 1, 0));
    assert_eq!((counters(&bus, a), counters(&bus, b), counters(&bus, c)), ((8, 0), (8, 0), (0, 1)));
}

#[test]
fn colliding_stations_fail_until_one_is_passive_and_gives_way() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0x2AA, &[0])).unwrap();
    bus.load(bit(0), b, 0, standard(0x2AA, &[1])).unwrap();
    let events = events_until(&mut bus, bit(10_000));
    // Sixteen collisions make both passive. The last bit of data then overrules station b in silence; after
    // that b sends alone.
    assert_eq!((failed(&events, a), sent(&events, a)), (16, 1));
    assert_eq!((failed(&events, b), sent(&events, b)), (17, 1));
    let seen: Vec<_> = events
        .iter()
        .filter(|event| event.station == c && matches!(event.kind, EventKind::Received(_)))
        .map(|event| event.kind)
        .collect();
    let expected = [standard(0x2AA, &[0]), standard(0x2AA, &[1])].map(EventKind::Received);
    assert_eq!(seen, expected);
}

/// Every attempt of `a` fails until it is bus-off.
fn drive_bus_off(recovery: BusOffRecovery) -> (Bus, [StationId; 2], Vec<Event>) {
    let (mut bus, [a, b]) = bus_of(rule(0, 32, inverted(15)));
    bus.set_bus_off_recovery(a, recovery);
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    let mut events = Vec::new();
    while bus.error_state(a).level() != ErrorLevel::BusOff {
        let next = bus.next_event().unwrap();
        bus.advance(next, &mut events);
    }
    (bus, [a, b], events)
}

fn levels(events: &[Event], station: StationId) -> Vec<ErrorLevel> {
    let levels = events.iter().filter(|event| event.station == station);
    levels
        .filter_map(|it| if let EventKind::ErrorState(state) = it.kind { Some(state.level()) } else { None })
        .collect()
}

#[test]
fn thirty_two_failures_are_bus_off() {
    let (bus, [a, b], events) = drive_bus_off(BusOffRecovery::Automatic);
    assert_eq!(failed(&events, a), 32);
    assert_eq!(levels(&events, a), [ErrorLevel::Warning, ErrorLevel::Passive, ErrorLevel::BusOff]);
    assert_eq!(counters(&bus, a), (256, 0));
    assert_eq!(counters(&bus, b), (0, 32));
}

#[test]
fn bus_off_ends_by_itself_after_128_times_11_recessive_bits() {
    let (mut bus, [a, b], events) = drive_bus_off(BusOffRecovery::Automatic);
    let off = events.last().unwrap().at;
    // Delimiter (already over) and intermission are the first sequence.
    let bits = |count| bus.bit_rate().bits(count);
    let (back, accepted) = (off + bits(3 + 127 * 11), off + bits(3 + 127 * 11 + 49));
    assert_eq!(bus.next_event(), Some(back));
    let events = events_until(&mut bus, bit(100_000));
    assert_eq!(events[0].at, back);
    assert_eq!(levels(&events, a), [ErrorLevel::Active]);
    assert_eq!(events[1], event(accepted, b, EventKind::Received(standard(0, &[]))));
    assert_eq!(counters(&bus, a), (0, 0));
}

#[test]
fn each_frame_of_others_is_one_sequence_of_recovery() {
    let (mut bus, [a, b], _) = drive_bus_off(BusOffRecovery::Automatic);
    let c = bus.attach("another");
    let mut frames = 0;
    let mut events = Vec::new();
    // The bus is busy without a pause. The intermission behind the last error frame was the first sequence.
    bus.load(bus.now(), b, 0, standard(1, &[])).unwrap();
    while bus.error_state(a).level() == ErrorLevel::BusOff {
        let next = bus.next_event().unwrap();
        bus.advance(next, &mut events);
        for event in events.drain(..) {
            if matches!(event.kind, EventKind::Sent { .. }) && event.station == b {
                frames += 1;
                bus.load(event.at, b, 0, standard(1, &[])).unwrap();
            }
        }
    }
    assert_eq!(frames, 127);
    assert_eq!(bus.error_state(c).level(), ErrorLevel::Active);
}

#[test]
fn bus_off_lasts_until_recovery_is_requested() {
    let (mut bus, [a, b], _) = drive_bus_off(BusOffRecovery::OnRequest);
    assert_eq!(bus.next_event(), None);
    bus.load(bit(10_000), b, 0, standard(5, &[])).unwrap();
    let events = events_until(&mut bus, bit(20_000));
    assert_eq!((received(&events, a), failed(&events, b) > 100), (0, true), "it does not acknowledge");
    bus.withdraw(bit(20_000), b, 0);
    events_until(&mut bus, bit(21_000));
    bus.request_recovery(bit(21_000), a);
    bus.request_recovery(bit(21_000), b);
    let events = events_until(&mut bus, bit(30_000));
    assert_eq!(events[0].at, bit(21_000 + 128 * 11));
    assert_eq!((sent(&events, a), received(&events, b)), (1, 1));
}

#[test]
fn a_sender_that_is_lost_is_an_error_to_the_receivers() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    bus.record_trace(true);
    bus.load(bit(0), a, 0, extended(0x1234_5678, &[0; 8])).unwrap();
    bus.disconnect(bit(60), a);
    bus.load(bit(70), b, 0, standard(0, &[])).unwrap();
    let events = events_until(&mut bus, bit(1_000));
    let error = errors(&mut bus)[0];
    assert_eq!((error.origin, error.cause), (Origin::SenderLost, ErrorCause::Stuff));
    assert!((60..=65).contains(&error.bit), "{}", error.bit);
    let resumed = u64::from(error.bit) + 1 + 6 + 8 + 3;
    assert_eq!(events[0], event(bit(resumed + 49), c, EventKind::Received(standard(0, &[]))));
    assert_eq!((sent(&events, a), failed(&events, a)), (0, 0));
    // It tries again once it is back and has seen 11 recessive bits.
    bus.connect(bit(1_000), a);
    let events = events_until(&mut bus, bit(2_000));
    let len = u64::from(extended(0x1234_5678, &[0; 8]).bit_count());
    assert_eq!(events[0].at, bit(1_000 + 11 + len - 1));
    assert_eq!((sent(&events, a), received(&events, b), received(&events, c)), (1, 1, 1));
}

#[test]
fn a_sender_that_is_lost_in_the_tail_is_not_missed() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    bus.disconnect(bit(41), a);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!(events, [event(bit(49), b, EventKind::Received(standard(0, &[])))]);
}

#[test]
fn the_last_receiver_to_leave_takes_the_acknowledgement_with_it() {
    let (mut bus, [a, b]) = bus_of(FaultModel::none());
    bus.load(bit(0), a, 0, standard(0, &[])).unwrap();
    bus.disconnect(bit(30), b);
    let events = events_until(&mut bus, bit(60));
    let cause = ErrorCause::Acknowledgement;
    assert_eq!(events, [event(bit(42 + 6 + 8), a, EventKind::Failed { mailbox: 0, cause })]);
    // Back within the next attempt, it cannot follow that one, but the one after.
    bus.connect(bit(60), b);
    let events = events_until(&mut bus, bit(1_000));
    assert_eq!((failed(&events, a), sent(&events, a), received(&events, b)), (1, 1, 1));
}

#[test]
fn chances_are_kept() {
    let chance = |p| Chance::new(p).unwrap();
    assert_eq!(Chance::new(1.1), None);
    assert_eq!(Chance::new(-0.1), None);
    assert_eq!(Chance::new(f64::NAN), None);
    let run = |seed| {
        let faults = FaultModel::seeded(seed).with_inversion(chance(0.1)).with_omission(chance(0.05));
        let (mut bus, [a, _, _]) = bus_of::<3>(faults);
        let mut events = Vec::new();
        for _ in 0..5_000 {
            bus.load(bus.now(), a, 0, standard(0x123, &[1, 2, 3])).unwrap();
            while sent(&events, a) == 0 {
                events.clear();
                let next = bus.next_event().unwrap();
                bus.advance(next, &mut events);
            }
            events.clear();
        }
        bus.accounting().clone()
    };
    let accounting = run(7);
    let attempts = 5_000 + accounting.failed_attempts();
    // Three standard deviations.
    let near = |count: u64, expected: f64| {
        let deviation = (attempts as f64 * expected * (1.0 - expected)).sqrt();
        (count as f64 - attempts as f64 * expected).abs() < 3.0 * deviation
    };
    assert!(near(accounting.inverted(), 0.1), "{} of {attempts}", accounting.inverted());
    assert!(near(accounting.omitted(), 0.9 * 0.05), "{} of {attempts}", accounting.omitted());
    assert_eq!(accounting.omission_degrees().iter().sum::<u64>(), 5_000);
    assert_eq!(accounting, run(7));
    assert_ne!(accounting, run(8));
}

#[test]
fn certain_destruction_lets_nothing_through() {
    let (mut bus, [a, b]) = bus_of(FaultModel::seeded(3).with_inversion(Chance::ALWAYS));
    bus.load(bit(0), a, 0, extended(0x55, &[1, 2])).unwrap();
    let events = events_until(&mut bus, bit(2_000));
    // Bits of the end of frame may let receivers accept, never the transmitter.
    assert_eq!(sent(&events, a), 0);
    assert!(failed(&events, a) > 10);
    assert!(received(&events, b) < failed(&events, a));
}
