//! What runs: two emulated segments, their gateways, the way between these.

use std::fmt;
use std::io::{BufRead as _, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration as Span;

use cosmic_core::NodeUid;
use cosmic_core::can::TxNode;
use cosmic_gateway::Gateway;
use cosmic_gateway::config::{Config, Ip, Mode};
use cosmic_gateway::ip;
use cosmic_gateway::keys::Name;
use cosmic_linux::link::segment::SegmentLink;
use cosmic_linux::{Node, Tap};
use cosmic_wan::Way;

/// The demo cannot be run.
#[derive(Debug)]
pub struct Failed(pub String);

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Failed {}

/// A segment of emulated nodes, served at a socket by a program of its own, which ends with it.
pub struct Served {
    /// Its name in the network.
    pub name: &'static str,
    /// Where it is served.
    pub path: PathBuf,
    server: Child,
    stood: Arc<AtomicU64>,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// What the segments are made of.
#[derive(Clone, Copy, Debug)]
pub struct Material<'a> {
    /// The program `serve-emulated`.
    pub server: &'a Path,
    /// The folder of the images.
    pub images: &'a Path,
    /// The description of the cluster.
    pub cluster: &'a Path,
}

impl Served {
    /// Starts the images of these nodes.
    ///
    /// # Errors
    /// The server cannot be started, or ends.
    pub fn start(
        name: &'static str,
        folder: &Path,
        material: Material<'_>,
        nodes: &[&str],
    ) -> Result<Self, Failed> {
        let path = folder.join(name);
        let mut command = Command::new(material.server);
        command.arg("--socket").arg(&path).arg("--images").arg(material.images).args(nodes);
        let started = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut server = started
            .map_err(|error| Failed(format!("{} cannot be started: {error}", material.server.display())))?;
        let stood = Arc::new(AtomicU64::new(0));
        if let Some(output) = server.stdout.take() {
            let stood = Arc::clone(&stood);
            std::thread::spawn(move || {
                for line in BufReader::new(output).lines().map_while(Result::ok) {
                    if let Some(span) = line.strip_prefix("stood ").and_then(|span| span.parse().ok()) {
                        stood.store(span, Ordering::Relaxed);
                    }
                }
            });
        }
        let mut served = Self { name, path, server, stood };
        let begun = std::time::Instant::now();
        while !served.path.exists() {
            if served.server.try_wait().ok().flatten().is_some() || begun.elapsed() > PATIENCE {
                return Err(Failed(format!("the segment {name} is not served; see above")));
            }
            std::thread::sleep(Span::from_millis(20));
        }
        Ok(served)
    }

    /// For how many seconds its time stood still, because this machine could not follow.
    pub fn stood(&self) -> f64 {
        self.stood.load(Ordering::Relaxed) as f64 / 1e3
    }

    /// A node on Linux.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn node(&self, tx_node: u8) -> Result<Node, Failed> {
        let wrong = || Failed("the demo gives a node no id".to_owned());
        let uid = NodeUid::new(0xC05A_0000_0000_1000 + u64::from(tx_node)).ok_or_else(wrong)?;
        let config = cosmic_linux::Config::new(uid).tx_node(TxNode::new(tx_node).ok_or_else(wrong)?);
        Node::start(config, SegmentLink::new(&self.path)).map_err(|error| Failed(error.to_string()))
    }

    /// What is on its bus.
    pub fn tap(&self) -> Tap {
        Tap::start(SegmentLink::new(&self.path))
    }
}

/// All of it.
pub struct Bed {
    _folder: tempfile::TempDir,
    /// Sensor, brake and diagnostics.
    pub west: Served,
    /// Another brake.
    pub east: Served,
    /// The gateway of the west, where the way begins.
    pub of_west: Gateway,
    /// The gateway of the east.
    pub of_east: Gateway,
    /// The way between the gateways.
    pub way: Way,
    /// A node on IP, at the gateway of the west.
    pub desk: ip::Node,
}

