//! The log of `candump -l`, one line for each frame:
//!
//! ```text
//! (1700000000.000128) can0 1F5FC004#1122334455667788
//! (1700000000.000300) can0 20000040#0000000000000000
//! ```
//!
//! The second is an error frame as Linux writes it (`linux/can/error.h`): the controller has left the bus.

use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_core::can::ErrorCounters;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};

use crate::bytes::{hex, hex_bytes};
use crate::tap::What;

/// A line of a log.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Entry<'l> {
    /// When, by the clock of whoever recorded it.
    pub stamp: Duration,
    /// Where, such as `can0`.
    pub interface: &'l str,
    /// What.
    pub what: What,
}

impl<'l> Entry<'l> {
    /// A line, with or without its end; `None` if it is no frame of a log.
    pub fn parse(line: &'l [u8]) -> Option<Self> {
        let mut words = std::str::from_utf8(line).ok()?.split_ascii_whitespace();
        let stamp = stamp(words.next()?)?;
        let interface = words.next()?;
        let (id, data) = words.next()?.split_once('#')?;
        // candump can append the direction.
        matches!(words.next(), None | Some("R" | "T")).then_some(())?;
        let raw = hex(id.as_bytes())?;
        let what = match id.len() {
            3 => frame(StandardId::new(u16::try_from(raw).ok()?)?.into(), data)?,
            8 if raw >= ERROR_FRAME => error(raw, data)?,
            8 => frame(ExtendedId::new(raw)?.into(), data)?,
            _ => return None,
        };
        Some(Self { stamp, interface, what })
    }

    /// No line that means something is longer.
    pub const LONGEST: u64 = 256;
}

/// Bytes in hexadecimal digits, at most eight; dots between them are allowed.
fn bytes_of(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|digit| *digit != b'.').collect();
    hex_bytes(&digits)
}

fn frame(id: Id, data: &str) -> Option<What> {
    if data.starts_with('#') {
        // CAN FD.
        return Some(What::Foreign(None));
    }
    if let Some(length) = data.strip_prefix('R') {
        let length = if length.is_empty() { 0 } else { length.parse().ok()? };
        return WireFrame::new_remote(id, length).map(What::from);
    }
    let (bytes, code) = data.split_once('_').map_or((data, None), |(bytes, code)| (bytes, Some(code)));
    let frame = WireFrame::new(id, &bytes_of(bytes)?)?;
    let frame = match code {
        Some(code) => frame.with_length_code(u8::try_from(hex(code.as_bytes())?).ok()?)?,
        None => frame,
    };
    Some(What::from(frame))
}

fn error(raw: u32, data: &str) -> Option<What> {
    let data = bytes_of(data)?;
    Some(match (raw & BUS_OFF, raw & (CONTROLLER | COUNTERS), data.get(6..8)) {
        (BUS_OFF, ..) => What::BusOff,
        (_, 1.., Some(&[transmit, receive])) => What::Errors(ErrorCounters { transmit, receive }),
        _ => What::Foreign(None),
    })
}

/// `(seconds.fraction)`
fn stamp(word: &str) -> Option<Duration> {
    let (seconds, fraction) = word.strip_prefix('(')?.strip_suffix(')')?.split_once('.')?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(seconds) || !digits(fraction) || fraction.len() > 9 {
        return None;
    }
    let nanoseconds = fraction.parse::<u32>().ok()? * 10_u32.pow(9 - fraction.len() as u32);
    // Later ones are no instants of nanoseconds in 64 bits.
    let seconds = seconds.parse().ok().filter(|seconds| *seconds < 1 << 34)?;
    Some(Duration::new(seconds, nanoseconds))
}

/// How a file of pcapng begins, which is another kind of log.
pub const PCAPNG: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];

const ERROR_FRAME: u32 = 1 << 29;
const BUS_OFF: u32 = 0x40;
const CONTROLLER: u32 = 0x04;
const COUNTERS: u32 = 0x200;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_as_candump_writes_them() {
        let what = |line: &str| Entry::parse(line.as_bytes()).map(|entry| entry.what);
        let extended = ExtendedId::new(0x1F5F_C004).unwrap();
        let entry = Entry::parse(b"(1.000128) can0 1F5FC004#1122\n").unwrap();
        assert_eq!((entry.stamp, entry.interface), (Duration::from_micros(1_000_128), "can0"));
        let two_bytes = WireFrame::new(extended, &[0x11, 0x22]).unwrap();
        assert_eq!(entry.what, What::Frame(two_bytes.try_into().unwrap()));
        let standard = WireFrame::new(StandardId::new(0x123).unwrap(), &[]).unwrap();
        assert_eq!(what("(1.0) vcan1 123# R"), Some(What::Foreign(Some(standard))));
        let remote = WireFrame::new_remote(extended, 2).unwrap();
        assert_eq!(what("(1.0) can0 1F5FC004#R2"), Some(What::Foreign(Some(remote))));
        assert_eq!(what("(1.0) can0 20000040#0000000000000000"), Some(What::BusOff));
        let errors = What::Errors(ErrorCounters { transmit: 0x80, receive: 3 });
        assert_eq!(what("(1.0) can0 20000204#0000000000008003"), Some(errors));
        assert_eq!(what("(1.0) can0 20000008#0000080A00000000"), Some(What::Foreign(None)));
        assert_eq!(what("(1.0) can0 123##1AA"), Some(What::Foreign(None)));
        for bad in [
            "",
            "hello",
            "(1) can0 123#",
            "(1.0) can0 123",
            "(1.0) can0 123#1",
            "(1.0) can0 12#",
            "(-1.0) c 123#",
        ] {
            assert_eq!(what(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn any_line_is_taken(line in proptest::collection::vec(any::<u8>(), 0..100)) {
            Entry::parse(&line);
        }

        #[test]
        fn any_line_that_looks_like_one_is_taken(line in "\\([0-9.]{0,30}\\) c [0-9A-F]{3,8}#[#R_0-9A-F]{0,20}") {
            Entry::parse(line.as_bytes());
        }
    }
}
