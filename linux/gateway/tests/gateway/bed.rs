//! Segments on sockets, gateways between them, and a stranger on IP. In real time: zenoh knows no other.

use std::net::TcpListener;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration as Span;

use cosmic_bus::{Bus, FaultModel};
use cosmic_core::can::{BitRate, Etag, Frame, TxNode};
use cosmic_core::event_layer::{Channel, Depth, Policy, SoftAttributes};
use cosmic_core::protocol::{Class, LayoutHash};
use cosmic_core::time::{Duration, Instant};
use cosmic_core::{NodeUid, Subject};
use cosmic_gateway::Gateway;
use cosmic_gateway::clock::Reading;
use cosmic_gateway::config::Config;
use cosmic_gateway::counters::{Direction, Outcome};
use cosmic_gateway::encoding::{Envelope, Sender};
use cosmic_gateway::keys::{Keys, Name, SenderKey};
use cosmic_linux::link::segment::{Options, SegmentLink, SimulatedSegment, serve};
use cosmic_linux::{Node, Tap, What};
use cosmic_wan::Way;
use tokio::task::JoinHandle;
use zenoh::Session;
use zenoh::query::Queryable;

/// What waits bound hangs only.
pub(crate) const PATIENCE: Span = Span::from_secs(60);

pub(crate) const HEAT: Channel<i16> = Channel::soft(
    Subject::new(0xC05A_0000_0000_0001).unwrap(),
    SoftAttributes { deadline: Duration::from_millis(500), validity: Duration::from_millis(1000) },
);
/// What the configurations below say of it.
pub(crate) const HEAT_TABLE: &str = r#"
[[channel]]
name = "heat"
subject = "0xC05A000000000001"
class = "soft"
deadline = "500 ms"
validity = "1 s"
interval = "1 ms"
burst = 20
longest-wait = "10 ms"
"#;

pub(crate) fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

/// A segment on a socket.
pub(crate) struct Segment {
    _folder: tempfile::TempDir,
    pub(crate) path: PathBuf,
    server: JoinHandle<()>,
}

impl Drop for Segment {
    fn drop(&mut self) {
        self.server.abort();
    }
}

impl Segment {
    pub(crate) async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segment");
        let served = path.clone();
        let server = tokio::spawn(async move {
            let segment = SimulatedSegment::new(Bus::new(BitRate::MAX, FaultModel::none()));
            let Err(why) = serve(&served, segment, Options::default()).await;
            panic!("{why}");
        });
        let segment = Self { _folder: folder, path, server };
        until("the segment is served", || segment.path.exists()).await;
        segment
    }

    /// A node with this number, which is its TxNode.
    pub(crate) fn node(&self, number: u8) -> Node {
        let uid = NodeUid::new(number.into()).unwrap();
        let config = cosmic_linux::Config::new(uid).tx_node(TxNode::new(number).unwrap());
        Node::start(config, SegmentLink::new(&self.path)).unwrap()
    }

    /// Hears all from now on.
    pub(crate) async fn tap(&self) -> Tap {
        let tap = Tap::start(SegmentLink::new(&self.path));
        while tap.next().await.what != What::Connected {}
        tap
    }
}

/// The events' frames that a tap has heard so far.
pub(crate) fn frames(tap: &Tap) -> Vec<Frame> {
    frames_at(tap).into_iter().map(|(_, frame)| frame).collect()
}

/// And when, by the tap's clock.
pub(crate) fn frames_at(tap: &Tap) -> Vec<(Instant, Frame)> {
    let frame = |tapped: cosmic_linux::Tapped| match tapped.what {
        What::Frame(frame) => Some((tapped.at, frame)),
        _ => None,
    };
    let all = std::iter::from_fn(|| tap.try_next()).filter_map(frame);
    all.filter(|(_, frame)| !frame.id.etag().is_reserved()).collect()
}

/// Those with this etag.
pub(crate) fn with_etag(frames: &[Frame], etag: Etag) -> Vec<Frame> {
    frames.iter().copied().filter(|frame| frame.id.etag() == etag).collect()
}

/// A port that nobody listens at.
pub(crate) fn port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A gateway of one segment of 127.0.0.1.
pub(crate) struct Setup<'a> {
    pub(crate) segment: &'a str,
    pub(crate) bus: &'a Segment,
    pub(crate) tx_node: u8,
    pub(crate) listen: u16,
    pub(crate) connect: &'a [u16],
    /// Lines of the segment's table.
    pub(crate) more: &'a str,
    pub(crate) channels: &'a str,
}

impl Setup<'_> {
    pub(crate) fn text(&self) -> String {
        let Self { segment, tx_node, listen, more, channels, .. } = self;
        let connect: Vec<_> = self.connect.iter().map(|port| format!("tcp/127.0.0.1:{port}")).collect();
        let path = self.bus.path.display();
        format!(
            r#"
network = "test"
[ip]
listen = ["tcp/127.0.0.1:{listen}"]
connect = {connect:?}
[[segment]]
name = "{segment}"
link = "sim:{path}"
uid = "0x6A7E{tx_node:04X}"
tx-node = {tx_node}
{more}
{channels}
"#
        )
    }

    pub(crate) async fn start(&self) -> Gateway {
        let config = Config::parse("test.toml", &self.text(), std::path::Path::new(".")).unwrap();
        Gateway::start(&config).await.unwrap()
    }
}

