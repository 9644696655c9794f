//! socketcand: a bus of another machine over TCP.
//!
//! ```text
//! < hi >                                   the server greets
//! < open can0 >            < ok >
//! < rawmode >              < ok >
//! < frame 1F5FC004 23.424242 AABB >        a received frame
//! < send 1F5FC004 2 AA BB >                a frame to be sent
//! < error 5 >, < error 1F 23.424242 >      something went wrong
//! ```
//!
//! An identifier of more than three digits is an extended one. Frames that the server gets right behind `rawmode` are
//! lost in some versions of it, so they are held back for 50 ms. The protocol does not say when a frame was sent; what is
//! said of that at [slcan](super::slcan) holds here too, with what waits in the connection besides: so one frame at a
//! time.

use std::time::Duration;

use cosmic_core::can::{BitRate, Frame, Id, Outcome, Payload};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::{Link, LinkError, Port, time_on_the_bus};
use crate::bytes::{Line, Splitter, hex, hex_bytes};

/// A bus behind a socketcand server.
#[derive(Clone, Debug)]
pub struct Socketcand {
    address: String,
    bus: String,
    bit_rate: BitRate,
}

impl Socketcand {
    /// The bus with this name at the server with this address, such as `robot:29536`. The bit rate is that of the bus;
    /// the server does not tell it.
    pub fn new(address: impl Into<String>, bus: impl Into<String>, bit_rate: BitRate) -> Self {
        Self { address: address.into(), bus: bus.into(), bit_rate }
    }

    fn error(&self, what: impl std::fmt::Display) -> LinkError {
        LinkError::new(format!("socketcand at {}: {what}", self.address))
    }

    async fn carry(&self, port: &Port) -> Result<(), LinkError> {
        let connect = timeout(PATIENCE, TcpStream::connect(&self.address)).await;
        let mut stream = (connect.map_err(|_| self.error("no answer"))?)
            .map_err(|error| self.error(format_args!("cannot be reached: {error}")))?;
        stream.set_nodelay(true).map_err(|error| self.error(error))?;
        let mut lines = Splitter::<LONGEST_LINE>::default();
        self.expect(&mut stream, &mut lines, "hi", port).await?;
        for command in [format!("< open {} >", self.bus), "< rawmode >".to_owned()] {
            stream.write_all(command.as_bytes()).await.map_err(|error| self.error(error))?;
            self.expect(&mut stream, &mut lines, "ok", port).await?;
        }
        port.connected();
        let (mut from, mut to) = stream.split();
        let read = async {
            let mut buffer = [0; 4096];
            loop {
                self.take(&mut lines, port);
                let count = from.read(&mut buffer).await.map_err(|error| self.error(error))?;
                if count == 0 {
                    return Err(self.error("the server has closed the connection"));
                }
                lines.feed(&buffer[..count], is_end, true);
            }
        };
        let write = async {
            tokio::time::sleep(HOLD_BACK).await;
            loop {
                let (mailbox, frame) = port.next_frame().await;
                to.write_all(send(&frame).as_bytes()).await.map_err(|error| self.error(error))?;
                tokio::time::sleep(time_on_the_bus(&frame, self.bit_rate)).await;
                port.conclude(mailbox, Outcome::Sent);
            }
        };
        tokio::select! {
            ended = read => ended,
            ended = write => ended,
        }
    }

    fn take(&self, lines: &mut Splitter<LONGEST_LINE>, port: &Port) {
        while let Some(line) = lines.next() {
            match line.as_deref().map_or(Line::Malformed, parse) {
                Line::Frame(frame) => port.received(&frame),
                Line::Foreign => port.foreign(),
                Line::Other => {}
                Line::Malformed => port.malformed(),
            }
        }
    }

    /// Waits for the server's answer. Frames that arrive before it are taken.
    async fn expect(
        &self,
        stream: &mut TcpStream,
        lines: &mut Splitter<LONGEST_LINE>,
        answer: &str,
        port: &Port,
    ) -> Result<(), LinkError> {
        let wait = async {
            let mut buffer = [0; 1024];
            loop {
                while let Some(line) = lines.next() {
                    let line = line.unwrap_or_default();
                    match parse(&line) {
                        Line::Frame(frame) => port.received(&frame),
                        _ if words(&line).first() == Some(&answer.as_bytes()) => return Ok(()),
                        _ if words(&line).first() == Some(&&b"error"[..]) => {
                            let text = String::from_utf8_lossy(&line).into_owned();
                            return Err(self.error(format_args!(
                                "the server says `{}`: does it have a bus `{}`?",
                                text.trim(),
                                self.bus
                            )));
                        }
                        _ => {}
                    }
                }
                let count = stream.read(&mut buffer).await.map_err(|error| self.error(error))?;
                if count == 0 {
                    return Err(self.error("the server has closed the connection"));
                }
                lines.feed(&buffer[..count], is_end, true);
            }
        };
        timeout(PATIENCE, wait).await.map_err(|_| {
            self.error(format_args!(
                "no `< {answer} >` within {} s: is it a socketcand server?",
                PATIENCE.as_secs()
            ))
        })?
    }
}

