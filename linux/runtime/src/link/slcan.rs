//! slcan (Lawicel's ASCII protocol): a serial adapter, or a pseudo terminal.
//!
//! | line | is |
//! |---|---|
//! | `T1F5FC0048AABBCCDD00000000` | an extended data frame: eight digits of identifier, length, data |
//! | `t`, `r`, `R` | standard and remote frames: foreign |
//! | `S8` | 1 Mbit/s; `S0` to `S8` |
//! | `O`, `C` | open, close |
//! | `\r`, `z\r`, `Z\r`, BEL | the adapter's answers |
//!
//! Each line ends with a carriage return. Many adapters do not answer, and nothing in the protocol says that a frame was
//! sent. So the link hands over one frame at a time, and takes it for sent when the longest frame of its length would
//! be over. The frame that waits in the adapter cannot be withdrawn: an urgent one waits for it, and for as long as the
//! bus keeps the adapter from sending it. That is the inversion that remains.

use std::os::fd::OwnedFd;
use std::path::PathBuf;

use cosmic_core::can::{BitRate, Frame, Id, Outcome, Payload};
use rustix::termios::{self, OptionalActions};
use tokio::fs::OpenOptions;
use tokio::io::unix::AsyncFd;

use super::{Link, LinkError, Port, time_on_the_bus};
use crate::bytes::{Line, Splitter, hex, hex_bytes};
use crate::descriptor::watched;

/// An adapter on a serial device.
#[derive(Clone, Debug)]
pub struct Slcan {
    device: PathBuf,
    bit_rate: BitRate,
}

impl Slcan {
    /// The adapter at this device, which it sets to this bit rate: one of 10, 20, 50, 100, 125, 250, 500, 800
    /// and 1000 kbit/s.
    ///
    /// # Errors
    /// The protocol knows no such bit rate.
    pub fn new(device: impl Into<PathBuf>, bit_rate: BitRate) -> Result<Self, LinkError> {
        let device = device.into();
        if setting(bit_rate).is_none() {
            let rate = bit_rate.bits_per_second();
            return Err(LinkError::last(format!(
                "slcan on {}: the protocol has no setting for {rate} bit/s: use one of {RATES:?}",
                device.display()
            )));
        }
        Ok(Self { device, bit_rate })
    }

    async fn open(&self) -> Result<AsyncFd<OwnedFd>, LinkError> {
        let name = self.device.display();
        let failed =
            |what: &str, error: std::io::Error| LinkError::new(format!("slcan on {name}: {what}: {error}"));
        let mut options = OpenOptions::new();
        options.read(true).write(true).custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK);
        let file = options.open(&self.device).await.map_err(|error| failed("cannot be opened", error))?;
        let file = file.into_std().await;
        let mut attributes = termios::tcgetattr(&file)
            .map_err(|error| failed("is no serial device or pseudo terminal", error.into()))?;
        attributes.make_raw();
        termios::tcsetattr(&file, OptionalActions::Now, &attributes)
            .map_err(|error| failed("cannot be set to raw mode", error.into()))?;
        watched(file.into()).map_err(|error| failed("cannot be waited for", error))
    }

    async fn carry(&self, port: &Port) -> Result<(), LinkError> {
        let device = self.open().await?;
        let name = self.device.display();
        let lost =
            |error: std::io::Error| LinkError::new(format!("slcan on {name}: the device is gone: {error}"));
        let setting = setting(self.bit_rate).unwrap_or(b'8');
        // What was open before is closed; an answer to that means nothing.
        write_all(&device, &[b'C', END, b'S', setting, END, b'O', END]).await.map_err(lost)?;
        port.connected();
        let read = async {
            let mut lines = Splitter::<LONGEST_LINE>::default();
            let mut buffer = [0; 4096];
            loop {
                let count = read(&device, &mut buffer).await.map_err(lost)?;
                if count == 0 {
                    return Err(LinkError::new(format!("slcan on {name}: the other side has hung up")));
                }
                lines.feed(&buffer[..count], |byte| byte == END || byte == BELL, true);
                while let Some(line) = lines.next() {
                    match line.as_deref().map_or(Line::Malformed, parse) {
                        Line::Frame(frame) => port.received(&frame),
                        Line::Foreign => port.foreign(),
                        Line::Other => {}
                        Line::Malformed => port.malformed(),
                    }
                }
            }
        };
        let write = async {
            loop {
                let (mailbox, frame) = port.next_frame().await;
                write_all(&device, line(&frame).as_bytes()).await.map_err(lost)?;
                tokio::time::sleep(time_on_the_bus(&frame, self.bit_rate)).await;
                port.conclude(mailbox, Outcome::Sent);
            }
        };
        tokio::select! {
            ended = read => ended,
            ended = write => ended,
        }
    }
}

impl Link for Slcan {
    async fn run(&mut self, port: &Port) -> LinkError {
        match self.carry(port).await {
            Ok(()) => LinkError::new("slcan has ended"),
            Err(error) => error,
        }
    }
}

