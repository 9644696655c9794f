//! What a person writes behind `--link`: a bus, or a network on IP.

use std::fmt;
use std::str::FromStr;

use cosmic_linux::link::{ADDRESSES, LinkAddress};

/// What is looked at.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Choice {
    /// A segment, by a link to its bus or by a log of it.
    Bus(LinkAddress),
    /// `zenoh:tcp/HOST:PORT`: what crosses IP, at a gateway or a router.
    Ip(Endpoint),
}

/// Where a gateway or a router listens, as zenoh writes it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Endpoint(String);

impl Endpoint {
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }

    /// Both sides show certificates.
    pub(crate) fn is_secure(&self) -> bool {
        self.0.starts_with("tls/")
    }
}

impl FromStr for Endpoint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let place = text.strip_prefix("tcp/").or_else(|| text.strip_prefix("tls/"));
        let (host, port) = place.and_then(|place| place.rsplit_once(':')).unwrap_or_default();
        let is_one = !host.is_empty() && port.parse::<u16>().is_ok();
        is_one.then(|| Self(text.to_owned())).ok_or_else(|| {
            "write zenoh:tcp/HOST:PORT or zenoh:tls/HOST:PORT, where a gateway listens".to_owned()
        })
    }
}

impl FromStr for Choice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some(("zenoh", endpoint)) => endpoint.parse().map(Self::Ip),
            _ => text.parse().map(Self::Bus).map_err(|why: String| {
                // The kinds of links are those of a bus; here there is one more.
                why.replace(ADDRESSES, &format!("{ADDRESSES}; or zenoh:tcp/HOST:PORT"))
            }),
        }
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(address) => address.fmt(f),
            Self::Ip(endpoint) => write!(f, "zenoh:{}", endpoint.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bus_or_a_place_on_ip_is_read_or_refused_with_a_remedy() {
        for text in ["sim:/run/s", "can:can0", "zenoh:tcp/127.0.0.1:7447", "zenoh:tls/[::1]:7447"] {
            assert_eq!(text.parse::<Choice>().unwrap().to_string(), text);
        }
        assert!(matches!("zenoh:tls/box:1".parse(), Ok(Choice::Ip(at)) if at.is_secure()));
        for wrong in ["zenoh:", "zenoh:box:7447", "zenoh:tcp/box", "zenoh:udp/box:1", "zenoh:tcp/:1", "usb:1"]
        {
            let why = wrong.parse::<Choice>().unwrap_err();
            assert!(why.contains("zenoh:tcp/HOST:PORT"), "{why}");
        }
    }
}
