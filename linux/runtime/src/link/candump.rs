//! A log of `candump -l`, replayed: what it holds arrives at the node as it did then.
//!
//! ```text
//! (1.000128) can0 1F5FC004#1122334455667788
//! ```
//!
//! The first frame arrives at once, the others at the distances that the log states; a log whose time goes back is
//! replayed on without a pause. What the node sends goes nowhere, and is counted ([`LinkCounters::unsent`]). At its end
//! the link stays quiet.
//!
//! [`LinkCounters::unsent`]: super::LinkCounters::unsent

use std::path::PathBuf;
use std::time::Duration;

use cosmic_core::can::{Frame, Id, Outcome, Payload};
use tokio::fs::File;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader};
use tokio::time::Instant;

use super::{Link, LinkError, Port};
use crate::bytes::{Line, hex, hex_bytes};

/// A log that is replayed once.
#[derive(Clone, Debug)]
pub struct Candump {
    path: PathBuf,
    interface: Option<String>,
    speed: f64,
}

impl Candump {
    /// The log in this file.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), interface: None, speed: 1.0 }
    }

    /// Only what the log has of this interface, such as `can0`.
    pub fn interface(self, interface: impl Into<String>) -> Self {
        Self { interface: Some(interface.into()), ..self }
    }

    /// So many times as fast as it was; a factor that is no positive number is taken for 1.
    pub fn speed(self, factor: f64) -> Self {
        Self { speed: if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }, ..self }
    }

    fn failed(&self, what: &str, error: &std::io::Error) -> LinkError {
        LinkError::last(format!("log {}: {what}: {error}", self.path.display()))
    }

    async fn replay(&self, file: File, port: &Port) -> LinkError {
        let name = self.path.display();
        let mut reader = BufReader::new(file);
        let mut first = None;
        loop {
            let mut line = Vec::new();
            // A line that is longer is read in pieces, which mean nothing.
            match (&mut reader).take(LONGEST_LINE).read_until(b'\n', &mut line).await {
                Ok(0) => return LinkError::last(format!("log {name}: replayed to its end")),
                Ok(_) => {}
                Err(error) => return self.failed("cannot be read", &error),
            }
            let line = line.trim_ascii();
            if line.is_empty() {
                continue;
            }
            let Some(entry) = Entry::parse(line) else {
                port.malformed();
                continue;
            };
            if self.interface.as_ref().is_some_and(|wanted| wanted.as_bytes() != entry.interface) {
                continue;
            }
            let &mut (start, origin) = first.get_or_insert((Instant::now(), entry.at));
            let since = entry.at.saturating_sub(origin).div_f64(self.speed);
            tokio::time::sleep_until(start + since).await;
            match entry.line {
                Line::Frame(frame) => port.received(&frame),
                _ => port.foreign(),
            }
        }
    }
}

impl Link for Candump {
    async fn run(&mut self, port: &Port) -> LinkError {
        let file = match File::open(&self.path).await {
            Ok(file) => file,
            Err(error) => return self.failed("cannot be opened", &error),
        };
        port.connected();
        let swallow = async {
            loop {
                let (mailbox, _) = port.next_frame().await;
                port.unsent();
                port.conclude(mailbox, Outcome::Sent);
            }
        };
        let ended = {
            let mut swallow = std::pin::pin!(swallow);
            tokio::select! {
                error = self.replay(file, port) => error,
                () = &mut swallow => LinkError::last("the log has ended"),
            }
        };
        tracing::info!("{ended}");
        // The node goes on without a bus.
        loop {
            let (mailbox, _) = port.next_frame().await;
            port.unsent();
            port.conclude(mailbox, Outcome::Sent);
        }
    }
}

/// A line of a log.
#[derive(PartialEq, Eq, Debug)]
struct Entry<'l> {
    at: Duration,
    interface: &'l [u8],
    line: Line,
}

impl<'l> Entry<'l> {
    fn parse(line: &'l [u8]) -> Option<Self> {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let at = stamp(words.next()?)?;
        let interface = words.next()?;
        let line = frame(words.next()?)?;
        // candump can append the direction.
        matches!(words.next(), None | Some(b"R" | b"T")).then_some(Self { at, interface, line })
    }
}

/// `(seconds.microseconds)`
fn stamp(word: &[u8]) -> Option<Duration> {
    let text = std::str::from_utf8(word.strip_prefix(b"(")?.strip_suffix(b")")?).ok()?;
    let (seconds, fraction) = text.split_once('.')?;
    let digits =
        |text: &str| (!text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())).then_some(());
    digits(seconds).and(digits(fraction))?;
    let nanoseconds: u32 = format!("{fraction:0<9}").get(..9)?.parse().ok()?;
    // Longer ones would be no instants of the runtime.
    let seconds: u64 = seconds.parse().ok().filter(|seconds| *seconds < 1 << 40)?;
    Some(Duration::new(seconds, nanoseconds))
}

fn frame(word: &[u8]) -> Option<Line> {
    let at = word.iter().position(|byte| *byte == b'#')?;
    let (id, data) = (&word[..at], &word[at + 1..]);
    let raw = hex(id)?;
    let payload = || Payload::new(&hex_bytes(data.get(..16).unwrap_or(data))?);
    match (id.len(), data) {
        // CAN FD, and remote frames.
        (_, [b'#' | b'R', ..]) | (3, _) => Some(Line::Foreign),
        // An error frame.
        (8, _) if raw >= 1 << 29 => Some(Line::Foreign),
        (8, _) => Some(Line::Frame(Frame::new(Id::from_raw(raw)?, payload()?))),
        _ => None,
    }
}

const LONGEST_LINE: u64 = 256;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_as_candump_writes_them() {
        let entry = Entry::parse(b"(1.000128) can0 1F5FC004#1122").unwrap();
        assert_eq!((entry.at, entry.interface), (Duration::from_micros(1_000_128), &b"can0"[..]));
        let id = Id::from_raw(0x1F5F_C004).unwrap();
        assert_eq!(entry.line, Line::Frame(Frame::new(id, Payload::new(&[0x11, 0x22]).unwrap())));
        let line = |text: &[u8]| Entry::parse(text).map(|entry| entry.line);
        assert_eq!(
            line(b"(1.0) can0 00000001#"),
            Some(Line::Frame(Frame::new(Id::from_raw(1).unwrap(), Payload::EMPTY)))
        );
        for foreign in [
            &b"(1.0) can0 123#11"[..],
            b"(1.0) can0 20000008#0000080A00000000",
            b"(1.0) can0 1F5FC004#R2",
            b"(1.0) can0 1F5FC004##100",
        ] {
            assert_eq!(line(foreign), Some(Line::Foreign), "{}", String::from_utf8_lossy(foreign));
        }
        for bad in [
            &b"hello"[..],
            b"(1) can0 1F5FC004#",
            b"(1.0) can0 1F5FC004",
            b"(1.0) can0 1F5FC004#1",
            b"(-1.0) can0 00000001#",
        ] {
            assert_eq!(Entry::parse(bad), None, "{}", String::from_utf8_lossy(bad));
        }
    }

    proptest! {
        #[test]
        fn any_line_is_taken(line in proptest::collection::vec(any::<u8>(), 0..100)) {
            Entry::parse(&line);
        }

        #[test]
        fn any_stamp_is_taken(line in "\\([0-9.]{0,30}\\) c [0-9A-F]{8}#[0-9A-F]{0,20}") {
            Entry::parse(line.as_bytes());
        }
    }
}
