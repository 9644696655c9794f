//! pcapng with the link type of SocketCAN (227), as Wireshark reads and writes it: four bytes of identifier with three
//! flags, the length, three bytes that are zero for classical frames, the data.

use std::borrow::Cow;
use std::io::{self, Read, Write};
use std::time::Duration;

use cosmic_bus::WireFrame;
use cosmic_linux::What;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use pcap_parser::pcapng::{
    EnhancedPacketBlock, InterfaceDescriptionBlock, OptionCode, PcapNGOption, SectionHeaderBlock,
};
use pcap_parser::traits::PcapReaderIterator as _;
use pcap_parser::{Block, Linktype, PcapBlockOwned, PcapError, PcapNGReader, ToVec as _};

use super::{Entry, LogError};

pub(crate) struct Reader {
    reader: PcapNGReader<Box<dyn Read + Send>>,
    name: String,
    /// Of the present section.
    interfaces: Vec<Interface>,
}

#[derive(Clone, Copy)]
struct Interface {
    is_can: bool,
    /// Units a second.
    resolution: u64,
    /// Seconds.
    offset: i64,
}

impl Reader {
    pub(super) fn new(source: Box<dyn Read + Send>, name: String) -> Result<Self, LogError> {
        let failed = |_| LogError::new(format!("{name} is no pcapng file; record it anew"));
        let reader = PcapNGReader::new(BUFFER, source).map_err(failed)?;
        Ok(Self { reader, name, interfaces: Vec::new() })
    }

    pub(super) fn next(&mut self) -> Option<Result<Entry, LogError>> {
        loop {
            let step = match self.reader.next() {
                Ok((length, block)) => {
                    let entry = take(&block, &mut self.interfaces);
                    self.reader.consume(length);
                    entry
                }
                Err(PcapError::Eof) => return None,
                Err(PcapError::Incomplete(_)) => {
                    if self.reader.refill().is_err() {
                        return self.broken("cannot be read");
                    }
                    if self.reader.reader_exhausted() && self.is_stuck() {
                        return self.broken("is cut off");
                    }
                    continue;
                }
                Err(PcapError::UnexpectedEof) => return self.broken("is cut off"),
                Err(_) => return self.broken("has a block that makes no sense"),
            };
            match step {
                Ok(Some(entry)) => return Some(Ok(entry)),
                Ok(None) => {}
                Err(what) => return self.broken(what),
            }
        }
    }

    /// Returns whether what is left is no whole block, though nothing more comes.
    fn is_stuck(&mut self) -> bool {
        matches!(self.reader.next(), Err(PcapError::Incomplete(_)))
    }

    fn broken<T>(&self, what: &str) -> Option<Result<T, LogError>> {
        Some(Err(LogError::new(format!("{} {what}: what stands before is whole; record it anew", self.name))))
    }
}

