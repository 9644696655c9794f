//! The transmit mailboxes of bxCAN (RM0090, transmission handling).

use cosmic_bus::{MAILBOXES, WireFrame};
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};

use super::{Command, Outcome};

const TXRQ: u32 = 1 << 0;
const RTR: u32 = 1 << 1;
const IDE: u32 = 1 << 2;

/// Bits of TSR, eight for each mailbox.
mod tsr {
    pub(super) const RQCP: u32 = 1 << 0;
    pub(super) const TXOK: u32 = 1 << 1;
    pub(super) const TERR: u32 = 1 << 3;
    pub(super) const OUTCOME: u32 = 0xF;
    /// TXOK, ALST, TERR: each is cleared by a 1 as well, and all of them by RQCP.
    pub(super) const CLEARED_BY_ONE: u32 = 0xE;
    pub(super) const ABRQ: u32 = 1 << 7;
    pub(super) const CODE: u32 = 24;
    pub(super) const TME: u32 = 26;
    pub(super) const LOW: u32 = 29;
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
enum State {
    #[default]
    Empty,
    /// Requested, but held back: with TXFP the oldest request goes first.
    Held,
    /// In the bus's mailbox.
    Loaded,
}

#[derive(Clone, Copy, Debug, Default)]
struct Mailbox {
    /// TIxR without TXRQ, TDTxR, TDLxR, TDHxR.
    registers: [u32; 4],
    state: State,
    /// RQCP, TXOK, ALST, TERR, ABRQ.
    status: u32,
    /// Order of the requests.
    requested: u64,
}

/// The three mailboxes.
#[derive(Clone, Debug, Default)]
pub(super) struct Transmit {
    mailboxes: [Mailbox; MAILBOXES],
    requests: u64,
}

impl Transmit {
    /// Returns whether a mailbox is the transmit interrupt's cause.
    pub(super) fn interrupt(&self) -> bool {
        self.mailboxes.iter().any(|mailbox| mailbox.status & tsr::RQCP != 0)
    }

    /// Reads TIxR, TDTxR, TDLxR or TDHxR.
    pub(super) fn read(&self, mailbox: usize, index: usize) -> u32 {
        let mailbox = &self.mailboxes[mailbox];
        let request = if index == 0 && mailbox.state != State::Empty { TXRQ } else { 0 };
        mailbox.registers[index] | request
    }

    /// Writes TIxR, TDTxR, TDLxR or TDHxR of an empty mailbox; others are write protected.
    /// `oldest_first` is MCR.TXFP.
    pub(super) fn write(
        &mut self,
        mailbox: usize,
        index: usize,
        value: u32,
        oldest_first: bool,
    ) -> Option<Command> {
        let slot = &mut self.mailboxes[mailbox];
        if slot.state != State::Empty {
            return None;
        }
        slot.registers[index] = if index == 0 { value & !TXRQ } else { value };
        if index != 0 || value & TXRQ == 0 {
            return None;
        }
        slot.state = State::Held;
        slot.status = 0;
        slot.requested = self.requests;
        self.requests += 1;
        self.load_next(oldest_first)
    }

    /// Hands over to the bus what may be sent now.
    fn load_next(&mut self, oldest_first: bool) -> Option<Command> {
        if oldest_first && self.mailboxes.iter().any(|mailbox| mailbox.state == State::Loaded) {
            return None;
        }
        let held = self.mailboxes.iter_mut().enumerate().filter(|(_, mailbox)| mailbox.state == State::Held);
        let (mailbox, slot) = held.min_by_key(|(_, mailbox)| mailbox.requested)?;
        slot.state = State::Loaded;
        Some(Command::Load { mailbox, frame: slot.frame() })
    }

    /// TSR.
    pub(super) fn status(&self) -> u32 {
        let mut status = 0;
        for (n, mailbox) in self.mailboxes.iter().enumerate() {
            status |= mailbox.status << (8 * n);
            if mailbox.state == State::Empty {
                status |= 1 << (tsr::TME + n as u32);
            }
        }
        let pending =
            || self.mailboxes.iter().enumerate().filter(|(_, mailbox)| mailbox.state != State::Empty);
        let lowest = pending().max_by_key(|(n, mailbox)| (mailbox.frame().arbitration(), *n)).map(|(n, _)| n);
        if let Some(lowest) = lowest
            && pending().count() > 1
        {
            status |= 1 << (tsr::LOW + lowest as u32);
        }
        let free = self.mailboxes.iter().position(|mailbox| mailbox.state == State::Empty);
        status | (free.or(lowest).unwrap_or(0) as u32) << tsr::CODE
    }

    /// Writes TSR: RQCP clears the outcome, ABRQ asks for a withdrawal.
    pub(super) fn write_status(&mut self, value: u32, oldest_first: bool) -> Vec<Command> {
        let mut commands = Vec::new();
        for n in 0..MAILBOXES {
            let bits = value >> (8 * n);
            let mailbox = &mut self.mailboxes[n];
            mailbox.status &= !(bits & tsr::CLEARED_BY_ONE);
            if bits & tsr::RQCP != 0 {
                mailbox.status &= !tsr::OUTCOME;
            }
            if bits & tsr::ABRQ == 0 {
                continue;
            }
            match mailbox.state {
                // Aborting an empty mailbox has no effect.
                State::Empty => {}
                State::Held => commands.extend(self.complete(n, Outcome::Withdrawn, oldest_first)),
                State::Loaded => {
                    mailbox.status |= tsr::ABRQ;
                    commands.push(Command::Withdraw { mailbox: n });
                }
            }
        }
        commands
    }

