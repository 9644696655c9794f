//! The receive FIFOs of bxCAN.
//!
//! FIFO 0 takes what must be read at once: hard real-time and synchronisation frames. FIFO 1 takes the
//! rest. Each has an interrupt of its own, so the first can have the higher priority.
//!
//! The receive mailboxes are read directly because the general driver takes the length code of a frame for
//! the number of its bytes: a legal frame with a code of 9 to 15 ended in a panic. Whatever the registers
//! hold, [`RxFrames::read`] returns a frame or counts a foreign one.
//!
//! When three messages are pending and another comes, the controller overwrites the last of them
//! (RM0090, bxCAN reception handling; RFLM = 0), so the newest message is always there.

use cosmic_core::can::{Frame, Id, Payload};

use crate::registers::Registers;

/// Frames that a FIFO holds before it loses one.
pub const FIFO_DEPTH: usize = 3;

/// How many frames a FIFO did not hand over.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct RxLosses {
    /// Times that the FIFO was full and one frame or more were lost: the controller does not count them.
    pub overruns: u32,
    /// Frames that were no extended data frames.
    pub foreign: u32,
}

/// A receive FIFO: read by its own interrupt only.
///
/// Its owner alone accesses `CAN_RFxR` and the receive mailbox of the FIFO. The writable bits of that
/// register act when a 1 is written and ignore a 0, so plain writes will do. Both FIFOs are of one type, so that their
/// interrupts share what they do with a frame.
pub struct RxFrames {
    registers: Registers,
    /// Of `CAN_RFxR`.
    status_at: usize,
    mailbox: usize,
    losses: RxLosses,
}

impl RxFrames {
    /// FIFO 0.
    pub(crate) const fn urgent(registers: Registers) -> Self {
        Self::new(registers, RFR, RX_MAILBOX_0)
    }

    /// FIFO 1.
    pub(crate) const fn other(registers: Registers) -> Self {
        Self::new(registers, RFR + RFR_STRIDE, RX_MAILBOX_0 + RX_MAILBOX_STRIDE)
    }

    const fn new(registers: Registers, status_at: usize, mailbox: usize) -> Self {
        Self { registers, status_at, mailbox, losses: RxLosses { overruns: 0, foreign: 0 } }
    }

    /// The next frame, if there is one. The interrupt stays pending while there are more.
    ///
    /// Bounded: takes at most [`FIFO_DEPTH`] frames out, if all but the last are foreign.
    #[inline]
    pub fn read(&mut self) -> Option<Frame> {
        for _ in 0..FIFO_DEPTH {
            match self.take()?.frame() {
                Some(frame) => return Some(frame),
                None => self.losses.foreign = self.losses.foreign.saturating_add(1),
            }
        }
        None
    }

    /// Takes the first message out. Notes an overrun, whether there is a message or not.
    #[inline]
    fn take(&mut self) -> Option<Received> {
        let Self { status_at, mailbox, .. } = *self;
        let status = self.registers.read(status_at);
        if status & RFR_FOVR != 0 {
            self.losses.overruns = self.losses.overruns.saturating_add(1);
            self.registers.write(status_at, RFR_FOVR);
        }
        // While a release is under way the message is still counted, and must not be read again. The
        // interrupt stays pending if there is another behind it.
        if status & RFR_FMP == 0 || status & RFR_RFOM != 0 {
            return None;
        }
        let received = Received {
            identifier: self.registers.read(mailbox + RIR),
            length_and_time: self.registers.read(mailbox + RDTR),
            low: self.registers.read(mailbox + RDLR),
            high: self.registers.read(mailbox + RDHR),
        };
        // FULL is no longer true. It stays until it is cleared, and says nothing that FMP does not.
        self.registers.write(status_at, RFR_RFOM | RFR_FULL);
        Some(received)
    }

    /// What was not handed over since the last call.
    pub fn take_losses(&mut self) -> RxLosses {
        core::mem::take(&mut self.losses)
    }
}

/// A message as the four registers of the receive mailbox hold it.
#[derive(Clone, Copy, Debug)]
struct Received {
    identifier: u32,
    length_and_time: u32,
    low: u32,
    high: u32,
}

impl Received {
    /// The frame, if it is an extended data frame. A length code above 8 stands for eight bytes
    /// (ISO 11898-1, data length code), so no value of the registers is out of range.
    #[inline]
    fn frame(self) -> Option<Frame> {
        if self.identifier & (RIR_IDE | RIR_RTR) != RIR_IDE {
            return None;
        }
        let id = Id::from_raw(self.identifier >> RIR_EXID_SHIFT)?;
        let [a, b, c, d] = self.low.to_le_bytes();
        let [e, f, g, h] = self.high.to_le_bytes();
        // `truncated` takes more than eight as eight.
        let length = (self.length_and_time & RDTR_DLC) as usize;
        Some(Frame::new(id, Payload::truncated([a, b, c, d, e, f, g, h], length)))
    }
}

// RM0090, bxCAN register map.
const RFR: usize = 0x0C;
const RFR_STRIDE: usize = 0x4;
const RX_MAILBOX_0: usize = 0x1B0;
const RX_MAILBOX_STRIDE: usize = 0x10;
const RIR: usize = 0x0;
const RDTR: usize = 0x4;
const RDLR: usize = 0x8;
const RDHR: usize = 0xC;

