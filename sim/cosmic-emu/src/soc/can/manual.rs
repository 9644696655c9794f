//! The controller against a second, small model of it that is written from the words of RM0090 (CAN_MSR,
//! CAN_TSR, CAN_RFxR, CAN_IER, CAN_ESR): random sequences of what the software writes and the bus does.

use cosmic_bus::{ErrorState, WireFrame};
use embedded_can::{ExtendedId, Frame as _};

use super::random::Random;
use super::{BxCan, Command, Outcome};

/// What the manual says, in the shape of its figures: three slots in a ring, one flag for each bit.
#[derive(Debug, Default)]
struct Manual {
    ring: [u32; 3],
    first: usize,
    pending: usize,
    full: bool,
    overrun: bool,
    ier: u32,
    errors: (u16, u16),
    erri: bool,
    mailboxes: [Mailbox; 3],
}

#[derive(Clone, Copy, Debug, Default)]
struct Mailbox {
    id: u32,
    is_requested: bool,
    abort: bool,
    completed: bool,
    ok: bool,
    error: bool,
}

impl Manual {
    /// "Once the FIFO is in pending_3 state the next valid message reception will lead to an overrun": with
    /// RFLM = 0 the last message stored is overwritten.
    fn receive(&mut self, id: u32) {
        if self.pending == 3 {
            self.overrun = true;
            self.ring[(self.first + 2) % 3] = id;
            return;
        }
        self.ring[(self.first + self.pending) % 3] = id;
        self.pending += 1;
        if self.pending == 3 {
            self.full = true;
        }
    }

    fn write_rfr(&mut self, value: u32) {
        self.full &= value & 1 << 3 == 0;
        self.overrun &= value & 1 << 4 == 0;
        if value & 1 << 5 != 0 && self.pending > 0 {
            self.first = (self.first + 1) % 3;
            self.pending -= 1;
        }
    }

    fn rfr(&self) -> u32 {
        self.pending as u32 | u32::from(self.full) << 3 | u32::from(self.overrun) << 4
    }

    /// EWGF, EPVF, BOFF: limits of 96, above 127, above 255.
    fn flags((transmit, receive): (u16, u16)) -> u32 {
        let either = |limit: u16| transmit >= limit || receive >= limit;
        u32::from(either(96)) | u32::from(either(128)) << 1 | u32::from(transmit > 255) << 2
    }

    /// "ERRI is set by hardware when a bit of the CAN_ESR has been set on error detection and the
    /// corresponding interrupt in the CAN_IER is enabled."
    fn count_errors(&mut self, errors: (u16, u16)) {
        let set = Self::flags(errors) & !Self::flags(self.errors);
        self.errors = errors;
        self.erri |= (0..3).any(|bit| set >> bit & 1 == 1 && self.ier >> (8 + bit) & 1 == 1);
    }

    fn esr(&self) -> u32 {
        u32::from(self.errors.1) << 24 | u32::from(self.errors.0 as u8) << 16 | Self::flags(self.errors)
    }

    fn request(&mut self, n: usize, id: u32) {
        if !self.mailboxes[n].is_requested {
            self.mailboxes[n] = Mailbox { id, is_requested: true, ..Mailbox::default() };
        }
    }

    /// "Clearing RQCP clears all the status bits"; ABRQ "has no effect when the mailbox is not pending".
    fn write_tsr(&mut self, value: u32) {
        for (n, mailbox) in self.mailboxes.iter_mut().enumerate() {
            let bits = value >> (8 * n);
            let all = bits & 1 != 0;
            mailbox.completed &= !all;
            mailbox.ok &= !all && bits & 2 == 0;
            mailbox.error &= !all && bits & 8 == 0;
            mailbox.abort |= bits & 0x80 != 0 && mailbox.is_requested;
        }
    }

    fn complete(&mut self, n: usize, outcome: Outcome) {
        let mailbox = &mut self.mailboxes[n];
        if outcome == Outcome::Failed {
            mailbox.error = true;
            return;
        }
        let is_sent = outcome == Outcome::Sent;
        let error = mailbox.error && !is_sent;
        *mailbox = Mailbox { id: mailbox.id, completed: true, ok: is_sent, error, ..Mailbox::default() };
    }

