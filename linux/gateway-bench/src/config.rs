//! Configurations of the gateways that are measured.

use std::fmt::Write as _;
use std::net::TcpListener;
use std::path::{Path, PathBuf};

use cosmic_core::can::Etag;

use crate::failed::Failed;

/// The gateway of some segments.
#[derive(Clone, Debug)]
pub struct Setup<'a> {
    /// What it is to zenoh: `router` or `client`.
    pub mode: &'a str,
    /// The port of 127.0.0.1 where it listens.
    pub listen: Option<u16>,
    /// The port that it connects to.
    pub connect: Option<u16>,
    /// Its segments: name, and where the wire is.
    pub segments: &'a [(String, PathBuf)],
    /// Its channels.
    pub channels: &'a [Channel],
}

/// A channel between segments.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Which one: subject and etag follow from it.
    pub number: u16,
    /// The segments that it may leave; all if it is empty.
    pub from: Vec<String>,
    /// The segments that it may enter; all if it is empty.
    pub to: Vec<String>,
    /// The segments that it enters, whether anybody there says so or not.
    pub unasked: Vec<String>,
}

impl Channel {
    /// From one segment to another.
    pub fn between(number: u16, from: &str, to: &str) -> Self {
        let (from, to) = (vec![from.to_owned()], vec![to.to_owned()]);
        Self { number, from, unasked: to.clone(), to }
    }
}

impl Setup<'_> {
    /// Writes it into a folder, under this name.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, folder: &Path, name: &str) -> Result<PathBuf, Failed> {
        let path = folder.join(format!("{name}.toml"));
        std::fs::write(&path, self.text()).map_err(Failed::at(path.display()))?;
        Ok(path)
    }

    fn text(&self) -> String {
        let endpoint = |port: Option<u16>| port.map(|port| format!("\"tcp/127.0.0.1:{port}\""));
        let (listen, connect) = (endpoint(self.listen), endpoint(self.connect));
        let mut text = format!(
            "network = \"{NETWORK}\"\n[ip]\nmode = \"{}\"\nlisten = [{}]\nconnect = [{}]\n",
            self.mode,
            listen.unwrap_or_default(),
            connect.unwrap_or_default(),
        );
        let of_channels =
            |channel: &Channel| format!("{} = {}", name_of(channel.number), etag_of(channel.number).get());
        let etags: Vec<_> = self.channels.iter().map(of_channels).collect();
        for (name, path) in self.segments {
            let _ = write!(
                text,
                "[[segment]]\nname = \"{name}\"\nlink = \"sim:{}\"\nuid = \"0x6A7E000000000001\"\ntx-node = 100\n\
                 ceiling = 100\netags = {{ gateways = {GATEWAYS}, {} }}\n",
                path.display(),
                etags.join(", "),
            );
        }
        for Channel { number, from, to, unasked } in self.channels {
            let list = |key: &str, names: &[String]| {
                let names: Vec<_> = names.iter().map(|name| format!("\"{name}\"")).collect();
                if names.is_empty() { String::new() } else { format!("{key} = [{}]\n", names.join(", ")) }
            };
            let _ = write!(
                text,
                "[[channel]]\nname = \"{}\"\nsubject = \"{:#x}\"\nclass = \"soft\"\ndeadline = \"500 ms\"\n\
                 validity = \"1 s\"\ninterval = \"500 us\"\nburst = 20\nlongest-wait = \"10 ms\"\n{}{}{}",
                name_of(*number),
                subject_of(*number),
                list("from", from),
                list("to", to),
                list("unasked", unasked),
            );
        }
        text
    }
}

/// The etag of a channel, on all segments.
pub const fn etag_of(number: u16) -> Etag {
    match Etag::new(FIRST + number) {
        Some(etag) => etag,
        None => Etag::BOUND_LAST,
    }
}

/// The channel that has this etag, of so many.
pub fn number_of(etag: Etag, channels: usize) -> Option<usize> {
    let number = usize::from(etag.get().checked_sub(FIRST)?);
    (number < channels).then_some(number)
}

/// The subject of a channel.
pub const fn subject_of(number: u16) -> u64 {
    0xC05A_BE7C_0000_0000 + number as u64
}

fn name_of(number: u16) -> String {
    format!("channel-{number}")
}

/// A port of 127.0.0.1 that nobody listens at.
///
/// # Errors
/// There is none.
pub fn free_port() -> Result<u16, Failed> {
    let listener = TcpListener::bind("127.0.0.1:0");
    let port = listener.and_then(|listener| Ok(listener.local_addr()?.port()));
    port.map_err(Failed::at("no port is free"))
}

/// What the gateways join.
pub const NETWORK: &str = "bench";
/// The etag of the first channel.
const FIRST: u16 = 2000;
/// The etag of the gateways' beacons.
const GATEWAYS: u16 = 9000;
