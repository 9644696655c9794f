//! What the command takes.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use cosmic_core::can::{BitRate, Etag, TxNode};
use cosmic_core::time::Duration;
use cosmic_core::{NodeUid, Subject};
use cosmic_linux::link::LinkAddress;
use cosmic_monitor::hexadecimal;
use cosmic_plan::units;

use crate::choice::Choice;

/// Watch, record and examine a COSMIC segment.
///
/// Most commands only listen: they take no TxNode, and the segment does not notice them. `sub`, `pub`, `broker` and
/// `serve --allow-publish` take part as a node.
#[derive(Parser, Debug)]
#[command(name = "cosmic", version, after_long_help = AFTER)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pub(crate) common: Common,
    #[command(subcommand)]
    pub(crate) command: Command,
}

const AFTER: &str = "\
Exit codes:
  0  all is well
  1  `doctor` found an error, or nothing was heard of what was asked for
  2  an option, a file or a value is wrong
  3  the segment or the network cannot be reached, or no broker answers

Colours are used on a terminal only, and not where NO_COLOR is set.";

/// What most commands take.
#[derive(Args, Clone, Debug)]
pub(crate) struct Common {
    /// How to reach the segment: sim:PATH (a simulated one), slcan:DEVICE, socketcand:HOST:PORT (or :PORT:BUS), can:INTERFACE, or
    /// log:FILE (a recorded one: candump or pcapng). Or what crosses between segments: zenoh:tcp/HOST:PORT, where a gateway
    /// listens.
    #[arg(long, short, global = true, env = "COSMIC_LINK", value_name = "LINK")]
    pub(crate) link: Option<Choice>,
    /// The file that describes the cluster: gives names, contents, deadlines and slots.
    #[arg(long, short, global = true, env = "COSMIC_CLUSTER", value_name = "FILE")]
    pub(crate) cluster: Option<PathBuf>,
    /// The bit rate, where no cluster file says it.
    #[arg(long, global = true, default_value = "1 Mbit/s", value_parser = bit_rate)]
    pub(crate) bit_rate: BitRate,
    /// For machines: one JSON value, or one on each line where there is no end.
    #[arg(long, global = true)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) ip: AcrossIp,
}

/// What links of zenoh need to know.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Across IP")]
pub(crate) struct AcrossIp {
    /// The network that the gateways join: `network` in their configuration.
    #[arg(long, global = true, env = "COSMIC_NETWORK")]
    pub(crate) network: Option<String>,
    /// As whom `sub` and `pub` take part: a name that no segment has; one is drawn if none is given.
    #[arg(long, global = true)]
    pub(crate) name: Option<String>,
    /// Who has signed the certificates of the others, for zenoh:tls/.
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) authority: Option<PathBuf>,
    /// Our own certificate.
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) certificate: Option<PathBuf>,
    /// Its key.
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) key: Option<PathBuf>,
}

/// What to do.
#[derive(Subcommand, Debug)]
pub(crate) enum Command {
    /// Lists the nodes: who they are, what they do, how they fare.
    Nodes(Listen),
    /// Lists the channels: who publishes, who subscribes, class, rate.
    Channels(Listen),
    /// Prints events as they cross the bus, without taking part.
    Echo(Echo),
    /// Subscribes to a channel as a node does, and prints its events.
    Sub(Subscribe),
    /// Publishes events as a node does.
    Pub(Publish),
    /// Measures how often events come, and how evenly.
    Hz(Measure),
    /// Measures how near events come to their deadlines, and hard ones to their slots.
    Latency(Measure),
    /// Shows the segment on the whole terminal.
    Top(Top),
    /// Serves a live page of the segment for browsers.
    Serve(Serve),
    /// Records what crosses the bus.
    Record(Record),
    /// Sends a recorded log to a segment, as it was.
    Replay(Replay),
    /// Prints a recorded log in words.
    Decode {
        /// The log, candump or pcapng; - for standard input.
        file: PathBuf,
    },
    /// Hosts the broker of the segment.
    Broker(Host),
    /// Says what is wrong with the segment, and what to do.
    Doctor(Listen),
    /// Joins segments over IP, by a configuration: docs/gateway.md has an example.
    #[cfg(feature = "ip")]
    Gateway(cosmic_gateway::program::Options),
    /// Serves a simulated segment at a socket, for links sim:PATH.
    Segment {
        /// Where.
        path: PathBuf,
    },
    /// Prints completions for a shell.
    Completions {
        /// The shell.
        shell: Shell,
    },
}

impl Command {
    /// Returns whether it looks at what --link names.
    pub(crate) const fn takes_link(&self) -> bool {
        match self {
            Self::Decode { .. } | Self::Segment { .. } | Self::Completions { .. } => false,
            #[cfg(feature = "ip")]
            Self::Gateway(_) => false,
            _ => true,
        }
    }
}