async fn read(device: &AsyncFd<OwnedFd>, buffer: &mut [u8]) -> std::io::Result<usize> {
    loop {
        let mut ready = device.readable().await?;
        if let Ok(read) = ready.try_io(|device| Ok(rustix::io::read(device.get_ref(), &mut *buffer)?)) {
            return read;
        }
    }
}

async fn write_all(device: &AsyncFd<OwnedFd>, mut bytes: &[u8]) -> std::io::Result<()> {
    while !bytes.is_empty() {
        let mut ready = device.writable().await?;
        if let Ok(written) = ready.try_io(|device| Ok(rustix::io::write(device.get_ref(), bytes)?)) {
            bytes = &bytes[written?.min(bytes.len())..];
        }
    }
    Ok(())
}

/// The line of a frame.
pub(crate) fn line(frame: &Frame) -> String {
    use std::fmt::Write as _;
    let mut line = format!("T{:08X}{}", frame.id.raw(), frame.payload.len());
    for byte in frame.payload.as_slice() {
        let _ = write!(line, "{byte:02X}");
    }
    line.push(char::from(END));
    line
}

/// What a line says, its end included.
pub(crate) fn parse(line: &[u8]) -> Line {
    match line {
        [END | BELL] | [b'z' | b'Z', END] => Line::Other,
        [b'T', rest @ .., END] => extended(rest).map_or(Line::Malformed, Line::Frame),
        [b't' | b'r' | b'R', .., END] => Line::Foreign,
        // Commands of another host, when two of them are connected, and answers to commands.
        [b'C' | b'O' | b'S' | b'L' | b'V' | b'N' | b'F' | b'M' | b'm' | b'Z' | b'X' | b's', .., END] => {
            Line::Other
        }
        _ => Line::Malformed,
    }
}

/// Identifier, length and data; some adapters append a time-stamp of four digits.
fn extended(rest: &[u8]) -> Option<Frame> {
    let (id, rest) = rest.split_at_checked(8)?;
    let (length, rest) = rest.split_first()?;
    let length = usize::try_from(char::from(*length).to_digit(10)?).ok()?;
    let (data, stamp) = rest.split_at_checked(2 * length)?;
    if !(stamp.is_empty() || stamp.len() == 4 && hex(stamp).is_some()) {
        return None;
    }
    Some(Frame::new(Id::from_raw(hex(id)?)?, Payload::new(&hex_bytes(data)?)?))
}

fn setting(bit_rate: BitRate) -> Option<u8> {
    let at = RATES.iter().position(|rate| *rate == bit_rate.bits_per_second())?;
    Some(b'0' + u8::try_from(at).ok()?)
}

const RATES: [u32; 9] = [10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
const END: u8 = b'\r';
const BELL: u8 = 7;
/// `T`, identifier, length, data, time-stamp, end.
const LONGEST_LINE: usize = 1 + 8 + 1 + 16 + 4 + 1;

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
        assert_eq!(line(&heat), "T1F5FC0042AA01\r");
        assert_eq!(parse(b"T1F5FC0042AA01\r"), Line::Frame(heat));
        assert_eq!(parse(b"T1f5fc0042aa0112f0\r"), Line::Frame(heat), "with a time-stamp");
        for foreign in [&b"t1232AABB\r"[..], b"R1F5FC0042\r", b"r1230\r"] {
            assert_eq!(parse(foreign), Line::Foreign);
        }
        for other in [&b"\r"[..], b"Z\r", b"z\r", &[BELL], b"O\r", b"S8\r", b"V1013\r"] {
            assert_eq!(parse(other), Line::Other);
        }
        // Too short, too long, 29 bits exceeded, no digit, length 9.
        for bad in [
            &b"T1F5FC0042AA\r"[..],
            b"T1F5FC0042AA0102\r",
            b"T2F5FC0040\r",
            b"T1F5FC00X0\r",
            b"T1F5FC0049112233445566778899\r",
            b"hello\r",
        ] {
            assert_eq!(parse(bad), Line::Malformed, "{}", String::from_utf8_lossy(bad));
        }
    }

    #[test]
    fn only_the_rates_of_the_protocol() {
        assert!(Slcan::new("/dev/ttyACM0", BitRate::MAX).is_ok());
        let error = Slcan::new("/dev/ttyACM0", BitRate::new(62_500).unwrap()).unwrap_err();
        assert!(
            error.to_string().starts_with("slcan on /dev/ttyACM0: the protocol has no setting for 62500")
        );
    }

    proptest! {
        #[test]
        fn every_frame_round_trips(id in 0_u32..1 << 29, data in proptest::collection::vec(any::<u8>(), 0..=8)) {
            let frame = frame(id, &data);
            prop_assert_eq!(parse(line(&frame).as_bytes()), Line::Frame(frame));
        }

        #[test]
        fn any_bytes_are_taken(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut lines = Splitter::<LONGEST_LINE>::default();
            lines.feed(&bytes, |byte| byte == END || byte == BELL, true);
            while let Some(line) = lines.next() {
                line.as_deref().map(parse);
            }
        }
    }
}
