//! How long standard and extended frames are at worst.
//!
//! Davis, Burns, Bril, Lukkien 2007, equation 1: `g + 8 s + 13 + floor((g + 8 s - 1) / 4)` bits, where g
//! is 34 for identifiers of 11 bits and 54 for 29 bits, and 13 bits are neither stuffed nor data: CRC
//! delimiter, acknowledgement, end of frame, inter-frame space.

/// Bits of the longest frame with `len` bytes of data.
pub const fn longest_frame_bits(extended: bool, len: u8) -> u64 {
    let stuffable = if extended { 54 } else { 34 } + 8 * len as u64;
    stuffable + 13 + (stuffable - 1) / 4
}

/// The time of `bits` bits, in nanoseconds, rounded up where the bit time is no whole number.
pub const fn bit_times(bits: u64, bits_per_second: u32) -> u64 {
    (bits * 1_000_000_000).div_ceil(bits_per_second as u64)
}

/// Where an identifier stands in arbitration: the smaller wins. Of a standard and an extended identifier
/// that begin alike the standard one wins, since its next bit is dominant.
pub const fn arbitration_key(id: u32, extended: bool) -> u32 {
    if extended { (id >> 18) << 19 | 1 << 18 | id & 0x3FFFF } else { id << 19 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_the_paper() {
        for len in 0..=8 {
            assert_eq!(longest_frame_bits(false, len), 55 + 10 * u64::from(len));
            assert_eq!(longest_frame_bits(true, len), 80 + 10 * u64::from(len));
            // The firmware's own formula is the same.
            let core = cosmic_core::can::longest_frame_bits(usize::from(len));
            assert_eq!(longest_frame_bits(true, len), u64::from(core));
        }
        assert_eq!(bit_times(125, 125_000), 1_000_000);
        assert_eq!(bit_times(1, 333_333), 3001);
    }

    #[test]
    fn standard_beats_extended_with_the_same_start() {
        assert!(arbitration_key(0x100, false) < arbitration_key(0x100 << 18, true));
        assert!(arbitration_key(0x100 << 18 | 5, true) < arbitration_key(0x101, false));
    }
}
