//! Content of variable length.

use super::content::Content;
use crate::protocol::LayoutHash;
use core::fmt;

/// Up to `N` bytes: text, or what is decoded by hand. As a [writer](fmt::Write) it takes text, all of a piece or
/// nothing of it.
///
/// ```
/// use cosmic_core::event_layer::Bytes;
///
/// let line = Bytes::<40>::text(format_args!("{} events", 50)).unwrap();
/// assert_eq!(line.as_str(), Some("50 events"));
/// ```
#[derive(Clone, Copy)]
pub struct Bytes<const N: usize> {
    /// Those behind the length are zero.
    bytes: [u8; N],
    len: u16,
}

impl<const N: usize> Bytes<N> {
    /// None.
    pub const EMPTY: Self = {
        assert!(N <= u16::MAX as usize, "so many bytes are no content");
        Self { bytes: [0; N], len: 0 }
    };

    /// A copy of these; `None` if they are more than `N`.
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut new = Self::EMPTY;
        new.append(bytes)?;
        Some(new)
    }

    /// A text; `None` if it is longer than `N` bytes.
    pub fn text(text: fmt::Arguments<'_>) -> Option<Self> {
        let mut new = Self::EMPTY;
        fmt::Write::write_fmt(&mut new, text).ok()?;
        Some(new)
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }

    /// The text, if they are UTF-8.
    pub fn as_str(&self) -> Option<&str> {
        core::str::from_utf8(self.as_slice()).ok()
    }

    fn append(&mut self, more: &[u8]) -> Option<()> {
        let end = usize::from(self.len).checked_add(more.len())?;
        self.bytes.get_mut(usize::from(self.len)..end)?.copy_from_slice(more);
        self.len = u16::try_from(end).ok()?;
        Some(())
    }
}

impl<const N: usize> Content for Bytes<N> {
    const LEN: usize = N;
    /// Plain bytes: any layout fits.
    const LAYOUT: LayoutHash = LayoutHash::UNSTATED;

    fn encode(&self, bytes: &mut [u8]) {
        for (byte, value) in bytes.iter_mut().zip(self.as_slice()) {
            *byte = *value;
        }
    }

    fn encoded_len(&self) -> usize {
        usize::from(self.len)
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        Self::new(bytes)
    }
}

impl<const N: usize> PartialEq for Bytes<N> {
    fn eq(&self, other: &Self) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl<const N: usize> Eq for Bytes<N> {}

impl<const N: usize> fmt::Write for Bytes<N> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.append(text.as_bytes()).ok_or(fmt::Error)
    }
}

/// As text where it is, as bytes otherwise.
impl<const N: usize> fmt::Debug for Bytes<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.as_str() {
            Some(text) => text.fmt(f),
            None => self.as_slice().fmt(f),
        }
    }
}

#[cfg(feature = "defmt")]
impl<const N: usize> defmt::Format for Bytes<N> {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.as_str() {
            Some(text) => defmt::write!(f, "{=str}", text),
            None => defmt::write!(f, "{=[u8]}", self.as_slice()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::fmt::Write as _;
    use std::format;

    #[test]
    fn what_does_not_fit_leaves_no_part() {
        let mut line = Bytes::<8>::EMPTY;
        line.write_str("12345").unwrap();
        assert!(line.write_str("6789").is_err());
        assert_eq!(line.as_str(), Some("12345"));
        line.write_str("678").unwrap();
        assert_eq!(line.as_slice(), b"12345678");
        assert_eq!(Bytes::<8>::text(format_args!("12345{}", "678")), Some(line));
        assert_eq!(Bytes::<8>::text(format_args!("12345{}", "6789")), None);
        assert_eq!(Bytes::<8>::new(b"123456789"), None);
    }

    #[test]
    fn bytes_have_the_length_they_have() {
        let bytes = Bytes::<4>::new(&[1, 0]).unwrap();
        let mut wire = [9; 2];
        assert_eq!(bytes.encoded_len(), 2);
        bytes.encode(&mut wire);
        assert_eq!(wire, [1, 0]);
        assert_eq!(Bytes::decode(&wire), Some(bytes));
        assert_ne!(Bytes::<4>::new(&[1]), Some(bytes));
    }

    #[test]
    fn what_is_no_text_is_shown_as_bytes() {
        assert_eq!(format!("{:?}", Bytes::<4>::new(b"ab").unwrap()), "\"ab\"");
        assert_eq!(format!("{:?}", Bytes::<4>::new(&[0xFF]).unwrap()), "[255]");
    }
}
