//! The log of `candump -l`, one line for each frame:
//!
//! ```text
//! (1700000000.000128) can0 1F5FC004#1122334455667788
//! (1700000000.000300) can0 20000040#0000000000000000
//! ```
//!
//! The second is an error frame as Linux writes it (`linux/can/error.h`): the controller has left the bus.

use std::io::{self, BufRead, Read as _, Write};
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_core::can::ErrorCounters;
use cosmic_linux::What;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};

use super::{Entry, LogError, heard};

pub(crate) struct Reader<R> {
    source: R,
    name: String,
    line: u64,
    buffer: Vec<u8>,
}

impl<R: BufRead> Reader<R> {
    pub(crate) fn new(source: R, name: String) -> Self {
        Self { source, name, line: 0, buffer: Vec::new() }
    }

    pub(crate) fn next(&mut self) -> Option<Result<Entry, LogError>> {
        loop {
            self.buffer.clear();
            self.line += 1;
            // A longer line is no frame, and is not read into memory whole.
            let read = (&mut self.source).take(LONGEST_LINE).read_until(b'\n', &mut self.buffer);
            match read {
                Ok(0) => return None,
                Ok(_) => {}
                Err(error) => {
                    return Some(Err(LogError::new(format!("{} cannot be read: {error}", self.name))));
                }
            }
            let line = self.buffer.trim_ascii();
            if line.is_empty() {
                continue;
            }
            let entry = std::str::from_utf8(line).ok().and_then(parse);
            return Some(entry.ok_or_else(|| {
                LogError::new(format!(
                    "{} line {}: this is no frame of a log; give a log as `candump -l` writes it, or pcapng",
                    self.name, self.line
                ))
            }));
        }
    }
}

pub(super) fn parse(line: &str) -> Option<Entry> {
    let mut words = line.split_ascii_whitespace();
    let stamp = stamp(words.next()?)?;
    let _interface = words.next()?;
    let (id, data) = words.next()?.split_once('#')?;
    // candump can append the direction.
    matches!(words.next(), None | Some("R" | "T")).then_some(())?;
    let raw = hexadecimal(id)?;
    let id = match id.len() {
        3 => Id::Standard(StandardId::new(u16::try_from(raw).ok()?)?),
        8 if raw >= ERROR_FRAME => return Some(Entry { stamp, what: error(raw, data)? }),
        8 => Id::Extended(ExtendedId::new(raw)?),
        _ => return None,
    };
    Some(Entry { stamp, what: frame(id, data)? })
}

