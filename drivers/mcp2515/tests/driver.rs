//! The driver against the model of the chip: registers, outcomes, losses.

mod model;

use cosmic_bus::{BitPosition, Fault, FaultModel, Filter, Rule, VirtualInstant, WireFrame};
use cosmic_core::can::filter_banks::{Fifo, FilterBanks, Wanted};
use cosmic_core::can::{BitRate, Controller, Etag, Frame, Id, Mailbox, Outcome, Payload, Priority, TxNode};
use cosmic_core::time::{Duration, Instant};
use cosmic_mcp2515::{Config, Filters, Mcp2515, SetUpError};
use embedded_can::{ExtendedId, Frame as _, StandardId};
use model::{NoDelay, Shared, Spi, World};

const CONFIG: Config = Config { oscillator_hz: 16_000_000, bit_rate: BitRate::MAX, filters: Filters::ALL };

fn chip(world: &Shared, config: &Config) -> Mcp2515<Spi> {
    let spi = model::attach(world, "chip");
    Mcp2515::new(spi, &mut NoDelay, config).unwrap()
}

fn at(microseconds: u64) -> Instant {
    Instant::from_epoch(Duration::from_micros(microseconds))
}

fn run(world: &Shared, microseconds: u64) {
    world.borrow_mut().run(VirtualInstant::from_ticks(microseconds * 1_000));
}

fn frame(priority: u8, etag: u16, bytes: &[u8]) -> Frame {
    let id = Id::new(Priority::new(priority), TxNode::new(5).unwrap(), Etag::new(etag).unwrap());
    Frame::new(id, Payload::new(bytes).unwrap())
}

/// Loads a frame into a mailbox of a bare station of the bus.
fn load_foreign(world: &Shared, station: cosmic_bus::StationId, mailbox: usize, frame: WireFrame) {
    let mut world = world.borrow_mut();
    let now = world.now;
    world.bus.load(now, station, mailbox, frame).unwrap();
}

#[test]
fn set_up_writes_literal_registers() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let wanted = [Wanted::hard(Etag::HARD_FIRST, TxNode::MIN), Wanted::etag(Fifo::Other, Etag::BOUND_FIRST)];
    let filters = Filters::of(&FilterBanks::<6>::plan::<8>(&wanted).unwrap());
    let _chip = chip(&world, &Config { filters, ..CONFIG });
    let world = world.borrow();
    let registers = &world.chips[0].registers;
    assert_eq!(registers[0x28..0x2C], [0x01, 0x91, 0x00, 0x3F], "CNF3, CNF2, CNF1, CANINTE");
    assert_eq!([registers[0x30], registers[0x40], registers[0x50]], [3, 2, 1], "TXP");
    assert_eq!([registers[0x60], registers[0x70]], [0, 0], "filters on, no roll-over");
    assert_eq!(registers[0x00..0x04], [0x00, 0x08, 0x00, 0x64], "RXF0: etag 100 of node 0, extended");
    assert_eq!(registers[0x20..0x28], [0xFF, 0xE3, 0xFF, 0xFF, 0, 0, 0x3F, 0xFF], "RXM0, RXM1");
    assert_eq!(registers[0x08..0x0C], [0x00, 0x08, 0x04, 0x00], "RXF2: etag 1024");
    assert_eq!(registers[0x0E] & 0xE0, 0, "normal mode");
    assert!(world.transactions <= 15, "{}", world.transactions);
}

#[test]
fn what_is_no_chip_is_refused() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let spi = model::attach(&world, "slow");
    let config = Config { oscillator_hz: 8_000_000, ..CONFIG };
    assert_eq!(Mcp2515::new(spi, &mut NoDelay, &config).err(), Some(SetUpError::BitRate));
    struct Silent;
    impl embedded_hal::spi::ErrorType for Silent {
        type Error = std::convert::Infallible;
    }
    impl embedded_hal::spi::SpiDevice for Silent {
        fn transaction(&mut self, _: &mut [embedded_hal::spi::Operation<'_, u8>]) -> Result<(), Self::Error> {
            Ok(())
        }
    }
    assert_eq!(Mcp2515::new(Silent, &mut NoDelay, &CONFIG).err(), Some(SetUpError::NoChip));
}