impl Bed {
    /// Starts it, and waits until the gateways speak for their segments and know each other.
    ///
    /// # Errors
    /// [`Failed`]
    pub async fn start(material: Material<'_>, delay: Span) -> Result<Self, Failed> {
        let failed = |what: String| Failed(what);
        let folder = tempfile::tempdir().map_err(|error| failed(format!("no folder: {error}")))?;
        let west = Served::start("west", folder.path(), material, &["sensor", "brake", "diagnostics"])?;
        let east = Served::start("east", folder.path(), material, &["brake"])?;
        let ports = [free_port()?, free_port()?];
        let of_west = gateway(&west, material.cluster, ports[0], None).await?;
        let way = Way::to(SocketAddr::from(([127, 0, 0, 1], ports[0])))
            .await
            .map_err(|error| failed(format!("no port: {error}")))?;
        way.delay(cosmic_wan::Direction::There, delay);
        way.delay(cosmic_wan::Direction::Back, delay);
        let of_east = gateway(&east, material.cluster, ports[1], Some(way.address().port())).await?;
        let ip =
            Ip { mode: Mode::Peer, connect: vec![format!("tcp/127.0.0.1:{}", ports[0])], ..Ip::default() };
        let desk = ip::Node::start(&ip, &name("test")?, &name("desk")?).await;
        let desk = desk.map_err(|error| failed(error.to_string()))?;
        let bed = Self { _folder: folder, west, east, of_west, of_east, way, desk };
        bed.settled().await?;
        Ok(bed)
    }

    async fn settled(&self) -> Result<(), Failed> {
        let settled = || -> Result<bool, Failed> {
            let speak = self.of_west.leads(&name("west")?) && self.of_east.leads(&name("east")?);
            Ok(speak
                && self.of_west.others().1 >= 2
                && self.of_east.others().1 >= 2
                && self.desk.others().1 >= 2)
        };
        let begun = tokio::time::Instant::now();
        while !settled()? {
            if begun.elapsed() > PATIENCE {
                return Err(Failed(format!(
                    "the gateways did not find each other within {} s",
                    PATIENCE.as_secs()
                )));
            }
            tokio::time::sleep(Span::from_millis(20)).await;
        }
        Ok(())
    }
}

/// The name of a segment or of the network.
///
/// # Errors
/// The text is none.
pub fn name(text: &str) -> Result<Name, Failed> {
    Name::new(text).ok_or_else(|| Failed(format!("{text:?} is no name")))
}

fn free_port() -> Result<u16, Failed> {
    let listener = std::net::TcpListener::bind("127.0.0.1:0");
    let port = listener.and_then(|listener| Ok(listener.local_addr()?.port()));
    port.map_err(|error| Failed(format!("no port is free: {error}")))
}

async fn gateway(
    segment: &Served,
    cluster: &Path,
    listen: u16,
    connect: Option<u16>,
) -> Result<Gateway, Failed> {
    let connect = connect.map(|port| format!("\"tcp/127.0.0.1:{port}\"")).unwrap_or_default();
    let (name, path) = (segment.name, segment.path.display());
    let text = format!(
        r#"network = "test"
[ip]
listen = ["tcp/127.0.0.1:{listen}"]
connect = [{connect}]
[[segment]]
name = "{name}"
link = "sim:{path}"
uid = "0x6A7E000000000001"
tx-node = 100
plan = "{}"
ceiling = 30
etags = {{ command = {COMMAND_ETAG}, ping = {}, pong = {}, gateways = {GATEWAYS_ETAG} }}
{CHANNELS}"#,
        cluster.display(),
        COMMAND_ETAG + 1,
        COMMAND_ETAG + 2,
    );
    let config = Config::parse("the demo's configuration", &text, Path::new("."));
    let config = config.map_err(|problems| Failed(problems.to_string()))?;
    Gateway::start(&config).await.map_err(|error| Failed(error.to_string()))
}

/// Of commands; those of pings and pongs come next.
pub const COMMAND_ETAG: u16 = 9000;
const GATEWAYS_ETAG: u16 = 9010;
const PATIENCE: Span = Span::from_secs(60);

/// What may cross: events of the vehicle, and those of the demo. Wheel speeds are hard real-time, and do not.
const CHANNELS: &str = r#"
[[channel]]
name = "temperature"
subject = "0xC05A1C0000000002"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "20 ms"
burst = 3
unasked = ["east"]
from = ["west"]
[[channel]]
name = "brake_force"
subject = "0xC05A1C0000000003"
class = "soft"
deadline = "100 ms"
validity = "200 ms"
interval = "10 ms"
burst = 3
unasked = ["east"]
from = ["west"]
[[channel]]
name = "command"
subject = "0xC05A1C00000000C0"
class = "soft"
deadline = "100 ms"
validity = "300 ms"
interval = "5 ms"
burst = 20
longest-wait = "5 ms"
[[channel]]
name = "ping"
subject = "0xC05A1C00000000C1"
class = "soft"
deadline = "500 ms"
validity = "1 s"
interval = "1 ms"
burst = 20
longest-wait = "5 ms"
[[channel]]
name = "pong"
subject = "0xC05A1C00000000C2"
class = "soft"
deadline = "500 ms"
validity = "1 s"
interval = "1 ms"
burst = 20
longest-wait = "5 ms"
"#;