    /// The bus tells what became of a frame.
    pub(super) fn complete(
        &mut self,
        mailbox: usize,
        outcome: Outcome,
        oldest_first: bool,
    ) -> Option<Command> {
        let slot = self.mailboxes.get_mut(mailbox)?;
        match outcome {
            Outcome::Sent => slot.status = tsr::RQCP | tsr::TXOK,
            Outcome::Withdrawn => slot.status = slot.status & tsr::TERR | tsr::RQCP,
            Outcome::Failed => {
                slot.status |= tsr::TERR;
                return None;
            }
        }
        slot.state = State::Empty;
        self.load_next(oldest_first)
    }
}

impl Mailbox {
    fn frame(&self) -> WireFrame {
        let [tir, tdtr, low, high] = self.registers;
        let is_remote = tir & RTR != 0;
        // Neither `unwrap_or` is taken: the shifts leave 29 and 11 bits.
        let id = if tir & IDE != 0 {
            Id::Extended(ExtendedId::new(tir >> 3).unwrap_or(ExtendedId::MAX))
        } else {
            Id::Standard(StandardId::new((tir >> 21) as u16).unwrap_or(StandardId::MAX))
        };
        // A length code above 8 means eight bytes (ISO 11898-1), and is sent as it is.
        let code = (tdtr & 0xF) as u8;
        let length = usize::from(code).min(8);
        let data = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
        let frame =
            if is_remote { WireFrame::new_remote(id, length) } else { WireFrame::new(id, &data[..length]) };
        let frame = frame.and_then(|frame| frame.with_length_code(code));
        frame.unwrap_or_else(|| unreachable!("the length fits the code"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TME_ALL: u32 = 7 << tsr::TME;

    fn request(transmit: &mut Transmit, mailbox: usize, id: u32, oldest_first: bool) -> Option<Command> {
        assert_eq!(transmit.write(mailbox, 1, 2, oldest_first), None);
        assert_eq!(transmit.write(mailbox, 2, 0x0201, oldest_first), None);
        transmit.write(mailbox, 0, id << 3 | IDE | TXRQ, oldest_first)
    }

    fn frame(id: u32) -> WireFrame {
        WireFrame::new(ExtendedId::new(id).unwrap(), &[1, 2]).unwrap()
    }

    #[test]
    fn a_request_loads_and_its_outcome_frees() {
        let mut transmit = Transmit::default();
        assert_eq!(transmit.status(), TME_ALL);
        let load = request(&mut transmit, 1, 0x77, false);
        assert_eq!(load, Some(Command::Load { mailbox: 1, frame: frame(0x77) }));
        assert_eq!(transmit.status(), TME_ALL & !(2 << tsr::TME));
        assert_eq!(transmit.read(1, 0), 0x77 << 3 | IDE | TXRQ);
        // Write protected while it is requested.
        assert_eq!(transmit.write(1, 0, TXRQ, false), None);
        assert_eq!(transmit.complete(1, Outcome::Sent, false), None);
        assert_eq!(transmit.status(), TME_ALL | 0x0300);
        assert!(transmit.interrupt());
        assert_eq!(transmit.write_status(0x0100, false), []);
        assert_eq!(transmit.status(), TME_ALL);
    }

    #[test]
    fn low_and_code_follow_the_identifiers() {
        let mut transmit = Transmit::default();
        for (mailbox, id) in [(0, 5), (1, 9), (2, 7)] {
            assert!(request(&mut transmit, mailbox, id, false).is_some());
        }
        assert_eq!(transmit.status(), 1 << tsr::CODE | 2 << tsr::LOW);
        assert_eq!(transmit.write_status(tsr::ABRQ << 8, false), [Command::Withdraw { mailbox: 1 }]);
        assert_eq!(transmit.complete(1, Outcome::Withdrawn, false), None);
        assert_eq!(transmit.status(), 1 << tsr::CODE | 2 << tsr::TME | 4 << tsr::LOW | tsr::RQCP << 8);
    }

    #[test]
    fn the_oldest_request_goes_first_with_txfp() {
        let mut transmit = Transmit::default();
        assert!(request(&mut transmit, 2, 9, true).is_some());
        assert_eq!(request(&mut transmit, 1, 5, true), None);
        assert_eq!(request(&mut transmit, 0, 1, true), None);
        // A held frame is withdrawn on the spot.
        assert_eq!(transmit.write_status(tsr::ABRQ << 8, true), []);
        assert_eq!(transmit.status() >> 8 & 0xFF, tsr::RQCP);
        let next = transmit.complete(2, Outcome::Sent, true);
        assert_eq!(next, Some(Command::Load { mailbox: 0, frame: frame(1) }));
    }
}