#[test]
fn frames_of_every_length_arrive_as_they_were_sent() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let (mut sender, mut receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    for len in 0..=8 {
        let now = 1_000 * (len as u64 + 1);
        run(&world, now);
        let sent = frame(250 - len as u8, 5_000 + len as u16, &[1, 2, 3, 4, 5, 6, 7, 8][..len]);
        let mailbox = Mailbox::ALL[len % 3];
        sender.load(mailbox, &sent).unwrap();
        assert_eq!(sender.outcome(at(now)).unwrap(), None);
        run(&world, now + 300);
        assert_eq!(receiver.receive().unwrap(), Some(sent));
        assert_eq!(receiver.receive().unwrap(), None);
        assert_eq!(sender.outcome(at(now + 300)).unwrap(), Some((mailbox, Outcome::Sent)));
        assert_eq!(sender.outcome(at(now + 300)).unwrap(), None);
    }
    let status = receiver.status().unwrap();
    assert_eq!((status.lost, status.foreign, status.is_bus_off), (0, 0, false));
}

#[test]
fn a_pending_frame_is_withdrawn_and_its_buffer_used_again() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let (mut sender, mut receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    run(&world, 100);
    // The hard frame is on the wire, the soft one waits.
    sender.load(Mailbox::Hard, &frame(0, 100, &[1; 8])).unwrap();
    run(&world, 110);
    sender.load(Mailbox::Soft, &frame(9, 5_000, &[2])).unwrap();
    sender.withdraw(Mailbox::Soft, at(120)).unwrap();
    sender.withdraw(Mailbox::NonRealTime, at(120)).unwrap();
    assert_eq!(sender.next_wakeup(), at(120 + 320));
    run(&world, 439);
    assert_eq!(sender.outcome(at(439)).unwrap(), Some((Mailbox::Hard, Outcome::Sent)));
    assert_eq!(sender.outcome(at(439)).unwrap(), None);
    assert_eq!(sender.outcome(at(440)).unwrap(), Some((Mailbox::Soft, Outcome::Withdrawn)));
    assert_eq!(sender.next_wakeup(), Instant::FAR_FUTURE);
    sender.load(Mailbox::Soft, &frame(1, 5_000, &[3])).unwrap();
    assert_eq!(receiver.receive().unwrap(), Some(frame(0, 100, &[1; 8])));
    run(&world, 1_000);
    assert_eq!(receiver.receive().unwrap(), Some(frame(1, 5_000, &[3])));
    assert_eq!(sender.outcome(at(1_000)).unwrap(), Some((Mailbox::Soft, Outcome::Sent)));
}

#[test]
fn a_frame_on_the_wire_is_sent_in_spite_of_its_withdrawal() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let (mut sender, mut receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    run(&world, 100);
    sender.load(Mailbox::Soft, &frame(9, 5_000, &[2; 8])).unwrap();
    run(&world, 150);
    sender.withdraw(Mailbox::Soft, at(150)).unwrap();
    // TXREQ is clear, the frame is still on the wire: nothing is known yet.
    assert_eq!(sender.outcome(at(150)).unwrap(), None);
    run(&world, 400);
    assert_eq!(sender.outcome(at(400)).unwrap(), Some((Mailbox::Soft, Outcome::Sent)));
    assert!(receiver.receive().unwrap().is_some());
}

