//! Acceptance filters of bxCAN (RM0090, identifier filtering): banks in mask or list mode, of 16 or 32
//! bits, each assigned to one of the two FIFOs.

use std::ops::Range;

use cosmic_bus::WireFrame;
use embedded_can::Frame as _;

use super::CanController;

/// Filter banks, shared with CAN2.
pub(super) const BANKS: usize = 28;

const FMR_FINIT: u32 = 1;
/// Reset value of FMR: initialisation mode, 14 banks for CAN1.
const FMR_RESET: u32 = 0x2A1C_0E01;

/// The filter registers.
#[derive(Clone, Debug)]
pub(super) struct FilterBanks {
    fmr: u32,
    /// FM1R: list mode.
    list: u32,
    /// FS1R: 32-bit scale.
    wide: u32,
    /// FFA1R: FIFO 1.
    fifo: u32,
    /// FA1R: active.
    active: u32,
    banks: [[u32; 2]; BANKS],
}

/// Where an accepted frame goes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Match {
    pub(super) fifo: usize,
    /// Filter match index, counted for each FIFO.
    pub(super) index: u8,
}

impl FilterBanks {
    pub(super) const fn new() -> Self {
        Self { fmr: FMR_RESET, list: 0, wide: 0, fifo: 0, active: 0, banks: [[0; 2]; BANKS] }
    }

    pub(super) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x200 => self.fmr,
            0x204 => self.list,
            0x20C => self.wide,
            0x214 => self.fifo,
            0x21C => self.active,
            _ => *self.banks.get(bank_at(offset)?)?.get(offset as usize / 4 % 2)?,
        })
    }

    /// Writes a register. Modes, scales and assignments change in initialisation mode only; a bank's
    /// registers then or while it is inactive. `None` if there is no such register, or it must not be written now: then
    /// it stays as it is.
    pub(super) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        let initialising = self.fmr & FMR_FINIT != 0;
        match offset {
            0x200 => self.fmr = FMR_RESET & !0x3F01 | value & 0x3F01,
            0x204 if initialising => self.list = value,
            0x20C if initialising => self.wide = value,
            0x214 if initialising => self.fifo = value,
            0x204 | 0x20C | 0x214 => return None,
            0x21C => self.active = value & ((1 << BANKS) - 1),
            _ => {
                let bank = bank_at(offset)?;
                if !initialising && self.active >> bank & 1 != 0 {
                    return None;
                }
                self.banks[bank][offset as usize / 4 % 2] = value;
            }
        }
        Some(())
    }

    /// Where a controller stores the frame; `None` if no filter accepts it.
    ///
    /// Among several matches a 32-bit filter wins over a 16-bit one, a list over a mask, a small number
    /// over a large one.
    pub(super) fn accept(&self, whose: CanController, frame: &WireFrame) -> Option<Match> {
        // No filter is in effect while they are initialised.
        if self.fmr & FMR_FINIT != 0 {
            return None;
        }
        let mut best: Option<((bool, bool, u8), Match)> = None;
        // Inactive banks count in the numbering all the same.
        let mut next_index = [0_u8; 2];
        let (id32, id16) = (identifier_32(frame), identifier_16(frame));
        for bank in self.banks_of(whose) {
            let bit = |set: u32| set >> bank & 1 != 0;
            let fifo = usize::from(bit(self.fifo));
            let (narrow, mask) = (!bit(self.wide), !bit(self.list));
            let [first, second] = self.banks[bank];
            let half = |word: u32, n: u32| word >> (16 * n) & 0xFFFF;
            let matches: &[bool] = match (narrow, mask) {
                (false, true) => &[(id32 ^ first) & second == 0],
                (false, false) => &[id32 == first, id32 == second],
                (true, true) => &[first, second].map(|word| (id16 ^ half(word, 0)) & half(word, 1) == 0),
                (true, false) => {
                    &[half(first, 0), half(first, 1), half(second, 0), half(second, 1)].map(|id| id == id16)
                }
            };
            for &is_match in matches {
                let index = next_index[fifo];
                next_index[fifo] += 1;
                let key = (narrow, mask, index);
                if bit(self.active) && is_match && best.is_none_or(|(best, _)| key < best) {
                    best = Some((key, Match { fifo, index }));
                }
            }
        }
        best.map(|(_, found)| found)
    }

    /// CAN2SB is the first of CAN2's.
    fn banks_of(&self, whose: CanController) -> Range<usize> {
        let second = (self.fmr >> 8 & 0x3F).min(BANKS as u32) as usize;
        match whose {
            CanController::Can1 => 0..second,
            CanController::Can2 => second..BANKS,
        }
    }
}

fn bank_at(offset: u32) -> Option<usize> {
    let bank = (offset.checked_sub(0x240)? / 8) as usize;
    (bank < BANKS).then_some(bank)
}

/// The layout of RIR and TIR without TXRQ: identifier, IDE, RTR.
pub(super) fn identifier_32(frame: &WireFrame) -> u32 {
    let raw = frame.arbitration().raw_id();
    let id = if frame.is_extended() { raw << 3 | 1 << 2 } else { raw << 21 };
    id | u32::from(frame.is_remote_frame()) << 1
}