impl Link for Socketcand {
    async fn run(&mut self, port: &Port) -> LinkError {
        match self.carry(port).await {
            Ok(()) => self.error("ended"),
            Err(error) => error,
        }
    }
}

fn is_end(byte: u8) -> bool {
    byte == b'>'
}

fn send(frame: &Frame) -> String {
    use std::fmt::Write as _;
    let mut text = format!("< send {:08X} {}", frame.id.raw(), frame.payload.len());
    for byte in frame.payload.as_slice() {
        let _ = write!(text, " {byte:02X}");
    }
    text.push_str(" >");
    text
}

/// The words between `<` and `>`; none if these are not there.
fn words(line: &[u8]) -> Vec<&[u8]> {
    let line = line.trim_ascii();
    let inner = line.strip_prefix(b"<").and_then(|line| line.strip_suffix(b">"));
    let words = inner.unwrap_or_default().split(u8::is_ascii_whitespace);
    words.filter(|word| !word.is_empty()).take(16).collect()
}

/// What a line says, from `<` to `>`.
fn parse(line: &[u8]) -> Line {
    match words(line).as_slice() {
        // The data of a frame stand together, or apart in some versions.
        [b"frame", id, stamp, data @ ..]
            if stamp.iter().all(|byte| byte.is_ascii_digit() || *byte == b'.') =>
        {
            let data = hex_bytes(&data.concat());
            match (hex(id), data) {
                (Some(_), Some(_)) if id.len() <= 3 => Line::Foreign,
                (Some(id), Some(data)) => {
                    let frame = Id::from_raw(id).zip(Payload::new(&data));
                    frame.map_or(Line::Malformed, |(id, payload)| Line::Frame(Frame::new(id, payload)))
                }
                _ => Line::Malformed,
            }
        }
        [b"error", ..] => Line::Foreign,
        [b"hi" | b"ok" | b"echo" | b"stat" | b"info", ..] => Line::Other,
        _ => Line::Malformed,
    }
}

/// Behind `rawmode`.
pub const HOLD_BACK: Duration = Duration::from_millis(50);
const PATIENCE: Duration = Duration::from_secs(3);
const LONGEST_LINE: usize = 128;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(id: u32, data: &[u8]) -> Frame {
        Frame::new(Id::from_raw(id).unwrap(), Payload::new(data).unwrap())
    }

    #[test]
    fn lines_as_the_protocol_has_them() {
        let heat = frame(0x1F5F_C004, &[0xAA, 1]);
        assert_eq!(send(&heat), "< send 1F5FC004 2 AA 01 >");
        assert_eq!(send(&frame(0x42, &[])), "< send 00000042 0 >", "eight digits: extended");
        assert_eq!(parse(b"< frame 1F5FC004 23.424242 AA01 >"), Line::Frame(heat));
        assert_eq!(parse(b"\n < frame 1F5FC004 23.424242 AA 01 >"), Line::Frame(heat));
        assert_eq!(parse(b"< frame 00000042 0.0 >"), Line::Frame(frame(0x42, &[])));
        assert_eq!(parse(b"< frame 042 0.0 AA >"), Line::Foreign, "three digits: standard");
        assert_eq!(parse(b"< error 1F 23.424242 >"), Line::Foreign);
        assert_eq!(parse(b"< ok >"), Line::Other);
        for bad in
            [&b"< frame 1F5FC004 23.424242 AAB >"[..], b"< frame >", b"< frame 3F5FC004 0.0 >", b"x>", b""]
        {
            assert_eq!(parse(bad), Line::Malformed, "{}", String::from_utf8_lossy(bad));
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut lines = Splitter::<LONGEST_LINE>::default();
            lines.feed(&bytes, is_end, true);
            while let Some(line) = lines.next() {
                line.as_deref().map(parse);
            }
        }

        #[test]
        fn every_frame_is_read(id in 0_u32..1 << 29, data in proptest::collection::vec(any::<u8>(), 0..=8)) {
            let digits: String = data.iter().map(|byte| format!("{byte:02X}")).collect();
            let line = format!("< frame {id:08X} 12.5 {digits} >");
            prop_assert_eq!(parse(line.as_bytes()), Line::Frame(frame(id, &data)));
        }
    }
}