/// Two segments, west and east, with a gateway each, and a way between them. East connects to west.
pub(crate) struct Pair {
    pub(crate) west: Segment,
    pub(crate) east: Segment,
    pub(crate) of_west: Gateway,
    pub(crate) of_east: Gateway,
    pub(crate) way: Way,
}

impl Pair {
    /// With lines of the table of each segment. Both gateways have the same UID and TxNode, each on its bus.
    pub(crate) async fn start(channels: &str, [of_west, of_east]: [&str; 2]) -> Self {
        let (west, east) = (Segment::start().await, Segment::start().await);
        let (tx_node, listen) = (100, port());
        let setup =
            Setup { segment: "west", bus: &west, tx_node, listen, connect: &[], more: of_west, channels };
        let of_west = setup.start().await;
        let way = Way::to(([127, 0, 0, 1], listen).into()).await.unwrap();
        let (listen, connect) = (port(), &[way.address().port()]);
        let setup = Setup { segment: "east", bus: &east, tx_node, listen, connect, more: of_east, channels };
        let of_east = setup.start().await;
        settled(&[(&of_west, "west"), (&of_east, "east")]).await;
        Self { west, east, of_west, of_east, way }
    }
}

/// A program that does not outlive its test.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        Self(command.spawn().unwrap())
    }

    /// SIGKILL.
    pub(crate) fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// Waits until it is so.
pub(crate) async fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = tokio::time::Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < PATIENCE, "in vain: {what}");
        tokio::time::sleep(Span::from_millis(5)).await;
    }
}

/// Waits until the gateways speak for their segments, and know each other's clocks.
pub(crate) async fn settled(gateways: &[(&Gateway, &str)]) {
    for (gateway, segment) in gateways {
        until("it leads", || gateway.leads(&name(segment))).await;
        until("it knows the others", || gateway.others().1 + 1 >= gateways.len()).await;
    }
}

pub(crate) fn count(gateway: &Gateway, segment: &str, direction: Direction, outcome: Outcome) -> u64 {
    gateway.counters(&name(segment), direction).unwrap().get(outcome)
}

pub(crate) fn fifo(depth: u8) -> Policy {
    Policy::Fifo(Depth::new(depth).unwrap())
}

/// A participant on IP that writes its envelopes by hand.
pub(crate) struct Stranger {
    pub(crate) session: Session,
    pub(crate) keys: Keys,
    pub(crate) segment: Name,
    pub(crate) sender: Sender,
    /// In nanoseconds: how far its clock is ahead of the kernel's.
    pub(crate) ahead: Arc<AtomicI64>,
    _clock: Queryable<()>,
    _token: zenoh::liveliness::LivelinessToken,
}

impl Stranger {
    /// One that claims to speak for a segment.
    pub(crate) async fn start(port: u16, segment: &str) -> Self {
        Self::with(port, segment, &[]).await
    }

    pub(crate) async fn with(port: u16, segment: &str, settings: &[(&str, String)]) -> Self {
        let mut config = zenoh::Config::default();
        let protocol = if settings.is_empty() { "tcp" } else { "tls" };
        for (key, value) in [
            ("mode", "\"peer\"".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
            ("listen/endpoints", "[]".to_owned()),
            ("connect/endpoints", format!("[\"{protocol}/127.0.0.1:{port}\"]")),
        ] {
            config.insert_json5(key, &value).unwrap();
        }
        for (key, value) in settings {
            config.insert_json5(key, value).unwrap();
        }
        let session = zenoh::open(config).await.unwrap();
        let (keys, segment, sender) = (Keys::new(&name("test")), name(segment), Sender::draw());
        let me = SenderKey { segment: segment.clone(), sender };
        let ahead = Arc::new(AtomicI64::new(0));
        let of_clock = Arc::clone(&ahead);
        let answer = move |query: zenoh::query::Query| {
            let bytes = clock_ahead(&of_clock).0.to_be_bytes();
            zenoh::Wait::wait(query.reply(query.key_expr().clone(), bytes.as_slice())).unwrap();
        };
        let clock = session.declare_queryable(keys.clock(&me)).callback(answer).await.unwrap();
        let token = session.liveliness().declare_token(keys.live(&me)).await.unwrap();
        Self { session, keys, segment, sender, ahead, _clock: clock, _token: token }
    }

    /// An event of now.
    pub(crate) fn envelope(&self, sequence: u64, content: &[u8]) -> Envelope {
        Envelope {
            class: Class::Soft,
            node: None,
            layout: LayoutHash::UNSTATED,
            sender: self.sender,
            sequence,
            sent_at: clock_ahead(&self.ahead),
            to_deadline: Some(Duration::from_millis(500)),
            to_expiry: Some(Duration::from_millis(1000)),
            content: content.to_vec(),
        }
    }

    pub(crate) async fn put(&self, subject: Subject, envelope: &Envelope) {
        self.put_bytes(&self.keys.event(subject, &self.segment), envelope.encode()).await;
    }

    pub(crate) async fn put_bytes(&self, key: &str, bytes: Vec<u8>) {
        let put = self.session.put(key, bytes);
        put.congestion_control(zenoh::qos::CongestionControl::Block).await.unwrap();
    }
}

fn clock_ahead(ahead: &AtomicI64) -> Reading {
    Reading(Reading::now().0.wrapping_add_signed(ahead.load(Ordering::Relaxed)))
}