/// The entry of a block, if it has one.
fn take(block: &PcapBlockOwned<'_>, interfaces: &mut Vec<Interface>) -> Result<Option<Entry>, &'static str> {
    let PcapBlockOwned::NG(block) = block else { return Ok(None) };
    match block {
        Block::SectionHeader(_) => interfaces.clear(),
        Block::InterfaceDescription(interface) => {
            if interfaces.len() >= MOST_INTERFACES {
                return Err("has too many interfaces");
            }
            let resolution = interface.ts_resolution().ok_or("has stamps of no known resolution")?;
            let is_can = interface.linktype == CAN;
            interfaces.push(Interface { is_can, resolution, offset: interface.if_tsoffset });
        }
        Block::EnhancedPacket(packet) => {
            let interface = interfaces.get(packet.if_id as usize).ok_or("has a packet of no interface")?;
            if !interface.is_can {
                return Err("has packets that are not of SocketCAN");
            }
            let stamp = stamp(packet, interface);
            let length = packet.caplen as usize;
            let what = packet.data.get(..length).and_then(parse).unwrap_or(What::Malformed);
            return Ok(Some(Entry { stamp, what }));
        }
        _ => {}
    }
    Ok(None)
}

fn stamp(packet: &EnhancedPacketBlock<'_>, interface: &Interface) -> Duration {
    let units = u64::from(packet.ts_high) << 32 | u64::from(packet.ts_low);
    let resolution = interface.resolution.max(1);
    let (seconds, rest) = (units / resolution, units % resolution);
    let nanoseconds = u128::from(rest) * 1_000_000_000 / u128::from(resolution);
    let seconds = seconds.saturating_add_signed(interface.offset).min(1 << 34);
    Duration::new(seconds, nanoseconds as u32)
}

fn parse(packet: &[u8]) -> Option<What> {
    let (id, rest) = packet.split_first_chunk::<4>()?;
    let (&[length, flexible, ..], data) = rest.split_first_chunk::<4>()?;
    let raw = u32::from_be_bytes(*id);
    if raw & ERROR != 0 {
        return Some(if raw & BUS_OFF != 0 { What::BusOff } else { What::Foreign(None) });
    }
    if flexible & FLEXIBLE != 0 || data.len() > 8 {
        return Some(What::Foreign(None));
    }
    let id = if raw & EXTENDED != 0 {
        Id::Extended(ExtendedId::new(raw & EXTENDED_MASK)?)
    } else {
        Id::Standard(StandardId::new(u16::try_from(raw & EXTENDED_MASK).ok()?)?)
    };
    if raw & REMOTE != 0 {
        return WireFrame::new_remote(id, length.into()).map(What::from);
    }
    WireFrame::new(id, data.get(..length.into())?).map(What::from)
}

pub(crate) struct Writer<W> {
    pub(super) out: W,
}

impl<W: Write> Writer<W> {
    pub(super) fn new(mut out: W) -> io::Result<Self> {
        let section = SectionHeaderBlock {
            block_type: 0,
            block_len1: 0,
            bom: 0,
            major_version: 1,
            minor_version: 0,
            section_len: -1,
            options: vec![option(OptionCode::ShbUserAppl, b"cosmic")],
            block_len2: 0,
        };
        let interface = InterfaceDescriptionBlock {
            block_type: 0,
            block_len1: 0,
            linktype: CAN,
            reserved: 0,
            snaplen: 0,
            options: vec![option(OptionCode::IfName, b"can0"), option(OptionCode::IfTsresol, &[9])],
            block_len2: 0,
            if_tsresol: 9,
            if_tsoffset: 0,
        };
        let [mut section, mut interface] =
            [Block::SectionHeader(section), Block::InterfaceDescription(interface)];
        for block in [&mut section, &mut interface] {
            out.write_all(&block.to_vec().map_err(io::Error::other)?)?;
        }
        Ok(Self { out })
    }

    pub(super) fn write(&mut self, stamp: Duration, frame: &WireFrame) -> io::Result<()> {
        let units = u64::try_from(stamp.as_nanos()).unwrap_or(u64::MAX);
        let flags =
            if frame.is_extended() { EXTENDED } else { 0 } | if frame.is_remote_frame() { REMOTE } else { 0 };
        let mut packet = [0; 16];
        packet[..4].copy_from_slice(&(frame.arbitration().raw_id() | flags).to_be_bytes());
        packet[4] = frame.dlc() as u8;
        packet[8..].copy_from_slice(&frame.padded_data());
        let length = 8 + frame.data().len();
        let padded = length.next_multiple_of(4);
        let mut block = EnhancedPacketBlock {
            block_type: 0,
            block_len1: 0,
            if_id: 0,
            ts_high: (units >> 32) as u32,
            ts_low: units as u32,
            caplen: length as u32,
            origlen: length as u32,
            data: &packet[..padded],
            options: Vec::new(),
            block_len2: 0,
        };
        self.out.write_all(&block.to_vec().map_err(io::Error::other)?)
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn option(code: OptionCode, value: &'static [u8]) -> PcapNGOption<'static> {
    PcapNGOption { code, len: value.len() as u16, value: Cow::Borrowed(value) }
}

/// LINKTYPE_CAN_SOCKETCAN
const CAN: Linktype = Linktype(227);
const EXTENDED: u32 = 1 << 31;
const REMOTE: u32 = 1 << 30;
const ERROR: u32 = 1 << 29;
const EXTENDED_MASK: u32 = (1 << 29) - 1;
const BUS_OFF: u32 = 0x40;
/// CAN FD.
const FLEXIBLE: u8 = 0x04;
const BUFFER: usize = 1 << 16;
const MOST_INTERFACES: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(bytes: Vec<u8>) -> Vec<Entry> {
        let mut reader = Reader::new(Box::new(io::Cursor::new(bytes)), "log".to_owned()).ok().unwrap();
        std::iter::from_fn(|| reader.next()).map_while(Result::ok).collect()
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            raw in 0_u32..1 << 29, standard: bool, remote: bool, ns in 0_u64..1 << 62,
            bytes in proptest::collection::vec(any::<u8>(), 0..=8), count in 1_usize..2_000,
        ) {
            let id = if standard { Id::Standard(StandardId::new(raw as u16 & 0x7FF).unwrap()) } else { Id::Extended(ExtendedId::new(raw).unwrap()) };
            let frame = if remote { WireFrame::new_remote(id, bytes.len()).unwrap() } else { WireFrame::new(id, &bytes).unwrap() };
            let mut writer = Writer::new(Vec::new()).unwrap();
            for _ in 0..count {
                writer.write(Duration::from_nanos(ns), &frame).unwrap();
            }
            let expected = Entry { stamp: Duration::from_nanos(ns), what: What::from(frame) };
            prop_assert_eq!(read(writer.out), vec![expected; count]);
        }

        #[test]
        fn any_bytes_end(bytes in proptest::collection::vec(any::<u8>(), 0..400), cut in 0_usize..200, at in 0_usize..120) {
            let mut writer = Writer::new(Vec::new()).unwrap();
            writer.write(Duration::from_secs(1), &WireFrame::new(StandardId::ZERO, &[1]).unwrap()).unwrap();
            let mut file = writer.out;
            file.truncate(file.len().saturating_sub(cut));
            for (place, byte) in file.iter_mut().skip(at).zip(bytes) {
                *place = byte;
            }
            if let Ok(mut reader) = Reader::new(Box::new(io::Cursor::new(file)), "log".to_owned()) {
                // An error is the last thing that is asked for.
                for _ in 0..1_000 {
                    if !matches!(reader.next(), Some(Ok(_))) {
                        return Ok(());
                    }
                }
                prop_assert!(false, "it does not end");
            }
        }
    }
}