const RFR_FMP: u32 = 0b11;
const RFR_FULL: u32 = 1 << 3;
const RFR_FOVR: u32 = 1 << 4;
const RFR_RFOM: u32 = 1 << 5;
const RIR_RTR: u32 = 1 << 1;
const RIR_IDE: u32 = 1 << 2;
const RIR_EXID_SHIFT: u32 = 3;
const RDTR_DLC: u32 = 0xF;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::Memory;
    use proptest::prelude::*;

    const ID: u32 = 0x1234_5678;
    const EXTENDED_DATA: u32 = ID << 3 | RIR_IDE;

    /// A message in the mailbox of FIFO 0.
    fn with_message(status: u32, registers: [u32; 4]) -> Memory {
        let mut memory = Memory::new();
        memory.set(RFR, status);
        for (word, value) in registers.into_iter().enumerate() {
            memory.set(RX_MAILBOX_0 + 4 * word, value);
        }
        memory
    }

    fn urgent(memory: &mut Memory) -> RxFrames {
        RxFrames::urgent(memory.registers())
    }

    fn frame(data: &[u8]) -> Frame {
        Frame::new(Id::from_raw(ID).unwrap(), Payload::new(data).unwrap())
    }

    #[test]
    fn a_frame_is_read_and_released() {
        let mut memory = with_message(1, [EXTENDED_DATA, 0xABCD_0705, 0x0403_0201, 0xFFFF_FF05]);
        assert_eq!(urgent(&mut memory).read(), Some(frame(&[1, 2, 3, 4, 5])));
        assert_eq!(memory.at(RFR), RFR_RFOM | RFR_FULL);
        assert_eq!(memory.at(0x10), 0, "the other FIFO was written");
    }

    #[test]
    fn each_fifo_has_registers_of_its_own() {
        let mut memory = Memory::new();
        for (offset, value) in [(0x10, 1), (0x1C0, EXTENDED_DATA), (0x1C4, 8), (0x1C8, 0x0403_0201)] {
            memory.set(offset, value);
        }
        memory.set(0x1CC, 0x0807_0605);
        assert_eq!(urgent(&mut memory).read(), None);
        let mut other = RxFrames::other(memory.registers());
        assert_eq!(other.read(), Some(frame(&[1, 2, 3, 4, 5, 6, 7, 8])));
        assert_eq!((memory.at(0x0C), memory.at(0x10)), (0, RFR_RFOM | RFR_FULL));
    }

    #[test]
    fn length_codes_above_eight_are_eight_bytes() {
        for code in 8..=15 {
            let mut memory = with_message(1, [EXTENDED_DATA, code, 0x0403_0201, 0x0807_0605]);
            assert_eq!(urgent(&mut memory).read(), Some(frame(&[1, 2, 3, 4, 5, 6, 7, 8])), "{code}");
        }
    }

    #[test]
    fn standard_and_remote_frames_are_foreign() {
        for identifier in [0x123 << 21, 0x123 << 21 | RIR_RTR, EXTENDED_DATA | RIR_RTR] {
            let mut memory = with_message(3, [identifier, 15, 1, 2]);
            let mut fifo = urgent(&mut memory);
            // In memory the release of the first one never ends.
            assert_eq!(fifo.read(), None);
            assert_eq!(fifo.take_losses(), RxLosses { overruns: 0, foreign: 1 });
            assert_eq!(fifo.take_losses(), RxLosses::default());
            assert_eq!(memory.at(RFR), RFR_RFOM | RFR_FULL);
        }
    }

    #[test]
    fn an_overrun_is_counted_once_and_acknowledged() {
        let registers = [EXTENDED_DATA, 0, 0, 0];
        let mut memory = with_message(3 | RFR_FULL | RFR_FOVR, registers);
        let mut fifo = urgent(&mut memory);
        assert_eq!(fifo.read(), Some(frame(&[])));
        assert_eq!(fifo.take_losses(), RxLosses { overruns: 1, foreign: 0 });
        // Also when the FIFO has been emptied meanwhile. FULL and RFOM are not written then.
        memory.set(RFR, RFR_FOVR | RFR_FULL);
        assert_eq!(fifo.read(), None);
        assert_eq!(fifo.take_losses(), RxLosses { overruns: 1, foreign: 0 });
        assert_eq!(memory.at(RFR), RFR_FOVR);
    }

    #[test]
    fn a_message_whose_release_is_under_way_is_not_read_again() {
        let mut memory = with_message(2 | RFR_RFOM, [EXTENDED_DATA, 0, 0, 0]);
        assert_eq!(urgent(&mut memory).read(), None);
        assert_eq!(memory.at(RFR), 2 | RFR_RFOM);
    }

    proptest! {
        #[test]
        fn any_register_values_are_a_frame_or_foreign(status: u32, registers: [u32; 4]) {
            let mut memory = with_message(status, registers);
            let mut fifo = urgent(&mut memory);
            let read = fifo.read();
            let losses = fifo.take_losses();
            let [identifier, length, low, high] = registers;
            let is_ready = status & 3 != 0 && status & RFR_RFOM == 0;
            let is_ours = identifier & 0b110 == 0b100;
            prop_assert_eq!(read.is_some(), is_ready && is_ours);
            prop_assert_eq!(losses.foreign, u32::from(is_ready && !is_ours));
            prop_assert_eq!(losses.overruns, status >> 4 & 1);
            if let Some(frame) = read {
                let length = (length as usize & 15).min(8);
                let bytes = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
                prop_assert_eq!(frame.id.raw(), identifier >> 3);
                prop_assert_eq!(frame.payload.as_slice(), &bytes[..length]);
            }
        }
    }
}
