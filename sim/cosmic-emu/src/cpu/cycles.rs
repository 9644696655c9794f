//! How long instructions take.
//!
//! The counts are those of the Cortex-M4 technical reference manual, table 3-1 and the floating point
//! table, with the mean where it gives a range. Taken branches are charged by [`super::Pace`]. Flash wait
//! states, which the STM32F4's accelerator hides for the most part, and stalls between neighbouring
//! instructions are not in the model.

/// Cycles of the instruction that starts with these halfwords.
pub(super) const fn cycles(first: u16, second: u16) -> u8 {
    if first < 0xE800 { narrow(first) } else { wide(first, second) }
}

const fn narrow(first: u16) -> u8 {
    match first {
        // Loads: literal, register offset, word, byte, halfword, relative to SP.
        0x4800..=0x4FFF | 0x5600..=0x5FFF | 0x6800..=0x6FFF => 2,
        0x7800..=0x7FFF | 0x8800..=0x8FFF | 0x9800..=0x9FFF => 2,
        // PUSH, POP with LR or PC; LDM, STM.
        0xB400..=0xB5FF | 0xBC00..=0xBDFF => 1 + (first & 0x1FF).count_ones() as u8,
        0xC000..=0xCFFF => 1 + (first & 0xFF).count_ones() as u8,
        _ => 1,
    }
}

const fn wide(first: u16, second: u16) -> u8 {
    if first & 0xFE40 == 0xE800 {
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_follow_the_manual() {
        assert_eq!(cycles(0x2001, 0), 1); // movs
        assert_eq!(cycles(0x6801, 0), 2); // ldr
        assert_eq!(cycles(0x6001, 0), 1); // str
        assert_eq!(cycles(0xB5F0, 0), 6); // push {r4-r7, lr}
        assert_eq!(cycles(0xE92D, 0x47F0), 9); // push.w {r4-r10, lr}
        assert_eq!(cycles(0xFBB0, 0xF0F1), 7); // udiv
        assert_eq!(cycles(0xED9F, 0x0A01), 2); // vldr
    }
}
