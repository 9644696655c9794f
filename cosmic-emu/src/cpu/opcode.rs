//! What the run loop must know of an instruction before it executes: is it special, how long does it take?
//!
//! The cycle counts are those of the Cortex-M4 technical reference manual, table 3-1 and the floating
//! point table, with the mean where it gives a range. Taken branches are charged by [`super::Pace`].
//! Flash wait states, which the STM32F4's accelerator hides for the most part, and stalls between
//! neighbouring instructions are not in the model.

/// What is special about an instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    /// Nothing.
    Plain,
    /// May change PRIMASK, BASEPRI or FAULTMASK.
    Masks,
    /// IT: this many bytes of instructions follow that are executed as one with it.
    IfThen(u8),
    WaitForInterrupt,
    WaitForEvent,
    SendEvent,
    SupervisorCall,
    Breakpoint(u8),
    /// The start of an endless loop that does nothing: `loop {}`, with or without a NOP. With the
    /// instructions and cycles of one turn, taken branch included.
    Spin { instructions: u8, cycles: u8 },
}

/// An instruction, decoded as far as needed here.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Opcode {
    pub(super) kind: Kind,
    /// Bytes, of an IT block with all of its instructions.
    pub(super) size: u8,
    /// Instructions, more than one for an IT block.
    pub(super) count: u8,
    pub(super) cycles: u8,
}

impl Opcode {
    /// Decodes at the start of `code`, which should hold an IT block whole (2 + 4 * 4 bytes).
    /// What lies outside of `code` reads as zero.
    pub(super) fn decode(code: &[u8]) -> Self {
        let first = halfword(code, 0);
        if is_wide(first) {
            return wide(first, halfword(code, 2));
        }
        let (kind, cycles) = match first {
            BRANCH_TO_ITSELF => (Kind::Spin { instructions: 1, cycles: 3 }, 1),
            NOP if halfword(code, 2) == BRANCH_BACK => (Kind::Spin { instructions: 2, cycles: 4 }, 1),
            0xBF20 => (Kind::WaitForEvent, 1),
            0xBF30 => (Kind::WaitForInterrupt, 1),
            0xBF40 => (Kind::SendEvent, 1),
            0xBF00..=0xBFFF if first & 0xF != 0 => return if_then(first, code),
            0xBE00..=0xBEFF => (Kind::Breakpoint(first as u8), 1),
            0xDF00..=0xDFFF => (Kind::SupervisorCall, 1),
            0xB660..=0xB67F => (Kind::Masks, 1),
            // Loads: literal, register offset, word, byte, halfword, relative to SP.
            0x4800..=0x4FFF | 0x5600..=0x5FFF | 0x6800..=0x6FFF => (Kind::Plain, 2),
            0x7800..=0x7FFF | 0x8800..=0x8FFF | 0x9800..=0x9FFF => (Kind::Plain, 2),
            // PUSH, POP with LR or PC; LDM, STM.
            0xB400..=0xB5FF | 0xBC00..=0xBDFF => (Kind::Plain, 1 + (first & 0x1FF).count_ones() as u8),
            0xC000..=0xCFFF => (Kind::Plain, 1 + (first & 0xFF).count_ones() as u8),
            _ => (Kind::Plain, 1),
        };
        Self { kind, size: 2, count: 1, cycles }
    }
}

const NOP: u16 = 0xBF00;
const BRANCH_TO_ITSELF: u16 = 0xE7FE;
/// To the halfword before it.
const BRANCH_BACK: u16 = 0xE7FD;

fn halfword(code: &[u8], at: usize) -> u16 {
    match code.get(at..at + 2) {
        Some(&[low, high]) => u16::from_le_bytes([low, high]),
        _ => 0,
    }
}

fn is_wide(first: u16) -> bool {
    first >= 0xE800
}

/// The mask's lowest set bit tells the length of an IT block (ARMv7-M ARM, A7.7.37).
fn if_then(first: u16, code: &[u8]) -> Opcode {
    let count = 4 - (first & 0xF).trailing_zeros() as u8;
    let mut body = 0;
    for _ in 0..count {
        body += if is_wide(halfword(code, 2 + body)) { 4 } else { 2 };
    }
    Opcode { kind: Kind::IfThen(body as u8), size: 2 + body as u8, count: 1 + count, cycles: 1 + count }
}

fn wide(first: u16, second: u16) -> Opcode {
    let is_msr = first & 0xFFE0 == 0xF380 && second & 0xD000 == 0x8000;
    let cycles = if first & 0xFE40 == 0xE800 {
        1 + second.count_ones() as u8 // LDM, STM
    } else if first & 0xFE40 == 0xE840 {
        if first & 0x0120 == 0 { 2 } else { 3 } // exclusive, table branch; dual
    } else if first & 0xFE10 == 0xF810 {
        2 // loads
    } else if first & 0xFFD0 == 0xFB90 {
        7 // SDIV, UDIV: 2 to 12
    } else if first & 0xFE00 == 0xEC00 {
        1 + if first & 0x0120 == 0x0100 { 1 } else { second as u8 } // VLDR, VSTR; VLDM, VSTM
    } else if first & 0xFFB0 == 0xEE80 || (first & 0xFFBF == 0xEEB1 && second & 0x00D0 == 0x00C0) {
        14 // VDIV, VSQRT
    } else {
        1
    };
    Opcode { kind: if is_msr { Kind::Masks } else { Kind::Plain }, size: 4, count: 1, cycles }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(halfwords: &[u16]) -> Opcode {
        let bytes: Vec<u8> = halfwords.iter().flat_map(|h| h.to_le_bytes()).collect();
        Opcode::decode(&bytes)
    }

    #[test]
    fn special_instructions_are_found() {
        assert_eq!(decode(&[0xBF30]).kind, Kind::WaitForInterrupt);
        assert_eq!(decode(&[0xBE2A]).kind, Kind::Breakpoint(0x2A));
        assert_eq!(decode(&[0xB662]).kind, Kind::Masks); // cpsie i
        assert_eq!(decode(&[0xF380, 0x8811]).kind, Kind::Masks); // msr basepri, r0
        assert_eq!(decode(&[0xF3EF, 0x8011]).kind, Kind::Plain); // mrs r0, basepri
        assert_eq!(decode(&[0xBF00]).kind, Kind::Plain); // nop
    }

    #[test]
    fn an_if_then_block_is_measured() {
        // ite eq; moveq r0, #1; movne.w r0, #2
        let block = decode(&[0xBF0C, 0x2001, 0xF04F, 0x0002]);
        assert_eq!(block.kind, Kind::IfThen(6));
        assert_eq!((block.count, block.cycles), (3, 3));
    }

    #[test]
    fn cycles_follow_the_manual() {
        assert_eq!(decode(&[0x2001]).cycles, 1); // movs
        assert_eq!(decode(&[0x6801]).cycles, 2); // ldr
        assert_eq!(decode(&[0x6001]).cycles, 1); // str
        assert_eq!(decode(&[0xB5F0]).cycles, 6); // push {r4-r7, lr}
        assert_eq!(decode(&[0xE92D, 0x47F0]).cycles, 9); // push.w {r4-r10, lr}
        assert_eq!(decode(&[0xFBB0, 0xF0F1]).cycles, 7); // udiv
    }
}
