//! The configuration: one TOML, read into what can only be right.
//!
//! `docs/gateway.md` has an example that a test reads. Whatever is wrong is told with file, line, field and remedy.

mod document;

use std::collections::HashMap;
use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;

use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::event_layer::{EventRate, Importance};
use cosmic_core::protocol::Class;
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::link::LinkAddress;
use cosmic_monitor::SegmentPlan;
use cosmic_plan::document::Source;

use crate::keys::Name;
use crate::rules::{Percent, Reach};

/// All that is wrong in a configuration, one line each: file, line, column, field, what is wrong, and what to write.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Problems(String);

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Problems {}

/// What a gateway is told at its start.
#[derive(Clone, Debug)]
pub struct Config {
    /// What it joins.
    pub network: Name,
    /// How it reaches the others.
    pub ip: Ip,
    /// Where metrics are served.
    pub metrics: Option<SocketAddr>,
    /// The live page, if it is wanted.
    pub page: Option<PageConfig>,
    /// The segments.
    pub segments: Vec<SegmentConfig>,
    /// What may cross.
    pub channels: Vec<ChannelConfig>,
}

/// The live page of a gateway.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PageConfig {
    /// Where it is served.
    pub listen: SocketAddr,
    /// Names under which browsers may ask for it, besides addresses and `localhost`.
    pub hosts: Vec<String>,
}

/// How a gateway or a node on IP reaches the others.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Ip {
    /// What it is to zenoh.
    pub mode: Mode,
    /// Where it listens, as zenoh writes it: `tcp/0.0.0.0:7447`, `tls/…`.
    pub listen: Vec<String>,
    /// Whom it connects to, and again when the connection is lost.
    pub connect: Vec<String>,
    /// Certificates, for `tls/…`.
    pub tls: Option<Tls>,
    /// Who may speak for which segment: the common name of a certificate. Others may not send at all. Empty: everybody
    /// may, for all segments.
    pub peers: Vec<Peer>,
}

/// What a participant is to zenoh.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Mode {
    /// It passes on what others send through it. What gateways are.
    #[default]
    Router,
    /// It talks to those that it is connected to.
    Peer,
    /// It talks through a router.
    Client,
}

/// Certificates: both sides show one.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Tls {
    /// Who has signed the certificates that are accepted.
    pub authority: PathBuf,
    /// Our own certificate.
    pub certificate: PathBuf,
    /// Its key.
    pub key: PathBuf,
}

/// Who may speak for which segments.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Peer {
    /// The common name of its certificate.
    pub certificate: String,
    /// The segments.
    pub segments: Vec<Name>,
}

/// A segment of the gateway.
#[derive(Clone, Debug)]
pub struct SegmentConfig {
    /// Its name in the network.
    pub name: Name,
    /// How it is reached.
    pub link: LinkAddress,
    /// The long name of the gateway's node there.
    pub uid: NodeUid,
    /// Its TxNode, if that is fixed.
    pub tx_node: Option<TxNode>,
    /// The bit rate of the bus.
    pub bit_rate: BitRate,
    /// The description of its cluster.
    pub plan: Option<SegmentPlan>,
    /// What may come in, of the bus.
    pub ceiling: Percent,
    /// Where the table of the broker is kept that the gateway hosts there; `None`: it hosts none.
    pub broker: Option<PathBuf>,
    /// Fixed etags of channels, for a segment without broker.
    pub etags: HashMap<Subject, Etag>,
}

/// A channel that may cross.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ChannelConfig {
    /// What it is called in logs and metrics.
    pub name: String,
    /// Its subject.
    pub subject: Subject,
    /// Its class where it is published; a hard one is soft everywhere else.
    pub class: Class,
    /// From publication to its deadline; not for non real-time.
    pub deadline: Option<Duration>,
    /// From publication until an event is of no use any more.
    pub validity: Option<Duration>,
    /// Of a non real-time channel.
    pub importance: Importance,
    /// How often events enter a segment, at most.
    pub rate: EventRate,
    /// How long an event waits at its publisher at most, before it is sent; `None`: as long as its frame does not say
    /// otherwise.
    pub longest_wait: Option<Duration>,
    /// Of a channel of messages of several frames: their bytes, at most. `None`: its events fit into a frame.
    pub longest_message: Option<usize>,
    /// The segments that it may leave.
    pub from: Reach,
    /// The segments that it may enter.
    pub to: Reach,
    /// Segments that it enters whether anybody there says that it subscribes or not.
    pub unasked: Vec<Name>,
}

/// The channel on which the gateways of a segment tell each other that they are there.
pub const GATEWAYS: Subject = Subject::new(0xC05A_6A7E_0000_0001).unwrap();
/// What it is called in the table of etags.
pub const GATEWAYS_NAME: &str = "gateways";

impl Config {
    /// Reads a file, and the plans that it names.
    ///
    /// # Errors
    /// All that is wrong.
    pub fn read(file: &std::path::Path) -> Result<Self, Problems> {
        document::read(file)
    }

    /// As [`read`](Self::read), of a text. Relative paths are taken from `folder`.
    ///
    /// # Errors
    /// As there.
    pub fn parse(file: &str, text: &str, folder: &std::path::Path) -> Result<Self, Problems> {
        document::parse(&Source::new(file, text), folder)
    }
}
