//! The three transmit mailboxes of bxCAN, one type for each class.
//!
//! The mailboxes are driven directly because the general driver refuses a frame unless it beats every
//! pending one, and waits in a loop for a withdrawal: both would let one class disturb another.
//!
//! Each type writes the registers of its own mailbox only, and of the shared status register `CAN_TSR`
//! only its own bits. All writable bits of that register act when a 1 is written and ignore a 0
//! (RM0090, `CAN_TSR`), so a plain write of one bit cannot disturb another mailbox, and nobody needs a
//! lock. That is what lets the calendar task release a frame while the soft real-time path is in the
//! middle of loading its own.
//!
//! # Calling order
//! A mailbox is loaded only after the [`Outcome`] of its last frame was taken by [`TxOutcomes::take`],
//! since loading clears the flags of the frame before. The middleware keeps this order.
//! No method waits: each is a handful of register accesses.

use core::marker::PhantomData;

use cosmic_core::can::{Frame, Mailbox, Outcome};

use crate::registers::Registers;

/// One part for each class, and one that reports what became of the frames.
pub(crate) const fn split(
    registers: Registers,
) -> (HardMailbox, SoftMailbox, NonRealTimeMailbox, TxOutcomes) {
    (
        TxMailbox { registers, _class: PhantomData },
        TxMailbox { registers, _class: PhantomData },
        TxMailbox { registers, _class: PhantomData },
        TxOutcomes { registers },
    )
}

/// A class, and with it the number of its mailbox.
pub trait Class {
    /// The mailbox of the class.
    const MAILBOX: Mailbox;
}

macro_rules! class {
    ($class:ident, $mailbox:ident, $doc:literal) => {
        #[doc = $doc]
        pub struct $class;

        impl Class for $class {
            const MAILBOX: Mailbox = Mailbox::$mailbox;
        }
    };
}
class!(Hard, Hard, "Hard real-time.");
class!(Soft, Soft, "Soft real-time.");
class!(NonRealTime, NonRealTime, "Non real-time.");

/// The mailbox of the calendar: used by the time-triggered half only.
pub type HardMailbox = TxMailbox<Hard>;
/// The mailbox of the EDF queue.
pub type SoftMailbox = TxMailbox<Soft>;
/// The mailbox of the non real-time queue.
pub type NonRealTimeMailbox = TxMailbox<NonRealTime>;

/// One transmit mailbox.
pub struct TxMailbox<C: Class> {
    registers: Registers,
    _class: PhantomData<C>,
}

impl<C: Class> TxMailbox<C> {
    /// Puts a frame into the mailbox, which is empty, and requests its transmission.
    #[inline]
    pub fn load(&mut self, frame: &Frame) {
        let mailbox = TX_MAILBOX_0 + TX_MAILBOX_STRIDE * C::MAILBOX as usize;
        let [low, high] = words(frame.payload.padded());
        self.registers.write(mailbox + TDTR, frame.payload.len() as u32);
        self.registers.write(mailbox + TDLR, low);
        self.registers.write(mailbox + TDHR, high);
        // The request comes last: from here on the controller may read the mailbox.
        self.registers.write(mailbox + TIR, frame.id.raw() << TIR_EXID_SHIFT | TIR_IDE | TIR_TXRQ);
    }

    /// Requests that the frame be withdrawn; an empty mailbox ignores it.
    ///
    /// A pending frame leaves the mailbox at once; one on the wire completes, or is dropped if it fails
    /// (RM0090, bxCAN transmission handling). The outcome tells which.
    #[inline]
    pub fn withdraw(&mut self) {
        self.registers.write(TSR, TSR_ABRQ << shift(C::MAILBOX));
    }
}

/// What became of loaded frames: read by the transmit interrupt only.
pub struct TxOutcomes {
    registers: Registers,
}

impl TxOutcomes {
    /// The outcome of one mailbox whose frame is done, which is thereby acknowledged; `None` if there is
    /// none. Mailboxes with smaller numbers come first.
    ///
    /// Once this returns `None` the interrupt is acknowledged. One frame gives one outcome, so a caller
    /// that loops ends after three turns unless frames are loaded meanwhile.
    #[inline]
    pub fn take(&mut self) -> Option<(Mailbox, Outcome)> {
        let status = self.registers.read(TSR);
        let (mailbox, outcome) = first_outcome(status)?;
        self.registers.write(TSR, TSR_RQCP << shift(mailbox));
        Some((mailbox, outcome))
    }
}

