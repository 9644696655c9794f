//! As much of the Thumb instruction set as the call graph needs (ARMv7-M ARM, A5 and A7.7).

/// What an instruction does, as far as it matters here.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    /// A call, of an address.
    Call(u32),
    /// A jump, taken or not.
    Jump(u32),
    /// A call by a register.
    IndirectCall,
    /// It ends the program.
    Trap,
    /// The lower half of a register is set, and the upper is cleared.
    Low(u32, u16),
    /// The upper half of a register is set.
    High(u32, u16),
    /// The stack grows by so many bytes.
    Grow(u32),
    /// The stack grows by the value of a register.
    GrowBy(u32),
    /// Anything else.
    Other,
}

/// An instruction, and its length in bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Instruction {
    pub(super) kind: Kind,
    pub(super) len: u32,
}

impl Instruction {
    /// The one that begins with these halfwords, at `pc`.
    pub(super) fn decode(pc: u32, first: u16, second: u16) -> Self {
        if first < 0xE800 {
            Self { kind: narrow(pc, first), len: 2 }
        } else {
            Self { kind: wide(pc, first, second), len: 4 }
        }
    }
}

fn narrow(pc: u32, word: u16) -> Kind {
    let bits = u32::from(word);
    match word {
        0xDE00..=0xDEFF => Kind::Trap,
        0xD000..=0xDDFF => Kind::Jump(relative(pc, (bits & 0xFF) << 1, 9)),
        0xE000..=0xE7FF => Kind::Jump(relative(pc, (bits & 0x7FF) << 1, 12)),
        0xB400..=0xB5FF => Kind::Grow(4 * (bits & 0x1FF).count_ones()),
        0xB080..=0xB0FF => Kind::Grow(4 * (bits & 0x7F)),
        _ if word & 0xFF87 == 0x4780 => Kind::IndirectCall,
        _ if word & 0xF500 == 0xB100 => {
            let offset = (bits >> 9 & 1) << 6 | (bits >> 3 & 0x1F) << 1;
            Kind::Jump(pc.wrapping_add(4 + offset))
        }
        // BX by anything but LR is a call that does not come back here.
        _ if word & 0xFF87 == 0x4700 && word != 0x4770 => Kind::IndirectCall,
        _ => Kind::Other,
    }
}

fn wide(pc: u32, first: u16, second: u16) -> Kind {
    let (a, b) = (u32::from(first), u32::from(second));
    if first & 0xFFF0 == 0xF7F0 && second & 0xF000 == 0xA000 {
        return Kind::Trap;
    }
    if first & 0xF800 == 0xF000 && second & 0x8000 != 0 {
        return branch(pc, a, b);
    }
    let register = b >> 8 & 0xF;
    let immediate = || (a & 0xF) << 12 | (a >> 10 & 1) << 11 | (b >> 12 & 7) << 8 | b & 0xFF;
    match first {
        _ if first & 0xFBF0 == 0xF240 => Kind::Low(register, immediate() as u16),
        _ if first & 0xFBF0 == 0xF2C0 => Kind::High(register, immediate() as u16),
        // STMDB SP!; STRD and STR before SP; VPUSH.
        0xE92D => Kind::Grow(4 * b.count_ones()),
        0xE96D => Kind::Grow(4 * (b & 0xFF)),
        0xF84D if b & 0xF00 == 0xD00 => Kind::Grow(b & 0xFF),
        _ if first & 0xFFBF == 0xED2D => Kind::Grow(4 * (b & 0xFF)),
        // SUB from SP to SP.
        _ if first & 0xFBFF == 0xF2AD && register == SP => Kind::Grow(immediate() & 0xFFF),
        _ if first & 0xFBFF == 0xF1AD && register == SP => Kind::Grow(expand(immediate() & 0xFFF)),
        0xEBAD if register == SP => Kind::GrowBy(b & 0xF),
        _ => Kind::Other,
    }
}

