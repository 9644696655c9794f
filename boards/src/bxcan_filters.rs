//! The acceptance filters of bxCAN: those of the plan, written once, and those that change as the node runs.
//!
//! Mode, scale and FIFO of a bank change in filter initialisation mode only, in which nothing is received. What a bank
//! compares with may be written while it is not active, and the others go on (RM0090, bxCAN identifier filtering, and
//! CAN_FiRx). So all banks that the plan leaves are made masks of FIFO 1 at the start. The last of them accepts everything:
//! it is active for as long as the others are written, and from the start until they are written first.
//!
//! As long as there are enough, each wish has a bank of its own, and nothing else is accepted. A further one shares that
//! from which it differs in the lowest bits: a broker hands out etags one after the other.

use cosmic_core::can::filter_banks::{Fifo, FilterBank, Wanted};
use cosmic_rtic::board::Filters;

use crate::registers::Registers;

/// Filter banks of a controller: of the 28 that both share, CAN1 has those before the reset value of `CAN2SB`, and CAN2
/// the others.
pub const BANKS: usize = 14;

/// More filters than the peripheral has banks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct TooManyFilters;

/// The banks of a controller.
#[derive(Clone, Copy)]
pub(crate) struct Banks {
    /// The registers that the filters are in: those of CAN1 (RM0090, dual CAN).
    pub(crate) registers: Registers,
    pub(crate) first: usize,
}

/// The banks that the plan leaves, for what the node wants as it runs. Their owner alone writes `CAN_FA1R` from now on.
pub struct SpareBanks {
    registers: Registers,
    /// As many as there are before the one that accepts everything; none in a node whose filters stay.
    count: usize,
    first: usize,
}

impl Banks {
    /// Writes the filters to the banks, from the first on, and switches the others off. Nothing is received for that time.
    /// With `leaves_spare` the others are for what is [set](Filters::set) later; until then everything is accepted.
    pub(crate) fn apply<'a>(
        self,
        filters: impl Iterator<Item = &'a FilterBank>,
        leaves_spare: bool,
    ) -> Result<SpareBanks, TooManyFilters> {
        let Self { registers, first } = self;
        registers.write(FMR, registers.read(FMR) | FMR_FINIT);
        let (mut used, mut lists, mut to_other) = (0, 0, 0);
        // One that accepts everything, and at least one beside it.
        let most = if leaves_spare { BANKS - 2 } else { BANKS };
        let mut spare = Ok(SpareBanks { registers, count: 0, first });
        let mut next = first;
        for filter in filters {
            if next == first + most {
                spare = Err(TooManyFilters);
                break;
            }
            let bit = 1 << next;
            used |= bit;
            if filter.fifo() == Fifo::Other {
                to_other |= bit;
            }
            if matches!(filter, FilterBank::List { .. }) {
                lists |= bit;
            }
            write_bank(registers, next, filter);
            next += 1;
        }
        // The bits of the other controller's banks stay.
        let own = OWN_BANKS << first;
        let (mut wide, mut active) = (used, used);
        if leaves_spare && spare.is_ok() {
            let last = first + BANKS - 1;
            write_bank(registers, last, const { &Wanted::ALL.bank() });
            to_other |= own & !used;
            (wide, active) = (own, used | 1 << last);
            spare = Ok(SpareBanks { registers, count: last - next, first: next });
        }
        let set = |register, bits| registers.write(register, registers.read(register) & !own | bits);
        set(FM1R, lists);
        set(FS1R, wide);
        set(FFA1R, to_other);
        set(FA1R, active);
        registers.write(FMR, registers.read(FMR) & !FMR_FINIT);
        spare
    }
}

/// Work: O(wishes × banks). Everything is accepted for as long as that takes, which is less than a frame.
impl Filters for SpareBanks {
    fn set(&mut self, wanted: impl Iterator<Item = Wanted>) {
        let Self { registers, count, first } = *self;
        if count == 0 {
            return;
        }
        let everything = 1 << (first + count);
        let before = registers.read(FA1R);
        // The bits of the plan, and of the other controller.
        let others = before & !(everything | (everything - (1 << first)));
        registers.write(FA1R, before | everything);
        registers.write(FA1R, others | everything);
        let mut end = first;
        wanted.for_each(|wish| end = self.add(&wish, end));
        let active = others | ((1 << end) - (1 << first));
        registers.write(FA1R, active | everything);
        registers.write(FA1R, active);
    }
}

impl SpareBanks {
    /// Writes a wish to the banks, of which those before `end` are taken. Returns the new end. None of them is active.
    // Out of line: wishes come out of a chain of sources, and it would stand in the program once for each.
    #[inline(never)]
    fn add(&self, wish: &Wanted, end: usize) -> usize {
        let registers = self.registers;
        let [id, mask] = wish.bank().registers();
        // Of the banks, that whose mask loses the lowest bits if it accepts this, too.
        let (mut nearest, mut least_lost) = (end, u32::MAX);
        for bank in self.first..end {
            let at = BANK_0 + BANK_STRIDE * bank;
            let lost = registers.read(at + 4) & (registers.read(at) ^ id | !mask);
            if lost < least_lost {
                (nearest, least_lost) = (bank, lost);
            }
        }
        if least_lost == 0 {
            return end;
        }
        let is_room = end < self.first + self.count;
        let at = BANK_0 + BANK_STRIDE * if is_room { end } else { nearest };
        if is_room {
            registers.write(at, id);
        }
        let mask = if is_room { mask } else { registers.read(at + 4) & !least_lost };
        registers.write(at + 4, mask);
        end + usize::from(is_room)
    }
}

fn write_bank(registers: Registers, bank: usize, filter: &FilterBank) {
    let [first, second] = filter.registers();
    registers.write(BANK_0 + BANK_STRIDE * bank, first);
    registers.write(BANK_0 + BANK_STRIDE * bank + 4, second);
}

const OWN_BANKS: u32 = (1 << BANKS) - 1;

// RM0090, bxCAN register map.
pub(crate) const FMR: usize = 0x200;
pub(crate) const FM1R: usize = 0x204;
pub(crate) const FS1R: usize = 0x20C;
pub(crate) const FFA1R: usize = 0x214;
pub(crate) const FA1R: usize = 0x21C;
const BANK_0: usize = 0x240;
const BANK_STRIDE: usize = 8;

const FMR_FINIT: u32 = 1 << 0;

#[cfg(test)]
mod tests;
