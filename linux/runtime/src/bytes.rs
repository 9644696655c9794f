//! Bytes from outside, cut into lines or records: bounded, whatever comes.

use std::collections::VecDeque;

/// Cuts a stream at a byte. A piece that is longer than `MAX` is dropped, and counted as one.
#[derive(Debug, Default)]
pub(crate) struct Splitter<const MAX: usize> {
    piece: Vec<u8>,
    too_long: bool,
    pieces: VecDeque<Option<Vec<u8>>>,
}

impl<const MAX: usize> Splitter<MAX> {
    /// Takes what has arrived. `ends` says which bytes end a piece; they belong to it if `keeps` says so.
    pub(crate) fn feed(&mut self, bytes: &[u8], ends: impl Fn(u8) -> bool, keeps: bool) {
        for &byte in bytes {
            let end = ends(byte);
            if (!end || keeps) && !self.too_long {
                self.piece.push(byte);
            }
            if end {
                let piece = std::mem::take(&mut self.piece);
                self.pieces.push_back((!std::mem::take(&mut self.too_long)).then_some(piece));
            } else if self.piece.len() > MAX {
                self.piece.clear();
                self.too_long = true;
            }
        }
    }

    /// The next piece; `Some(None)` for one that was too long.
    pub(crate) fn next(&mut self) -> Option<Option<Vec<u8>>> {
        self.pieces.pop_front()
    }
}

/// The number that these hexadecimal digits are; nothing else than digits, at least one, at most eight.
pub(crate) fn hex(digits: &[u8]) -> Option<u32> {
    if digits.is_empty() || digits.len() > 8 {
        return None;
    }
    digits.iter().try_fold(0_u32, |number, digit| Some(number << 4 | char::from(*digit).to_digit(16)?))
}

/// The bytes that these pairs of digits are, at most eight.
pub(crate) fn hex_bytes(digits: &[u8]) -> Option<Vec<u8>> {
    if !digits.len().is_multiple_of(2) || digits.len() > 16 {
        return None;
    }
    digits.chunks(2).map(|pair| hex(pair).and_then(|byte| u8::try_from(byte).ok())).collect()
}

/// What a line says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Line {
    /// A frame of COSMIC's kind.
    Frame(cosmic_core::can::Frame),
    /// A frame of another kind.
    Foreign,
    /// Something that is no frame, and need not be one.
    Other,
    /// Nothing that means anything.
    Malformed,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_is_cut_however_it_arrives() {
        let mut splitter = Splitter::<4>::default();
        splitter.feed(b"ab", |byte| byte == b';', false);
        splitter.feed(b"c;;abcdef;x;y", |byte| byte == b';', false);
        let pieces: Vec<_> = std::iter::from_fn(|| splitter.next()).collect();
        assert_eq!(pieces, [Some(b"abc".to_vec()), Some(vec![]), None, Some(b"x".to_vec())]);
    }

    #[test]
    fn digits_are_read_strictly() {
        assert_eq!(hex(b"1F5FC004"), Some(0x1F5F_C004));
        assert_eq!((hex(b""), hex(b"123456789"), hex(b"+1"), hex(b"g")), (None, None, None, None));
        assert_eq!(hex_bytes(b"00fF"), Some(vec![0, 255]));
        assert_eq!((hex_bytes(b"123"), hex_bytes(b"1 23")), (None, None));
    }
}