/// Standard part, RTR, IDE and the three highest bits of the extension.
fn identifier_16(frame: &WireFrame) -> u32 {
    let id = identifier_32(frame);
    id >> 21 << 5 | (id >> 1 & 1) << 4 | (id >> 2 & 1) << 3 | id >> 18 & 0x7
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, StandardId};

    fn extended(id: u32) -> WireFrame {
        WireFrame::new(ExtendedId::new(id).unwrap(), &[]).unwrap()
    }

    fn standard(id: u16) -> WireFrame {
        WireFrame::new(StandardId::new(id).unwrap(), &[]).unwrap()
    }

    fn banks(writes: &[(u32, u32)]) -> FilterBanks {
        let mut banks = FilterBanks::new();
        for &(offset, value) in writes {
            banks.write(offset, value).unwrap();
        }
        banks.write(0x200, 0x0E00).unwrap();
        banks
    }

    #[test]
    fn masks_of_32_bits_select_the_fifo() {
        // Bank 0: priority field 0 to FIFO 0; bank 1: everything to FIFO 1.
        let mask = 0xFF << (21 + 3) | 1 << 2 | 1 << 1;
        let writes = [(0x20C, 3), (0x214, 2), (0x240, 1 << 2), (0x244, mask), (0x248, 0), (0x24C, 0)];
        let mut banks = banks(&writes);
        assert_eq!(banks.accept(CanController::Can1, &extended(5)), None);
        banks.write(0x21C, 3).unwrap();
        assert_eq!(banks.accept(CanController::Can1, &extended(5)), Some(Match { fifo: 0, index: 0 }));
        assert_eq!(banks.accept(CanController::Can1, &extended(1 << 21)), Some(Match { fifo: 1, index: 0 }));
        assert_eq!(banks.accept(CanController::Can1, &standard(0)), Some(Match { fifo: 1, index: 0 }));
    }

    #[test]
    fn lists_win_over_masks_and_wide_over_narrow() {
        let id = extended(0x0012_3456);
        // Bank 0: 16-bit mask, all; bank 1: 32-bit mask, all; bank 2: 32-bit list.
        let list = identifier_32(&id);
        let writes = [(0x20C, 6), (0x204, 4), (0x250, 0), (0x254, list), (0x21C, 7)];
        let banks = banks(&writes);
        assert_eq!(banks.accept(CanController::Can1, &id), Some(Match { fifo: 0, index: 4 }));
        assert_eq!(banks.accept(CanController::Can1, &extended(1)), Some(Match { fifo: 0, index: 2 }));
    }

    #[test]
    fn lists_of_16_bits() {
        let writes = [(0x204, 1), (0x240, 0x123 << 5), (0x244, 0x7FF << 21), (0x21C, 1)];
        let banks = banks(&writes);
        assert_eq!(banks.accept(CanController::Can1, &standard(0x123)), Some(Match { fifo: 0, index: 0 }));
        assert_eq!(banks.accept(CanController::Can1, &standard(0x7FF)), Some(Match { fifo: 0, index: 3 }));
        assert_eq!(banks.accept(CanController::Can1, &standard(0x124)), None);
    }

    #[test]
    fn nothing_is_accepted_while_initialising() {
        let mut banks = FilterBanks::new();
        banks.write(0x20C, 1).unwrap();
        banks.write(0x21C, 1).unwrap();
        assert_eq!(banks.accept(CanController::Can1, &standard(1)), None);
        banks.write(0x200, 0x0E00).unwrap();
        assert!(banks.accept(CanController::Can1, &standard(1)).is_some());
        // It stops reception at any time.
        banks.write(0x200, 0x0E01).unwrap();
        assert_eq!(banks.accept(CanController::Can1, &standard(1)), None);
    }

    /// RM0090, 32.9.4: FM1R, FS1R and FFA1R "can be written only when the filter initialization mode is set"; FiRx "can
    /// only be modified when the FACTx bit [...] is cleared or when the FINIT bit [...] is set".
    #[test]
    fn what_must_not_be_written_is_refused_and_stays() {
        let mut banks = banks(&[(0x20C, 1), (0x21C, 1)]);
        for offset in [0x204, 0x20C, 0x214, 0x240, 0x244] {
            let before = banks.read(offset);
            assert_eq!(banks.write(offset, u32::MAX), None, "{offset:#x}");
            assert_eq!(banks.read(offset), before, "{offset:#x}");
        }
        // Another bank is not active, and while filters are initialised, all may be.
        banks.write(0x248, 5).unwrap();
        banks.write(0x200, 0x0E01).unwrap();
        for offset in [0x204, 0x20C, 0x214, 0x240, 0x244] {
            banks.write(offset, 7).unwrap();
            assert_eq!(banks.read(offset), Some(7), "{offset:#x}");
        }
    }

    #[test]
    fn banks_are_switched_while_frames_come() {
        let list_of = |id: u32| [id << 3 | 1 << 2; 2];
        let [a, b] = [(5, 0), (6, 1)].map(|(id, bank)| (extended(id), list_of(id), bank));
        let mut banks = banks(&[(0x20C, 3), (0x204, 3)]);
        let accepts = |banks: &FilterBanks| {
            [&a.0, &b.0].map(|frame| banks.accept(CanController::Can1, frame).is_some())
        };
        assert_eq!(accepts(&banks), [false, false]);
        for (_, [first, second], bank) in [&a, &b] {
            banks.write(0x240 + 8 * bank, *first).unwrap();
            banks.write(0x244 + 8 * bank, *second).unwrap();
        }
        for (active, both) in [(1, [true, false]), (3, [true, true]), (2, [false, true]), (0, [false; 2])] {
            banks.write(0x21C, active).unwrap();
            assert_eq!(accepts(&banks), both, "{active}");
        }
    }
}
