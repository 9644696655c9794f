//! Where a log is written to. When there is no room left, the log ends behind its last whole entry.

use std::fs::File;
use std::io::{self, Write};

pub(crate) struct Sink {
    out: Out,
    buffer: Vec<u8>,
    /// Where entries end in the buffer.
    ends: Vec<usize>,
    /// Bytes that are in the file.
    written: u64,
}

enum Out {
    File(File),
    Standard(io::Stdout),
}

impl Sink {
    pub(crate) fn file(file: File) -> Self {
        Self::new(Out::File(file))
    }

    pub(crate) fn standard() -> Self {
        Self::new(Out::Standard(io::stdout()))
    }

    fn new(out: Out) -> Self {
        Self { out, buffer: Vec::with_capacity(2 * ENOUGH), ends: Vec::new(), written: 0 }
    }

    /// What was written until now is whole.
    ///
    /// # Errors
    /// As [`Write::flush`], if it is time for that.
    pub(crate) fn end_entry(&mut self) -> io::Result<()> {
        self.ends.push(self.buffer.len());
        if self.buffer.len() < ENOUGH { Ok(()) } else { self.flush() }
    }

    /// Cuts off what is of an entry that is not whole.
    fn cut(&self, file: &File) {
        let Ok(length) = file.metadata().map(|data| data.len()) else { return };
        let begun = length.saturating_sub(self.written);
        let whole = self.ends.iter().rev().find(|end| **end as u64 <= begun).copied().unwrap_or(0);
        // A device has no length; there is nothing to be cut.
        let _ = file.set_len(self.written + whole as u64);
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.buffer.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    /// Behind an error nothing waits to be written any more.
    fn flush(&mut self) -> io::Result<()> {
        let result = match &mut self.out {
            Out::File(file) => file.write_all(&self.buffer),
            Out::Standard(out) => out.write_all(&self.buffer).and_then(|()| out.flush()),
        };
        match (&result, &self.out) {
            (Err(_), Out::File(file)) => self.cut(file),
            _ => self.written += self.buffer.len() as u64,
        }
        self.buffer.clear();
        self.ends.clear();
        result
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        // Who wants to know has flushed.
        let _ = self.flush();
    }
}

/// Bytes that wait until they are written.
const ENOUGH: usize = 1 << 16;