/// BL, B.W and conditional B.W.
fn branch(pc: u32, a: u32, b: u32) -> Kind {
    let sign = a >> 10 & 1;
    let (j1, j2) = (b >> 13 & 1, b >> 11 & 1);
    let far = || {
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        let offset = sign << 24 | i1 << 23 | i2 << 22 | (a & 0x3FF) << 12 | (b & 0x7FF) << 1;
        relative(pc, offset, 25)
    };
    match b & 0xD000 {
        0xD000 => Kind::Call(far()),
        0x9000 => Kind::Jump(far()),
        0x8000 if a >> 7 & 7 != 7 => {
            let offset = sign << 20 | j2 << 19 | j1 << 18 | (a & 0x3F) << 12 | (b & 0x7FF) << 1;
            Kind::Jump(relative(pc, offset, 21))
        }
        _ => Kind::Other,
    }
}

/// The address that an offset of so many bits leads to.
fn relative(pc: u32, offset: u32, bits: u32) -> u32 {
    let extended = (offset << (32 - bits)).cast_signed() >> (32 - bits);
    pc.wrapping_add(4).wrapping_add_signed(extended)
}

/// ThumbExpandImm (A5.3.2).
fn expand(immediate: u32) -> u32 {
    let byte = immediate & 0xFF;
    match immediate >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (byte | 0x80).rotate_right(immediate >> 7),
    }
}

const SP: u32 = 13;

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodings as an assembler gives them.
    #[test]
    fn instructions_are_read_as_an_assembler_writes_them() {
        let kind = |first, second| Instruction::decode(0x0800_1000, first, second).kind;
        assert_eq!(kind(0xF000, 0xF802), Kind::Call(0x0800_1008)); // bl .+8
        assert_eq!(kind(0xF7FF, 0xFFFE), Kind::Call(0x0800_1000)); // bl .
        assert_eq!(kind(0xF000, 0xB802), Kind::Jump(0x0800_1008)); // b.w .+8
        assert_eq!(kind(0xF43F, 0xAFFE), Kind::Jump(0x0800_1000)); // beq.w .
        assert_eq!(kind(0xE7FE, 0), Kind::Jump(0x0800_1000)); // b .
        assert_eq!(kind(0xD0FE, 0), Kind::Jump(0x0800_1000)); // beq .
        assert_eq!(kind(0xB110, 0), Kind::Jump(0x0800_1008)); // cbz r0, .+8
        assert_eq!(kind(0xDEFE, 0), Kind::Trap); // udf #254
        assert_eq!(kind(0x4798, 0), Kind::IndirectCall); // blx r3
        assert_eq!(kind(0x4770, 0), Kind::Other); // bx lr
        assert_eq!(kind(0xF241, 0x2034), Kind::Low(0, 0x1234)); // movw r0, #0x1234
        assert_eq!(kind(0xF6C0, 0x0000), Kind::High(0, 0x0800)); // movt r0, #0x800
        assert_eq!(kind(0xB5F0, 0), Kind::Grow(20)); // push {r4-r7, lr}
        assert_eq!(kind(0xE92D, 0x4FF0), Kind::Grow(36)); // push.w {r4-r11, lr}
        assert_eq!(kind(0xF84D, 0xBD04), Kind::Grow(4)); // push.w {r11}
        assert_eq!(kind(0xED2D, 0x8B04), Kind::Grow(16)); // vpush {d8, d9}
        assert_eq!(kind(0xB084, 0), Kind::Grow(16)); // sub sp, #16
        assert_eq!(kind(0xF5AD, 0x7D00), Kind::Grow(512)); // sub.w sp, sp, #512
        assert_eq!(kind(0xF2AD, 0x4D04), Kind::Grow(0x404)); // subw sp, sp, #0x404
        assert_eq!(kind(0xEBAD, 0x0D04), Kind::GrowBy(4)); // sub.w sp, sp, r4
    }
}
