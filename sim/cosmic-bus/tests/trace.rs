//! The trace and its candump log, literally; what the bus was busy with.

mod common;

use common::{bit, bus_of, events_until, extended, remote, standard};
use cosmic_bus::trace::{BusError, Candump, Origin, TraceEvent, TraceKind};
use cosmic_bus::{
    BitPosition, ErrorCause, ErrorState, Fault, FaultModel, Field, Filter, Rule, TrafficClass, Transmitter,
    Victims, WireFrame,
};
use cosmic_core::can::{Etag, Frame, Id, Payload, Priority, TxNode};
use embedded_can::StandardId;

const LONG: [u8; 8] = [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88];

fn traced(events: &[TraceEvent]) -> String {
    let mut candump = Candump::new(Vec::new());
    events.iter().for_each(|event| candump.write(event).unwrap());
    String::from_utf8(candump.into_inner()).unwrap()
}

#[test]
fn everything_is_recorded_in_the_order_of_time() {
    let fault = Fault::Inverted(BitPosition::FromStart(1));
    let faults = FaultModel::none().with_rule(Rule { frames: Filter::ANY, skip: 0, count: 1, fault });
    let (mut bus, [a, b]) = bus_of(faults);
    bus.record_trace(true);
    let (frame, other) = (standard(0, &[]), standard(1, &[]));
    bus.load(bit(0), a, 2, frame).unwrap();
    bus.load(bit(0), b, 0, other).unwrap();
    bus.withdraw(bit(5), b, 0);
    bus.withdraw(bit(30), a, 2);
    bus.disconnect(bit(80), b);
    events_until(&mut bus, bit(100));
    let mut trace = Vec::new();
    bus.take_trace(&mut trace);
    let start = |attempt, contenders| TraceKind::FrameStart {
        number: u64::from(attempt) - 1,
        station: a,
        mailbox: 2,
        frame,
        attempt,
        contenders,
    };
    let error = BusError {
        number: 0,
        station: a,
        bit: 1,
        field: Field::Arbitration,
        cause: ErrorCause::Bit,
        origin: Origin::Fault,
    };
    let expected = [
        (0, TraceKind::Load { station: a, mailbox: 2, frame }),
        (0, TraceKind::Load { station: b, mailbox: 0, frame: other }),
        (0, start(1, 2)),
        (2, TraceKind::Error(error)),
        (5, TraceKind::Withdraw { station: b, mailbox: 0, on_the_wire: false }),
        (25, start(2, 1)),
        (30, TraceKind::Withdraw { station: a, mailbox: 2, on_the_wire: true }),
        (75, TraceKind::FrameEnd { number: 1, station: a, frame, bits: 50 }),
        (80, TraceKind::Connection { station: b, connected: false }),
    ];
    assert_eq!(trace, expected.map(|(at, kind)| TraceEvent { at: bit(at), kind }));
    trace.clear();
    bus.take_trace(&mut trace);
    assert_eq!(trace, [], "what was taken is not recorded again");
}

#[test]
fn the_log_is_that_of_candump() {
    let (mut bus, [a, b, c]) = bus_of(FaultModel::none());
    bus.record_trace(true);
    let omission = Fault::InconsistentOmission {
        victims: Victims::These(vec![c]),
        transmitter: Transmitter::Retransmits,
    };
    let id = StandardId::new(0x0A).unwrap();
    let frames = Filter::exactly(id.into());
    bus.faults_mut().add_rule(Rule { frames, skip: 0, count: 1, fault: omission });
    bus.load(bit(1_000_000), a, 0, standard(0x0A, &[0xFF, 0x01])).unwrap();
    bus.load(bit(1_000_000), a, 1, extended(0x1F33_4455, &LONG)).unwrap();
    bus.load(bit(1_000_000), b, 0, remote(StandardId::new(0x123).unwrap(), 4)).unwrap();
    events_until(&mut bus, bit(1_001_000));
    let mut trace = Vec::new();
    bus.take_trace(&mut trace);
    let bits = |frame: WireFrame| u64::from(frame.bit_count());
    let first = bits(standard(0x0A, &[0xFF, 0x01]));
    let again = first + 14 + 3 + first;
    let then = again + 3 + bits(remote(StandardId::new(0x123).unwrap(), 4));
    let last = then + 3 + bits(extended(0x1F33_4455, &LONG));
    let expected = format!(
        "(1.{first:06}) can0 20000008#0000021A00000000\n\
         (1.{again:06}) can0 00A#FF01\n\
         (1.{then:06}) can0 123#R4\n\
         (1.{last:06}) can0 1F334455#1122334455667788\n",
    );
    assert_eq!(traced(&trace), expected);
}

#[test]
fn bus_off_is_logged_as_linux_reports_it() {
    let (mut bus, [a]) = bus_of(FaultModel::none());
    let state = ErrorState { transmit_errors: 256, receive_errors: 0 };
    let event = TraceEvent { at: bit(12_345_678), kind: TraceKind::ErrorState { station: a, state } };
    assert_eq!(traced(&[event]), "(12.345678) can0 20000040#0000000000000000\n");
    let mut trace = Vec::new();
    bus.take_trace(&mut trace);
    assert_eq!(trace, [], "nothing is recorded unless it is switched on");
}

#[test]
fn bits_are_accounted_to_the_class_of_their_frame() {
    let (mut bus, [a, _]) = bus_of::<2>(FaultModel::none());
    let cosmic = |priority| {
        let id = Id::new(priority, TxNode::MIN, Etag::HARD_FIRST);
        Frame::new(id, Payload::full([0xA5; 8])).into()
    };
    let frames = [
        (TrafficClass::Hard, cosmic(Priority::HARD)),
        (TrafficClass::Soft, cosmic(Priority::SOFT_MOST_URGENT)),
        (TrafficClass::Soft, cosmic(Priority::SOFT_LEAST_URGENT)),
        (TrafficClass::NonRealTime, cosmic(Priority::CONFIGURATION)),
        (TrafficClass::NonRealTime, cosmic(Priority::LEAST)),
        (TrafficClass::Foreign, standard(0x7, &[1])),
    ];
    let mut expected = [0_u64; 4];
    for (class, frame) in frames {
        bus.load(bus.now(), a, 0, frame).unwrap();
        let end = bus.now() + bus.bit_rate().bits(200);
        events_until(&mut bus, end);
        expected[class as usize] += u64::from(frame.bit_count()) + 3;
    }
    let accounting = bus.accounting();
    assert_eq!(TrafficClass::ALL.map(|class| accounting.bits(class)), expected);
    assert_eq!(TrafficClass::ALL.map(|class| accounting.frames(class)), [1, 2, 2, 1]);
    assert_eq!(accounting.busy_bits(), expected.iter().sum::<u64>());
    assert_eq!((accounting.error_bits(), accounting.omission_degrees()), (0, &[6][..]));
}