#[test]
fn a_frame_that_fails_after_its_withdrawal_is_gone() {
    let fault = Fault::Inverted(BitPosition::FromStart(60));
    let faults = FaultModel::none().with_rule(Rule { frames: Filter::ANY, skip: 0, count: 1, fault });
    let world = World::new(BitRate::MAX, faults);
    let (mut sender, mut receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    run(&world, 100);
    sender.load(Mailbox::Hard, &frame(0, 100, &[2; 8])).unwrap();
    run(&world, 150);
    sender.withdraw(Mailbox::Hard, at(150)).unwrap();
    run(&world, 500);
    assert_eq!(sender.outcome(at(500)).unwrap(), Some((Mailbox::Hard, Outcome::Withdrawn)));
    assert_eq!(receiver.receive().unwrap(), None);
}

#[test]
fn an_overrun_is_counted_and_the_older_frame_kept() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let (mut sender, mut receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    for number in 1..=3 {
        run(&world, 1_000 * number);
        sender.load(Mailbox::Soft, &frame(9, 5_000, &[number as u8])).unwrap();
        run(&world, 1_000 * number + 500);
        assert!(sender.outcome(at(1_000 * number + 500)).unwrap().is_some());
        if number == 2 {
            assert_eq!(receiver.status().unwrap().lost, 1);
        }
    }
    assert_eq!(receiver.status().unwrap().lost, 2);
    assert_eq!(receiver.receive().unwrap(), Some(frame(9, 5_000, &[1])));
    assert_eq!(receiver.status().unwrap().lost, 2);
}

#[test]
fn foreign_frames_are_counted_and_long_lengths_are_eight() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let mut receiver = chip(&world, &CONFIG);
    let other = world.borrow_mut().bus.attach("other");
    run(&world, 100);
    load_foreign(&world, other, 0, WireFrame::new_remote(ExtendedId::new(0x123).unwrap(), 3).unwrap());
    run(&world, 400);
    assert_eq!(receiver.receive().unwrap(), None);
    // The filters are for extended frames, so the chip itself drops this one.
    load_foreign(&world, other, 0, WireFrame::new(StandardId::new(0x123).unwrap(), &[1]).unwrap());
    run(&world, 800);
    assert_eq!(receiver.receive().unwrap(), None);
    assert_eq!(receiver.status().unwrap().foreign, 1);
    // A standard frame, should one get through; a data length code of 15.
    let mut borrowed = world.borrow_mut();
    let registers = &mut borrowed.chips[0].registers;
    registers[0x61..0x6E].copy_from_slice(&[0x24, 0x60, 0, 0, 1, 9, 0, 0, 0, 0, 0, 0, 0]);
    registers[0x71..0x7E].copy_from_slice(&[0xFA, 0xEB, 0xC0, 0x04, 15, 1, 2, 3, 4, 5, 6, 7, 8]);
    registers[0x2C] |= 0x03;
    drop(borrowed);
    let id = Id::from_raw(0x1F5F_C004).unwrap();
    let long = Frame::new(id, Payload::full([1, 2, 3, 4, 5, 6, 7, 8]));
    assert_eq!(receiver.receive().unwrap(), Some(long));
    assert_eq!(receiver.status().unwrap().foreign, 2);
}

#[test]
fn a_chip_that_nobody_hears_tells_its_errors_and_bus_off() {
    let fault = Fault::Inverted(BitPosition::FromStart(60));
    let faults = FaultModel::none().with_rule(Rule { frames: Filter::ANY, skip: 0, count: 40, fault });
    let world = World::new(BitRate::MAX, faults);
    let (mut sender, _receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    run(&world, 100);
    sender.load(Mailbox::Soft, &frame(9, 5_000, &[2; 8])).unwrap();
    run(&world, 2_000);
    let status = sender.status().unwrap();
    assert!(status.errors.transmit >= 128 && !status.is_bus_off, "{status:?}");
    run(&world, 3_300);
    assert!(sender.status().unwrap().is_bus_off);
    assert_eq!(sender.outcome(at(3_300)).unwrap(), None, "no outcome before it is sent or withdrawn");
    // After 128 times 11 recessive bits it is back, and repeats the frame until it is sent.
    run(&world, 20_000);
    assert!(!sender.status().unwrap().is_bus_off);
    assert_eq!(sender.outcome(at(20_000)).unwrap(), Some((Mailbox::Soft, Outcome::Sent)));
}

#[test]
fn every_call_keeps_its_bound_of_transactions() {
    let world = World::new(BitRate::MAX, FaultModel::none());
    let (mut sender, mut receiver) = (chip(&world, &CONFIG), chip(&world, &CONFIG));
    run(&world, 100);
    let count = |call: &mut dyn FnMut()| {
        let before = world.borrow().transactions;
        call();
        world.borrow().transactions - before
    };
    assert_eq!(count(&mut || sender.load(Mailbox::Soft, &frame(9, 5_000, &[2; 8])).unwrap()), 2);
    run(&world, 110);
    assert_eq!(count(&mut || sender.withdraw(Mailbox::Soft, at(110)).unwrap()), 1);
    run(&world, 500);
    assert_eq!(count(&mut || assert!(sender.outcome(at(500)).unwrap().is_some())), 2);
    assert_eq!(count(&mut || assert_eq!(sender.outcome(at(500)).unwrap(), None)), 0);
    world.borrow_mut().chips[1].registers[0x2C] |= 3;
    world.borrow_mut().chips[1].registers[0x62] = 0;
    assert_eq!(count(&mut || assert!(receiver.receive().is_ok())), 3);
    world.borrow_mut().chips[1].registers[0x2D] |= 0x80;
    assert_eq!(count(&mut || assert_eq!(receiver.status().unwrap().lost, 1)), 4);
}
