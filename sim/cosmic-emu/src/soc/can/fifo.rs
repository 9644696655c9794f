//! The receive FIFOs of bxCAN: three messages each (RM0090, reception handling).

use std::collections::VecDeque;

/// Messages that a FIFO holds.
const DEPTH: usize = 3;

const FULL: u32 = 1 << 3;
const OVERRUN: u32 = 1 << 4;
const RELEASE: u32 = 1 << 5;

/// A message as the FIFO's mailbox registers show it: RIR, RDTR, RDLR, RDHR.
pub(super) type ReceivedWords = [u32; 4];

/// One receive FIFO.
#[derive(Clone, Debug, Default)]
pub(super) struct Fifo {
    messages: VecDeque<ReceivedWords>,
    full: bool,
    overrun: bool,
}

impl Fifo {
    /// A message arrives. `locked` (MCR.RFLM): when full, the new message is lost, else the last one.
    pub(super) fn push(&mut self, message: ReceivedWords, locked: bool) {
        if self.messages.len() < DEPTH {
            self.messages.push_back(message);
            self.full |= self.messages.len() == DEPTH;
            return;
        }
        self.overrun = true;
        if !locked {
            self.messages.pop_back();
            self.messages.push_back(message);
        }
    }

    /// RFxR.
    pub(super) fn status(&self) -> u32 {
        let flag = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        self.messages.len() as u32 | flag(self.full, FULL) | flag(self.overrun, OVERRUN)
    }

    /// Writes RFxR: clears flags, releases the first message. FULL is set when the third message is stored and
    /// cleared by software only, so it outlasts a release (RM0090, CAN_RFxR).
    pub(super) fn write_status(&mut self, value: u32) {
        if value & FULL != 0 {
            self.full = false;
        }
        if value & OVERRUN != 0 {
            self.overrun = false;
        }
        if value & RELEASE != 0 {
            self.messages.pop_front();
        }
    }

    /// A register of the first message.
    pub(super) fn read(&self, index: usize) -> u32 {
        self.messages.front().map_or(0, |message| message[index % 4])
    }

    /// Returns whether the interrupt line is asserted. `enabled` has the bits message pending, full, overrun, from 0 on.
    pub(super) fn interrupt(&self, enabled: u32) -> bool {
        let causes =
            u32::from(!self.messages.is_empty()) | u32::from(self.full) << 1 | u32::from(self.overrun) << 2;
        causes & enabled != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(locked: bool) -> Fifo {
        let mut fifo = Fifo::default();
        for n in 1..=4 {
            fifo.push([n; 4], locked);
        }
        fifo
    }

    #[test]
    fn an_overrun_loses_the_last_or_the_new_message() {
        for (locked, last) in [(false, 4), (true, 3)] {
            let mut fifo = filled(locked);
            assert_eq!(fifo.status(), 3 | FULL | OVERRUN);
            let mut seen = vec![];
            while fifo.status() & 3 != 0 {
                seen.push(fifo.read(1));
                fifo.write_status(RELEASE);
            }
            assert_eq!(seen, [1, 2, last]);
            assert_eq!(fifo.status(), FULL | OVERRUN);
            fifo.write_status(OVERRUN);
            assert_eq!(fifo.status(), FULL);
            fifo.write_status(FULL);
            assert_eq!(fifo.status(), 0);
        }
    }

    #[test]
    fn each_cause_has_its_enable() {
        let mut fifo = Fifo::default();
        assert!(!fifo.interrupt(7));
        fifo.push([0; 4], false);
        assert!(fifo.interrupt(1) && !fifo.interrupt(6));
        let fifo = filled(false);
        assert!(fifo.interrupt(1) && fifo.interrupt(2) && fifo.interrupt(4));
    }
}
