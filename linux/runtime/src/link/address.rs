//! Links by the words of a person: `sim:PATH`, `can:INTERFACE` and so on.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use cosmic_core::can::BitRate;

use super::candump::Candump;
use super::segment::SegmentLink;
use super::slcan::Slcan;
use super::socketcan::SocketCan;
use super::socketcand::Socketcand;
use super::{Link, LinkError, Port};

/// What a person writes to name a link.
///
/// ```
/// use cosmic_linux::link::LinkAddress;
///
/// let address: LinkAddress = "socketcand:box:29536".parse().unwrap();
/// assert_eq!(address.to_string(), "socketcand:box:29536:can0");
/// ```
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum LinkAddress {
    /// `sim:PATH`: a simulated or emulated segment, served at a Unix socket.
    Sim(PathBuf),
    /// `slcan:DEVICE`: an adapter on a serial device.
    Slcan(PathBuf),
    /// `socketcand:HOST:PORT[:BUS]`: a bus that a socketcand serves.
    Socketcand {
        /// Host and port.
        address: String,
        /// The bus.
        bus: String,
    },
    /// `can:INTERFACE`: an interface of SocketCAN.
    Can(String),
    /// `log:FILE`: a log, which is listened to only.
    Log(PathBuf),
}

/// What can be written, for messages and helps.
pub const ADDRESSES: &str = "sim:PATH, slcan:DEVICE, socketcand:HOST:PORT[:BUS], can:INTERFACE or log:FILE";

impl FromStr for LinkAddress {
    /// What is wrong, and what to write.
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, rest) =
            text.split_once(':').ok_or_else(|| format!("no kind of link: write {ADDRESSES}"))?;
        if rest.is_empty() {
            return Err(format!("nothing stands behind the colon: write {ADDRESSES}"));
        }
        match kind {
            "sim" => Ok(Self::Sim(rest.into())),
            "slcan" => Ok(Self::Slcan(rest.into())),
            "can" => Ok(Self::Can(rest.to_owned())),
            "log" => Ok(Self::Log(rest.into())),
            "socketcand" => {
                let wrong = || "write socketcand:HOST:PORT, or socketcand:HOST:PORT:BUS".to_owned();
                let (host, rest) = rest.split_once(':').ok_or_else(wrong)?;
                let (port, bus) = rest.split_once(':').unwrap_or((rest, "can0"));
                port.parse::<u16>().map_err(|_| wrong())?;
                Ok(Self::Socketcand { address: format!("{host}:{port}"), bus: bus.to_owned() })
            }
            other => Err(format!("there is no link of kind {other:?}: write {ADDRESSES}")),
        }
    }
}

impl fmt::Display for LinkAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim(path) => write!(f, "sim:{}", path.display()),
            Self::Slcan(device) => write!(f, "slcan:{}", device.display()),
            Self::Socketcand { address, bus } => write!(f, "socketcand:{address}:{bus}"),
            Self::Can(interface) => write!(f, "can:{interface}"),
            Self::Log(file) => write!(f, "log:{}", file.display()),
        }
    }
}

impl LinkAddress {
    /// The link, at this bit rate if it sets one.
    ///
    /// # Errors
    /// An adapter for slcan has no such bit rate; the text says which it has.
    pub fn link(&self, bit_rate: BitRate) -> Result<AnyLink, String> {
        Ok(AnyLink(match self.clone() {
            Self::Sim(path) => Kind::Segment(SegmentLink::new(path)),
            Self::Slcan(device) => Kind::Slcan(Slcan::new(device, bit_rate).map_err(|why| why.to_string())?),
            Self::Socketcand { address, bus } => Kind::Socketcand(Socketcand::new(address, bus, bit_rate)),
            Self::Can(interface) => Kind::SocketCan(SocketCan::new(interface)),
            Self::Log(file) => Kind::Log(Candump::new(file)),
        }))
    }
}

/// A link of any kind.
pub struct AnyLink(Kind);

enum Kind {
    Segment(SegmentLink),
    Slcan(Slcan),
    Socketcand(Socketcand),
    SocketCan(SocketCan),
    Log(Candump),
}

impl Link for AnyLink {
    async fn run(&mut self, port: &Port) -> LinkError {
        match &mut self.0 {
            Kind::Segment(link) => link.run(port).await,
            Kind::Slcan(link) => link.run(port).await,
            Kind::Socketcand(link) => link.run(port).await,
            Kind::SocketCan(link) => link.run(port).await,
            Kind::Log(link) => link.run(port).await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_read_or_refused_with_a_remedy() {
        let link = |text: &str| text.parse::<LinkAddress>();
        assert_eq!(link("sim:/run/s"), Ok(LinkAddress::Sim("/run/s".into())));
        let (address, bus) = ("box:29536".to_owned(), "can1".to_owned());
        assert_eq!(link("socketcand:box:29536:can1"), Ok(LinkAddress::Socketcand { address, bus }));
        for text in ["sim:/run/s", "slcan:/dev/ttyACM0", "socketcand:box:1:can0", "can:vcan0", "log:a.log"] {
            assert_eq!(link(text).unwrap().to_string(), text);
        }
        for wrong in ["can0", "usb:1", "socketcand:box", "socketcand:box:x", "log:"] {
            let why = link(wrong).unwrap_err();
            assert!(why.contains("write "), "{why}");
        }
        let why = link("slcan:/dev/null").unwrap().link(BitRate::new(62_500).unwrap()).err().unwrap();
        assert!(why.contains("62500"), "{why}");
    }
}