    fn tsr(&self) -> u32 {
        let mut tsr = 0;
        for (n, it) in self.mailboxes.iter().enumerate() {
            let flags = [(0, it.completed), (1, it.ok), (3, it.error), (7, it.abort)];
            tsr |= flags.iter().fold(0, |bits, (bit, is_set)| bits | u32::from(*is_set) << bit) << (8 * n);
            tsr |= u32::from(!it.is_requested) << (26 + n);
        }
        let pending: Vec<_> = (0..3).filter(|&n| self.mailboxes[n].is_requested).collect();
        // The lowest priority: the largest identifier, and of equal ones the largest number.
        let lowest = pending.iter().copied().max_by_key(|&n| (self.mailboxes[n].id, n));
        if let Some(lowest) = lowest
            && pending.len() > 1
        {
            tsr |= 1 << (29 + lowest);
        }
        let free = (0..3).find(|n| !pending.contains(n));
        tsr | (free.or(lowest).unwrap_or(0) as u32) << 24
    }

    /// TX, RX0, RX1, SCE.
    fn interrupts(&self) -> [bool; 4] {
        let enabled = |bit: u32| self.ier >> bit & 1 == 1;
        let tx = enabled(0) && self.mailboxes.iter().any(|it| it.completed);
        let rx = enabled(1) && self.pending > 0 || enabled(2) && self.full || enabled(3) && self.overrun;
        [tx, rx, false, enabled(15) && self.erri]
    }
}

fn extended(id: u32) -> WireFrame {
    WireFrame::new(ExtendedId::new(id).unwrap(), &[]).unwrap()
}

/// In normal mode, all frames to FIFO 0.
fn normal() -> BxCan {
    let mut can = BxCan::new();
    for (offset, value) in [(0x00, 1), (0x1C, 2 | 9 << 16 | 2 << 20), (0x20C, 1), (0x21C, 1), (0x200, 0x0E00)]
    {
        can.write(0, offset, value).unwrap();
    }
    can.write(0, 0x00, 0).unwrap();
    can.advance(u64::MAX);
    can.take_commands();
    can
}

/// One thing that software or bus does, to both.
fn step(can: &mut BxCan, manual: &mut Manual, random: &mut Random) -> String {
    let n = random.below(3) as usize;
    match random.below(10) {
        0..3 => {
            let id = random.below(1 << 29);
            can.receive(0, &extended(id));
            manual.receive(id);
            format!("receive {id:08X}")
        }
        3 | 4 => {
            let value = random.below(64);
            can.write(0, 0x0C, value).unwrap();
            manual.write_rfr(value);
            format!("RF0R = {value:02X}")
        }
        5 => {
            let value = (random.below(1 << 15) | random.below(2) << 15) & 0x870F;
            can.write(0, 0x14, value).unwrap();
            manual.ier = value;
            format!("IER = {value:05X}")
        }
        6 => {
            let pick = |random: &mut Random| [0, 95, 96, 127, 128, 255][random.below(6) as usize];
            let errors = (pick(random) + random.below(2) as u16, pick(random));
            can.set_errors(ErrorState { transmit_errors: errors.0, receive_errors: errors.1 });
            manual.count_errors(errors);
            format!("errors {errors:?}")
        }
        7 => {
            can.write(0, 0x04, 1 << 2).unwrap();
            manual.erri = false;
            "MSR = ERRI".to_owned()
        }
        8 => {
            let id = random.below(4);
            can.write(0, 0x180 + 0x10 * n as u32, id << 3 | 0b101).unwrap();
            manual.request(n, id);
            format!("request {id} in {n}")
        }
        _ => transmit(can, manual, random, n),
    }
}

/// A write to TSR, or what becomes of a pending frame.
fn transmit(can: &mut BxCan, manual: &mut Manual, random: &mut Random, n: usize) -> String {
    if !manual.mailboxes[n].is_requested || random.below(2) == 0 {
        let value = (random.below(256) & 0x8F) << (8 * n);
        can.write(0, 0x08, value).unwrap();
        manual.write_tsr(value);
        let asks = can.take_commands().iter().any(|(_, it)| *it == Command::Withdraw { mailbox: n });
        let pending = value >> (8 * n) & 0x80 != 0 && manual.mailboxes[n].is_requested;
        assert_eq!(asks, pending, "a withdrawal goes to the bus if there is something to withdraw");
        return format!("TSR = {value:06X}");
    }
    let outcome = match random.below(3) {
        0 => Outcome::Sent,
        1 => Outcome::Failed,
        _ if manual.mailboxes[n].abort => Outcome::Withdrawn,
        _ => Outcome::Sent,
    };
    can.complete(0, n, outcome);
    manual.complete(n, outcome);
    format!("{n} {outcome:?}")
}

