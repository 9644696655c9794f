//! Decodes defmt logs.

use defmt_decoder::{DecodeError, Encoding, Table};

/// A line of a node's log.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LogLine {
    /// The time that the firmware put before it, as it prints it; empty if it has none.
    pub timestamp: String,
    /// `TRACE`, `DEBUG`, `INFO`, `WARN`, `ERROR`, or empty for a plain line.
    pub level: &'static str,
    /// The message.
    pub message: String,
}

impl core::fmt::Display for LogLine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        for word in [self.timestamp.as_str(), self.level] {
            if !word.is_empty() {
                write!(f, "{word} ")?;
            }
        }
        f.write_str(&self.message)
    }
}

/// Collects bytes until a frame is complete.
#[derive(Debug, Default)]
pub(crate) struct LogDecoder {
    bytes: Vec<u8>,
}

/// Ends a frame in the encoding rzCOBS.
const DELIMITER: u8 = 0;

impl LogDecoder {
    /// Takes bytes of the log and returns the lines that are complete now. A damaged line is returned as
    /// an error line, so nothing is lost in silence.
    pub(crate) fn decode(&mut self, table: &Table, bytes: &[u8]) -> Vec<LogLine> {
        self.bytes.extend_from_slice(bytes);
        match table.encoding() {
            Encoding::Raw => self.decode_raw(table),
            _ => self.decode_delimited(table),
        }
    }

    fn decode_delimited(&mut self, table: &Table) -> Vec<LogLine> {
        let mut lines = Vec::new();
        while let Some(end) = self.bytes.iter().position(|&byte| byte == DELIMITER) {
            let frame: Vec<u8> = self.bytes.drain(..=end).collect();
            let mut decoder = table.new_stream_decoder();
            decoder.received(&frame);
            match decoder.decode() {
                Ok(frame) => lines.push(line(&frame)),
                // An empty frame: the encoder separates frames generously.
                Err(DecodeError::UnexpectedEof) => {}
                Err(DecodeError::Malformed) => lines.push(damaged()),
            }
        }
        lines
    }

    fn decode_raw(&mut self, table: &Table) -> Vec<LogLine> {
        let mut lines = Vec::new();
        loop {
            match table.decode(&self.bytes) {
                Ok((frame, length)) => {
                    lines.push(line(&frame));
                    self.bytes.drain(..length);
                }
                Err(DecodeError::UnexpectedEof) => return lines,
                Err(DecodeError::Malformed) => {
                    // Without delimiters there is no way to find the next frame.
                    self.bytes.clear();
                    lines.push(damaged());
                    return lines;
                }
            }
        }
    }
}

fn line(frame: &defmt_decoder::Frame<'_>) -> LogLine {
    let timestamp = frame.display_timestamp().map(|timestamp| timestamp.to_string()).unwrap_or_default();
    let level = match frame.level().map(|level| level.as_str()) {
        Some("trace") => "TRACE",
        Some("debug") => "DEBUG",
        Some("info") => "INFO",
        Some("warn") => "WARN",
        Some("error") => "ERROR",
        _ => "",
    };
    LogLine { timestamp, level, message: frame.display_message().to_string() }
}

fn damaged() -> LogLine {
    let message = "a log frame is damaged; the buffer of the firmware may have overflowed".to_owned();
    LogLine { timestamp: String::new(), level: "ERROR", message }
}
