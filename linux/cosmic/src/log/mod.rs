//! Logs: what was recorded of a segment, as candump writes it or as pcapng.

mod candump;
pub(crate) use candump::bytes_of;
mod pcapng;

use std::fs::File;
use std::io::{self, BufRead as _, BufReader, Read};
use std::path::Path;
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_core::can::Frame;
use cosmic_linux::What;

use crate::failure::Failure;

/// Something that was recorded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Entry {
    /// When, by the clock of whoever recorded it.
    pub(crate) stamp: Duration,
    /// What.
    pub(crate) what: What,
}

/// Reads a log, entry by entry.
pub(crate) enum Reader {
    Candump(candump::Reader<Box<dyn io::BufRead + Send>>),
    Pcapng(Box<pcapng::Reader>),
}

impl Reader {
    /// Opens a log; `-` is standard input. What it is, its first bytes say.
    pub(crate) fn open(path: &Path) -> Result<Self, Failure> {
        let name = path.display().to_string();
        let source: Box<dyn Read + Send> = if name == "-" {
            Box::new(io::stdin())
        } else {
            let failed =
                |error| Failure::input(format!("{name} cannot be opened: {error}; give the path of a log"));
            Box::new(File::open(path).map_err(failed)?)
        };
        let mut source = BufReader::with_capacity(1 << 16, source);
        let start =
            source.fill_buf().map_err(|error| Failure::input(format!("{name} cannot be read: {error}")))?;
        if start.starts_with(&pcapng::MAGIC) {
            return pcapng::Reader::new(Box::new(source), name).map(Box::new).map(Self::Pcapng);
        }
        Ok(Self::Candump(candump::Reader::new(Box::new(source), name)))
    }

    /// The next entry; `None` at the end.
    pub(crate) fn next(&mut self) -> Option<Result<Entry, Failure>> {
        match self {
            Self::Candump(reader) => reader.next(),
            Self::Pcapng(reader) => reader.next(),
        }
    }
}

/// Writes a log.
pub(crate) enum Writer {
    Candump(candump::Writer<Box<dyn io::Write>>),
    Pcapng(pcapng::Writer<Box<dyn io::Write>>),
}

impl Writer {
    /// Makes a log: pcapng if the name ends in `.pcapng`, else as candump does; `-` is standard output.
    pub(crate) fn create(path: &Path) -> Result<Self, Failure> {
        let name = path.display();
        let out: Box<dyn io::Write> = if path.as_os_str() == "-" {
            Box::new(io::stdout())
        } else {
            let failed =
                |error| Failure::input(format!("{name} cannot be written: {error}; choose another place"));
            Box::new(File::create(path).map_err(failed)?)
        };
        let out: Box<dyn io::Write> = Box::new(io::BufWriter::with_capacity(1 << 16, out));
        if path.extension().is_some_and(|extension| extension == "pcapng") {
            return pcapng::Writer::new(out).map(Self::Pcapng).map_err(written);
        }
        Ok(Self::Candump(candump::Writer::new(out)))
    }

    pub(crate) fn write(&mut self, stamp: Duration, frame: &WireFrame) -> Result<(), Failure> {
        match self {
            Self::Candump(writer) => writer.write(stamp, frame),
            Self::Pcapng(writer) => writer.write(stamp, frame),
        }
        .map_err(written)
    }

    /// All that was written is in the file.
    pub(crate) fn flush(&mut self) -> Result<(), Failure> {
        match self {
            Self::Candump(writer) => writer.flush(),
            Self::Pcapng(writer) => writer.flush(),
        }
        .map_err(written)
    }
}

fn written(error: io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::closed(),
        _ => {
            Failure::input(format!("the log cannot be written: {error}; make room, or choose another place"))
        }
    }
}

/// What a frame of any kind is to a listener.
pub(crate) fn heard(frame: WireFrame) -> What {
    Frame::try_from(frame).map_or(What::Foreign(Some(frame)), What::Frame)
}