#[test]
fn two_hundred_random_sequences_are_those_of_the_manual() {
    for seed in 0..200 {
        let (mut can, mut manual, mut random) = (normal(), Manual::default(), Random(seed));
        let mut done = Vec::new();
        for _ in 0..200 {
            done.push(step(&mut can, &mut manual, &mut random));
            let story = || format!("seed {seed}: {:?}", &done[done.len().saturating_sub(12)..]);
            assert_eq!(can.read(0x08), Some(manual.tsr()), "TSR, {}", story());
            assert_eq!(can.read(0x0C), Some(manual.rfr()), "RF0R, {}", story());
            // LEC is told by other tests.
            assert_eq!(can.read(0x18).map(|esr| esr & !0x70), Some(manual.esr()), "ESR, {}", story());
            assert_eq!(can.read(0x04).map(|msr| msr >> 2 & 1), Some(u32::from(manual.erri)), "{}", story());
            assert_eq!(can.interrupts(), manual.interrupts(), "{}", story());
            if manual.pending > 0 {
                let rir = manual.ring[manual.first] << 3 | 1 << 2;
                assert_eq!(can.read(0x1B0), Some(rir), "RI0R, {}", story());
            }
        }
    }
}

#[test]
fn registers_after_reset() {
    let can = BxCan::new();
    let registers = [0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18, 0x1C, 0x200].map(|offset| can.read(offset));
    let manual = [0x0001_0002, 0x0000_0C02, 0x1C00_0000, 0, 0, 0, 0, 0x0123_0000, 0x2A1C_0E01];
    assert_eq!(registers, manual.map(Some));
}

#[test]
fn each_limit_raises_the_status_change_interrupt_by_its_own_enable() {
    for (enable, limit) in [(8, 96), (9, 128), (10, 256)] {
        let mut can = normal();
        let raised = |can: &BxCan| (can.read(0x04).unwrap() >> 2 & 1 == 1, can.interrupts()[3]);
        let errors = |can: &mut BxCan, transmit_errors| {
            can.set_errors(ErrorState { transmit_errors, receive_errors: 0 });
        };
        // ERRI comes with the enable of the limit, the interrupt with ERRIE.
        can.write(0, 0x14, 1 << enable).unwrap();
        errors(&mut can, limit - 1);
        assert_eq!(raised(&can), (false, false), "{limit}");
        errors(&mut can, limit);
        assert_eq!(raised(&can), (true, false), "{limit}");
        can.write(0, 0x14, 1 << enable | 1 << 15).unwrap();
        assert_eq!(raised(&can), (true, true), "{limit}");
        // The state lasts, and raises nothing more; neither does its end.
        can.write(0, 0x04, 1 << 2).unwrap();
        errors(&mut can, limit);
        errors(&mut can, 0);
        assert_eq!(raised(&can), (false, false), "{limit}");
        errors(&mut can, 256);
        assert_eq!(raised(&can), (true, true), "{limit}");
    }
}

#[test]
fn sleep_is_acknowledged_by_an_interrupt_if_it_is_enabled() {
    let mut can = normal();
    can.write(0, 0x00, 2).unwrap();
    assert_eq!(can.read(0x04).map(|msr| msr & 0x12), Some(0x02), "SLAKI needs SLKIE");
    let mut can = normal();
    can.write(0, 0x14, 1 << 17).unwrap();
    can.write(0, 0x00, 2).unwrap();
    assert_eq!(can.read(0x04).map(|msr| msr & 0x12), Some(0x12));
    assert!(can.interrupts()[3]);
    // Cleared by hardware with SLAK.
    can.write(0, 0x00, 1).unwrap();
    assert_eq!(can.read(0x04).map(|msr| msr & 0x13), Some(0x01));
    assert!(!can.interrupts()[3]);
}