fn frame(id: Id, data: &str) -> Option<What> {
    if data.starts_with('#') {
        // CAN FD.
        return Some(What::Foreign(None));
    }
    if let Some(length) = data.strip_prefix('R') {
        let length = if length.is_empty() { 0 } else { length.parse().ok()? };
        return WireFrame::new_remote(id, length).map(heard);
    }
    let (bytes, code) = data.split_once('_').map_or((data, None), |(bytes, code)| (bytes, Some(code)));
    let frame = WireFrame::new(id, &bytes_of(bytes)?)?;
    let frame = match code {
        Some(code) => frame.with_length_code(u8::try_from(hexadecimal(code)?).ok()?)?,
        None => frame,
    };
    Some(heard(frame))
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

fn hexadecimal(text: &str) -> Option<u32> {
    let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    digits.then(|| u32::from_str_radix(text, 16).ok()).flatten()
}

/// Bytes in hexadecimal digits, at most eight; dots between them are allowed.
pub fn bytes_of(text: &str) -> Option<Vec<u8>> {
    let text: String = text.chars().filter(|character| *character != '.').collect();
    let pair = |pair: &[u8]| Some(hexadecimal(std::str::from_utf8(pair).ok()?)? as u8);
    let fits = text.len().is_multiple_of(2) && text.len() <= 16;
    fits.then(|| text.as_bytes().chunks(2).map(pair).collect()).flatten()
}

pub(crate) struct Writer<W> {
    out: W,
}

impl<W: Write> Writer<W> {
    pub(crate) fn new(out: W) -> Self {
        Self { out }
    }

    pub(crate) fn write(&mut self, stamp: Duration, frame: &WireFrame) -> io::Result<()> {
        write!(self.out, "({}.{:06}) can0 ", stamp.as_secs(), stamp.subsec_micros())?;
        let width = if frame.is_extended() { 8 } else { 3 };
        write!(self.out, "{:0width$X}#", frame.arbitration().raw_id())?;
        if frame.is_remote_frame() {
            return writeln!(self.out, "R{}", frame.dlc());
        }
        for byte in frame.data() {
            write!(self.out, "{byte:02X}")?;
        }
        match frame.length_code() {
            0..=8 => writeln!(self.out),
            code => writeln!(self.out, "_{code:X}"),
        }
    }

    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

const LONGEST_LINE: u64 = 256;
const ERROR_FRAME: u32 = 1 << 29;
const BUS_OFF: u32 = 0x40;
const CONTROLLER: u32 = 0x04;
const COUNTERS: u32 = 0x200;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame_of(id: impl Into<Id>, data: &[u8]) -> WireFrame {
        WireFrame::new(id, data).unwrap()
    }

    #[test]
    fn lines_as_candump_writes_them() {
        let what = |line: &str| parse(line).map(|entry| entry.what);
        let extended = ExtendedId::new(0x1F5F_C004).unwrap();
        let entry = parse("(1.000128) can0 1F5FC004#1122").unwrap();
        assert_eq!(entry.stamp, Duration::from_micros(1_000_128));
        assert_eq!(entry.what, heard(frame_of(extended, &[0x11, 0x22])));
        let standard = frame_of(StandardId::new(0x123).unwrap(), &[]);
        assert_eq!(what("(1.0) vcan1 123# R"), Some(What::Foreign(Some(standard))));
        let remote = WireFrame::new_remote(extended, 2).unwrap();
        assert_eq!(what("(1.0) can0 1F5FC004#R2"), Some(What::Foreign(Some(remote))));
        assert_eq!(what("(1.0) can0 20000040#0000000000000000"), Some(What::BusOff));
        let errors = What::Errors(ErrorCounters { transmit: 0x80, receive: 3 });
        assert_eq!(what("(1.0) can0 20000204#0000000000008003"), Some(errors));
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
            assert_eq!(parse(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            raw in 0_u32..1 << 29, standard: bool, remote: bool, bytes in proptest::collection::vec(any::<u8>(), 0..=8),
            code in 9_u8..=15, us in 0_u64..1 << 50,
        ) {
            let id = if standard { Id::Standard(StandardId::new(raw as u16 & 0x7FF).unwrap()) } else { Id::Extended(ExtendedId::new(raw).unwrap()) };
            let frame = if remote { WireFrame::new_remote(id, bytes.len()).unwrap() } else { frame_of(id, &bytes) };
            // Codes above eight are of eight bytes.
            let frame = if remote { frame } else { frame.with_length_code(code).unwrap_or(frame) };
            let mut writer = Writer::new(Vec::new());
            writer.write(Duration::from_micros(us), &frame).unwrap();
            let mut reader = Reader::new(&writer.out[..], "log".to_owned());
            let entry = reader.next().unwrap().ok().unwrap();
            prop_assert_eq!(entry, Entry { stamp: Duration::from_micros(us), what: heard(frame) });
            prop_assert!(reader.next().is_none());
        }

        #[test]
        fn any_bytes_are_taken(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut reader = Reader::new(&bytes[..], "log".to_owned());
            while let Some(Ok(_)) = reader.next() {}
        }

        #[test]
        fn any_line_that_looks_like_one_is_taken(line in "\\([0-9.]{0,24}\\) c [0-9A-F]{3,8}#[#R_0-9A-F]{0,20}") {
            parse(&line);
        }
    }
}
