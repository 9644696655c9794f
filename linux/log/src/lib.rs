//! Logs: what was recorded of a segment, as candump writes it or as pcapng.
//!
//! A [`Reader`] finds out by the first bytes which of them it is; a [`Writer`] goes by the name of the file. What is read
//! takes bounded memory, whatever the file holds. A [`Heard`] log is one that a monitor explains.

mod candump;
mod heard;
mod pcapng;
mod sink;

pub use heard::{Heard, LogTime, feed, learn_bindings};

use std::fmt;
use std::fs::File;
use std::io::{self, BufRead as _, BufReader, Read};
use std::path::Path;
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_linux::What;
use sink::Sink;

/// Something that was recorded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Entry {
    /// When, by the clock of whoever recorded it.
    pub stamp: Duration,
    /// What.
    pub what: What,
}

/// Why a log cannot be read or written: one line, with what to do.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LogError {
    text: String,
    is_closed: bool,
}

impl LogError {
    fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), is_closed: false }
    }

    /// Returns whether whoever read what is written has closed it: no fault of anybody's.
    pub const fn is_closed(&self) -> bool {
        self.is_closed
    }
}

impl fmt::Display for LogError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for LogError {}

/// Reads a log, entry by entry.
pub struct Reader(ReaderKind);

enum ReaderKind {
    Candump(candump::Reader<Box<dyn io::BufRead + Send>>),
    Pcapng(Box<pcapng::Reader>),
}

impl Reader {
    /// Opens a log; `-` is standard input. What it is, its first bytes say.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let name = path.display().to_string();
        let source: Box<dyn Read + Send> = if name == "-" {
            Box::new(io::stdin())
        } else {
            let failed =
                |error| LogError::new(format!("{name} cannot be opened: {error}; give the path of a log"));
            Box::new(File::open(path).map_err(failed)?)
        };
        let mut source = BufReader::with_capacity(1 << 16, source);
        let start =
            source.fill_buf().map_err(|error| LogError::new(format!("{name} cannot be read: {error}")))?;
        if start.starts_with(&cosmic_linux::candump::PCAPNG) {
            return pcapng::Reader::new(Box::new(source), name)
                .map(|reader| Self(ReaderKind::Pcapng(Box::new(reader))));
        }
        Ok(Self(ReaderKind::Candump(candump::Reader::new(Box::new(source), name))))
    }
}

impl Iterator for Reader {
    type Item = Result<Entry, LogError>;

    /// The next entry. What follows an error may mean nothing.
    fn next(&mut self) -> Option<Result<Entry, LogError>> {
        match &mut self.0 {
            ReaderKind::Candump(reader) => reader.next(),
            ReaderKind::Pcapng(reader) => reader.next(),
        }
    }
}

/// Writes a log.
pub struct Writer(WriterKind);

enum WriterKind {
    Candump(candump::Writer<Sink>),
    Pcapng(pcapng::Writer<Sink>),
}

impl Writer {
    /// Makes a log: pcapng if the name ends in `.pcapng`, else as candump does; `-` is standard output.
    ///
    /// # Errors
    /// It cannot be written there.
    pub fn create(path: &Path) -> Result<Self, LogError> {
        let name = path.display();
        let out = if path.as_os_str() == "-" {
            Sink::standard()
        } else {
            let failed =
                |error| LogError::new(format!("{name} cannot be written: {error}; choose another place"));
            Sink::file(File::create(path).map_err(failed)?)
        };
        if path.extension().is_some_and(|extension| extension == "pcapng") {
            let mut writer = pcapng::Writer::new(out).map_err(written)?;
            writer.out.end_entry().map_err(written)?;
            return Ok(Self(WriterKind::Pcapng(writer)));
        }
        Ok(Self(WriterKind::Candump(candump::Writer::new(out))))
    }

    /// Writes a frame that crossed the bus then.
    ///
    /// # Errors
    /// There is no room, or nobody who reads it. What was written before is a whole log then.
    pub fn write(&mut self, stamp: Duration, frame: &WireFrame) -> Result<(), LogError> {
        match &mut self.0 {
            WriterKind::Candump(writer) => writer.write(stamp, frame).and_then(|()| writer.out.end_entry()),
            WriterKind::Pcapng(writer) => writer.write(stamp, frame).and_then(|()| writer.out.end_entry()),
        }
        .map_err(written)
    }

    /// Returns when all that was written is in the file.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn flush(&mut self) -> Result<(), LogError> {
        match &mut self.0 {
            WriterKind::Candump(writer) => writer.flush(),
            WriterKind::Pcapng(writer) => writer.flush(),
        }
        .map_err(written)
    }
}

fn written(error: io::Error) -> LogError {
    match error.kind() {
        io::ErrorKind::BrokenPipe => {
            LogError { text: "nobody reads what is written any more".to_owned(), is_closed: true }
        }
        _ => LogError::new(format!(
            "the log cannot be written: {error}; what was written before is whole; make room, or choose another place"
        )),
    }
}
