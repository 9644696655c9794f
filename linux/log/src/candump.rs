//! The log of `candump -l`: see [`cosmic_linux::candump`].

use std::io::{self, BufRead, Read as _, Write};
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_linux::candump;
use embedded_can::Frame as _;

use super::{Entry, LogError};

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
            let read = (&mut self.source).take(candump::Entry::LONGEST).read_until(b'\n', &mut self.buffer);
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
            let entry =
                candump::Entry::parse(line).map(|entry| Entry { stamp: entry.stamp, what: entry.what });
            return Some(entry.ok_or_else(|| {
                LogError::new(format!(
                    "{} line {}: this is no frame of a log; give a log as `candump -l` writes it, or pcapng",
                    self.name, self.line
                ))
            }));
        }
    }
}

pub(crate) struct Writer<W> {
    pub(super) out: W,
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

#[cfg(test)]
mod tests {
    use super::*;
    use cosmic_linux::What;
    use embedded_can::{ExtendedId, Id, StandardId};
    use proptest::prelude::*;

    fn frame_of(id: impl Into<Id>, data: &[u8]) -> WireFrame {
        WireFrame::new(id, data).unwrap()
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
            prop_assert_eq!(entry, Entry { stamp: Duration::from_micros(us), what: What::from(frame) });
            prop_assert!(reader.next().is_none());
        }

        #[test]
        fn any_bytes_are_taken(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut reader = Reader::new(&bytes[..], "log".to_owned());
            while let Some(Ok(_)) = reader.next() {}
        }
    }
}