/// For how long to listen.
#[derive(Args, Clone, Debug)]
pub(crate) struct Listen {
    /// For how long to listen; a log is read to its end.
    #[arg(long = "for", default_value = "3 s", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Duration,
}

#[derive(Args, Debug)]
pub(crate) struct Measure {
    /// Channels by name, subject or etag; all if none is given.
    #[arg(value_name = "CHANNEL")]
    pub(crate) channels: Vec<String>,
    #[command(flatten)]
    pub(crate) listen: Listen,
}

#[derive(Args, Debug)]
pub(crate) struct Echo {
    /// Channels by name, subject or etag; all if none is given.
    #[arg(value_name = "CHANNEL")]
    pub(crate) channels: Vec<String>,
    /// Ends after so many.
    #[arg(long, short = 'n')]
    pub(crate) count: Option<u64>,
    /// Ends after this span.
    #[arg(long = "for", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Option<Duration>,
    /// Prints control messages, too: configuration, binding, interest, status, clock.
    #[arg(long)]
    pub(crate) control: bool,
}

/// Who this program is when it takes part.
#[derive(Args, Clone, Debug)]
pub(crate) struct Identity {
    /// The UID as which this program takes part, 16 hexadecimal digits; one is drawn if none is given. One of the cluster
    /// file brings its TxNode.
    #[arg(long, value_parser = uid)]
    pub(crate) uid: Option<NodeUid>,
    /// A fixed TxNode, where no broker gives one: 0 to 126.
    #[arg(long, value_parser = tx_node)]
    pub(crate) tx_node: Option<TxNode>,
    /// For how long to wait for the link and the broker.
    #[arg(long, default_value = "5 s", value_parser = span, value_name = "SPAN")]
    pub(crate) patience: Duration,
}

#[derive(Args, Debug)]
pub(crate) struct Subscribe {
    /// The channel, by its name in the cluster file or by its subject.
    pub(crate) channel: String,
    /// Its etag, where neither a cluster file nor a broker gives one: 1024 to 16383.
    #[arg(long, value_parser = etag)]
    pub(crate) etag: Option<Etag>,
    /// The channel carries messages of up to 1024 bytes, where no cluster file says so.
    #[arg(long)]
    pub(crate) messages: bool,
    /// Ends after so many events.
    #[arg(long, short = 'n')]
    pub(crate) count: Option<u64>,
    /// Ends after this span.
    #[arg(long = "for", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Option<Duration>,
    #[command(flatten)]
    pub(crate) identity: Identity,
}

/// A class in which this program can publish.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum, Debug)]
pub(crate) enum Class {
    /// Soft real-time.
    Srt,
    /// Non real-time.
    Nrt,
}

#[derive(Args, Debug)]
pub(crate) struct Publish {
    /// The channel, by its name in the cluster file or by its subject.
    pub(crate) channel: String,
    /// The content: field=value for each field, or bytes in hexadecimal digits: up to eight, of a message up to 1024.
    #[arg(value_name = "CONTENT")]
    pub(crate) content: Vec<String>,
    /// The etag, where neither a cluster file nor a broker gives one: 1024 to 16383.
    #[arg(long, value_parser = etag)]
    pub(crate) etag: Option<Etag>,
    /// The class, where no cluster file says it.
    #[arg(long, value_enum, default_value = "srt")]
    pub(crate) class: Class,
    /// The channel carries messages of up to 1024 bytes, where no cluster file says so. It is non real-time.
    #[arg(long)]
    pub(crate) messages: bool,
    /// By when an event is to be on the bus, from now.
    #[arg(long, value_parser = span, value_name = "SPAN")]
    pub(crate) deadline: Option<Duration>,
    /// After this span an event is discarded.
    #[arg(long, value_parser = span, value_name = "SPAN")]
    pub(crate) validity: Option<Duration>,
    /// Publishes so many times.
    #[arg(long, short = 'n', default_value_t = 1)]
    pub(crate) count: u64,
    /// The span between two events.
    #[arg(long, default_value = "1 s", value_parser = span, value_name = "SPAN")]
    pub(crate) every: Duration,
    #[command(flatten)]
    pub(crate) identity: Identity,
}

#[derive(Args, Debug)]
pub(crate) struct Top {
    /// Ends after this span.
    #[arg(long = "for", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Option<Duration>,
}

#[derive(Args, Debug)]
pub(crate) struct Serve {
    /// At which address and port; port 0 for any that is free. Only this machine reaches 127.0.0.1.
    #[arg(long, default_value = "127.0.0.1:8117", value_name = "ADDRESS:PORT")]
    pub(crate) listen: SocketAddr,
    /// A name under which browsers may ask for the page, besides addresses and localhost.
    #[arg(long = "host", value_name = "NAME")]
    pub(crate) hosts: Vec<String>,
    /// Another segment to show: its link, and behind @ its cluster file, as in sim:/run/rear@rear.toml.
    #[arg(long, value_name = "LINK[@FILE]")]
    pub(crate) also: Vec<Also>,
    /// Lets who has the token that is printed publish events on the segment of --link.
    #[arg(long)]
    pub(crate) allow_publish: bool,
    /// Ends after this span.
    #[arg(long = "for", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Option<Duration>,
    #[command(flatten)]
    pub(crate) identity: Identity,
}