/// What the status register says of the first mailbox that is done.
fn first_outcome(status: u32) -> Option<(Mailbox, Outcome)> {
    let mailbox = Mailbox::ALL.into_iter().find(|&mailbox| status & TSR_RQCP << shift(mailbox) != 0)?;
    // With automatic retransmission a request is completed by success or by a withdrawal only.
    let sent = status & TSR_TXOK << shift(mailbox) != 0;
    Some((mailbox, if sent { Outcome::Sent } else { Outcome::Withdrawn }))
}

/// Where in `CAN_TSR` the bits of a mailbox begin.
const fn shift(mailbox: Mailbox) -> u32 {
    8 * mailbox as u32
}

/// Data bytes as the two data registers hold them: the first byte in the lowest bits.
fn words(bytes: [u8; 8]) -> [u32; 2] {
    let all = u64::from_le_bytes(bytes);
    [all as u32, (all >> 32) as u32]
}

// RM0090, bxCAN register map.
const TSR: usize = 0x08;
const TX_MAILBOX_0: usize = 0x180;
const TX_MAILBOX_STRIDE: usize = 0x10;
const TIR: usize = 0x0;
const TDTR: usize = 0x4;
const TDLR: usize = 0x8;
const TDHR: usize = 0xC;

const TIR_TXRQ: u32 = 1 << 0;
const TIR_IDE: u32 = 1 << 2;
const TIR_EXID_SHIFT: u32 = 3;
const TSR_RQCP: u32 = 1 << 0;
const TSR_TXOK: u32 = 1 << 1;
const TSR_ABRQ: u32 = 1 << 7;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::Memory;
    use cosmic_core::can::{Id, Payload};
    use std::vec::Vec;

    fn mailboxes(memory: &mut Memory) -> (HardMailbox, SoftMailbox, NonRealTimeMailbox, TxOutcomes) {
        split(memory.registers())
    }

    fn frame() -> Frame {
        Frame::new(Id::from_raw(0x1234_5678).unwrap(), Payload::new(&[1, 2, 3, 4, 5]).unwrap())
    }

    #[test]
    fn a_frame_goes_into_the_mailbox_of_its_class() {
        let mut memory = Memory::new();
        let (_, mut soft, _, _) = mailboxes(&mut memory);
        soft.load(&frame());
        assert_eq!(memory.at(0x190), 0x1234_5678 << 3 | 0b101);
        assert_eq!(memory.at(0x194), 5);
        assert_eq!(memory.at(0x198), 0x0403_0201);
        assert_eq!(memory.at(0x19C), 0x0000_0005);
        let written: Vec<_> = memory.written().collect();
        assert_eq!(written, [0x190, 0x194, 0x198, 0x19C], "a register of others was written");
    }

    #[test]
    fn a_withdrawal_writes_one_bit() {
        let mut memory = Memory::new();
        let (mut hard, mut soft, mut non_real_time, _) = mailboxes(&mut memory);
        hard.withdraw();
        assert_eq!(memory.at(TSR), 0x80);
        soft.withdraw();
        assert_eq!(memory.at(TSR), 0x8000);
        non_real_time.withdraw();
        assert_eq!(memory.at(TSR), 0x80_0000);
    }

    #[test]
    fn outcomes_come_from_their_own_bits() {
        assert_eq!(first_outcome(0x1C00_0000), None, "empty mailboxes are no outcome");
        assert_eq!(first_outcome(0x03), Some((Mailbox::Hard, Outcome::Sent)));
        assert_eq!(first_outcome(0x01), Some((Mailbox::Hard, Outcome::Withdrawn)));
        // Arbitration was lost and an error occurred before it was sent.
        assert_eq!(first_outcome(0x0F00), Some((Mailbox::Soft, Outcome::Sent)));
        assert_eq!(first_outcome(0x0D_0000), Some((Mailbox::NonRealTime, Outcome::Withdrawn)));
        assert_eq!(first_outcome(0x03_0300), Some((Mailbox::Soft, Outcome::Sent)));
    }

    #[test]
    fn taking_an_outcome_acknowledges_that_one_only() {
        let mut memory = Memory::new();
        memory.set(TSR, 0x03_0100);
        let (_, _, _, mut outcomes) = mailboxes(&mut memory);
        assert_eq!(outcomes.take(), Some((Mailbox::Soft, Outcome::Withdrawn)));
        assert_eq!(memory.at(TSR), 0x0100);
    }
}