/// A further segment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Also {
    pub(crate) link: LinkAddress,
    pub(crate) cluster: Option<PathBuf>,
}

impl FromStr for Also {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (link, cluster) = match text.rsplit_once('@') {
            Some((link, cluster)) => (link, Some(cluster.into())),
            None => (text, None),
        };
        Ok(Self { link: link.parse()?, cluster })
    }
}

#[derive(Args, Debug)]
pub(crate) struct Record {
    /// The log to write: pcapng if it ends in .pcapng, else as candump does; - for standard output. It grows by up to half a
    /// megabyte a second, until -n or --for ends it, or there is no room: what was written by then is whole.
    pub(crate) file: PathBuf,
    /// Ends after so many frames.
    #[arg(long, short = 'n')]
    pub(crate) count: Option<u64>,
    /// Ends after this span.
    #[arg(long = "for", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Option<Duration>,
}

#[derive(Args, Debug)]
pub(crate) struct Replay {
    /// The log, candump or pcapng; - for standard input.
    pub(crate) file: PathBuf,
    /// So many times as fast as it was; 0 for as fast as the bus takes it.
    #[arg(long, default_value_t = 1.0, value_parser = speed)]
    pub(crate) speed: f64,
    /// For how long to wait for the link.
    #[arg(long, default_value = "5 s", value_parser = span, value_name = "SPAN")]
    pub(crate) patience: Duration,
}

#[derive(Args, Debug)]
pub(crate) struct Host {
    #[command(flatten)]
    pub(crate) identity: Identity,
    /// Ends after this span.
    #[arg(long = "for", value_parser = span, value_name = "SPAN")]
    pub(crate) span: Option<Duration>,
}

fn span(text: &str) -> Result<Duration, String> {
    units::parse_span(text).ok_or_else(|| "write a number with its unit: 500ms, \"2.5 s\"".to_owned())
}

fn bit_rate(text: &str) -> Result<BitRate, String> {
    let rate = units::parse_bits_per_second(text).and_then(BitRate::new);
    rate.ok_or_else(|| "write a rate from 10 kbit/s to 1 Mbit/s: \"500 kbit/s\", 125000".to_owned())
}

fn tx_node(text: &str) -> Result<TxNode, String> {
    let node = text.parse().ok().and_then(TxNode::new).filter(|node| *node != TxNode::BROKER);
    node.ok_or_else(|| "write a number from 0 to 126".to_owned())
}

fn etag(text: &str) -> Result<Etag, String> {
    let etag = text.parse().ok().and_then(Etag::new).filter(|etag| !etag.is_reserved() && !etag.is_hard());
    etag.ok_or_else(|| "write a number from 1024 to 16383".to_owned())
}

fn uid(text: &str) -> Result<NodeUid, String> {
    hexadecimal(text)
        .and_then(NodeUid::new)
        .ok_or_else(|| "write up to 16 hexadecimal digits, not zero".to_owned())
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|speed: &f64| speed.is_finite() && *speed >= 0.0);
    speed.ok_or_else(|| "write a number: 1, 0.5, or 0 for as fast as it goes".to_owned())
}

/// A subject as a person writes it.
pub(crate) fn subject(text: &str) -> Option<Subject> {
    let is_subject = text.starts_with("0x") || text.len() == 16;
    hexadecimal(text).filter(|_| is_subject).and_then(Subject::new)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_is_well_formed() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn another_segment_is_a_link_and_its_file() {
        let link = |text: &str| text.parse::<LinkAddress>();
        let also = "sim:/run/rear@rear.toml".parse();
        assert_eq!(
            also,
            Ok(Also { link: link("sim:/run/rear").unwrap(), cluster: Some("rear.toml".into()) })
        );
        assert_eq!("can:can1".parse(), Ok(Also { link: link("can:can1").unwrap(), cluster: None }));
        assert!("can0@rear.toml".parse::<Also>().is_err());
    }

    #[test]
    fn values_are_read_or_refused_with_a_remedy() {
        assert_eq!(span("250 ms"), Ok(Duration::from_millis(250)));
        assert!(span("5").is_err());
        assert_eq!(bit_rate("500 kbit/s").map(BitRate::bits_per_second), Ok(500_000));
        assert!(
            bit_rate("5").is_err() && tx_node("127").is_err() && uid("0").is_err() && speed("-1").is_err()
        );
        assert_eq!(subject("0x2A"), Subject::new(0x2A));
        assert_eq!(subject("42"), None, "that is an etag");
        assert_eq!((subject("0x+5"), subject("0x0x5"), uid("+5").ok()), (None, None, None));
    }
}
