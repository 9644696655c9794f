//! What a gateway is compared with: zenoh alone, and the link alone. Roles, as those of gateways.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration as Span;

use cosmic_core::can::Mailbox;
use cosmic_gateway::clock::Reading;
use cosmic_linux::link::segment::Record;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::UnixStream;
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};

use crate::child::{self, Child};
use crate::cost::Cost;
use crate::failed::Failed;

/// zenoh alone: one process puts, the other subscribes. As gateways they are routers, joined by TCP.
pub struct Zenoh {
    hears: Child,
    puts: Child,
}

impl Zenoh {
    /// Starts both.
    ///
    /// # Errors
    /// A session cannot be had.
    pub fn start(port: u16) -> Result<Self, Failed> {
        let port = port.to_string();
        Ok(Self {
            hears: Child::start(HEARS, std::slice::from_ref(&port))?,
            puts: Child::start(PUTS, &[port])?,
        })
    }

    /// Puts so many, one after the other: how long each took until it was heard, in nanoseconds.
    ///
    /// # Errors
    /// A process has ended.
    pub fn measure(&mut self, count: usize) -> Result<Vec<u64>, Failed> {
        self.puts.ask::<usize>(&count.to_string())?;
        // What is under way arrives.
        std::thread::sleep(Span::from_millis(20));
        self.hears.ask("take")
    }
}

/// A session of zenoh with nothing of ours, but set as ours are.
///
/// # Errors
/// zenoh refuses it.
pub fn session(mode: &str, more: &[(&str, String)]) -> Result<zenoh::Session, Failed> {
    let mut config = zenoh::Config::default();
    let settings = [
        ("mode", format!("{mode:?}")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("timestamping/enabled", "false".to_owned()),
        ("connect/timeout_ms", "-1".to_owned()),
    ];
    for (key, value) in settings.iter().chain(more) {
        config.insert_json5(key, value).map_err(Failed::at(key))?;
    }
    zenoh::open(config).wait().map_err(Failed::at("zenoh"))
}

/// The role that subscribes.
///
/// # Errors
/// No session.
pub fn hear(arguments: &[String]) -> Result<(), Failed> {
    let endpoint = format!("[\"tcp/127.0.0.1:{}\"]", port(arguments)?);
    let session = session(ROLE_IN_ZENOH, &[("listen/endpoints", endpoint)])?;
    let taken = Arc::new(Mutex::new(Vec::new()));
    let into = Arc::clone(&taken);
    let subscriber = session.declare_subscriber(KEY).callback(move |sample| {
        let now = Reading::now();
        let bytes = sample.payload().to_bytes();
        if let Some(stamp) = bytes.first_chunk::<8>() {
            let took = now.0.saturating_sub(u64::from_be_bytes(*stamp));
            into.lock().unwrap_or_else(PoisonError::into_inner).push(took);
        }
    });
    let _subscriber = subscriber.wait().map_err(Failed::at("zenoh"))?;
    child::serve(|_| Ok(std::mem::take(&mut *taken.lock().unwrap_or_else(PoisonError::into_inner))))
}

/// The role that puts.
///
/// # Errors
/// No session, or nobody subscribes.
pub fn put(arguments: &[String]) -> Result<(), Failed> {
    let endpoint = format!("[\"tcp/127.0.0.1:{}\"]", port(arguments)?);
    let session =
        session(ROLE_IN_ZENOH, &[("listen/endpoints", "[]".to_owned()), ("connect/endpoints", endpoint)])?;
    let publisher = session.declare_publisher(KEY).congestion_control(CongestionControl::Drop);
    let publisher = publisher.priority(Priority::RealTime).express(true).wait();
    let publisher = publisher.map_err(Failed::at("zenoh"))?;
    while !publisher.matching_status().wait().map_err(Failed::at("zenoh"))?.matching() {
        std::thread::sleep(Span::from_millis(10));
    }
    child::serve(|line| {
        let count: usize = line.parse().map_err(Failed::at(line))?;
        for _ in 0..count {
            std::thread::sleep(PAUSE);
            let mut bytes = vec![0; ENVELOPE];
            bytes[..8].copy_from_slice(&Reading::now().0.to_be_bytes());
            publisher.put(bytes).wait().map_err(Failed::at("zenoh"))?;
        }
        Ok(count)
    })
}

/// The role of a router of zenoh, through which others reach each other.
///
/// # Errors
/// No session.
pub fn route(arguments: &[String]) -> Result<(), Failed> {
    let endpoint = format!("[\"tcp/127.0.0.1:{}\"]", port(arguments)?);
    let _session = session(ROLE_IN_ZENOH, &[("listen/endpoints", endpoint)])?;
    child::serve(|_| Ok(Cost::now()))
}

/// The role that sends back each frame of a link, with nothing between.
///
/// # Errors
/// Nobody serves there.
pub fn echo(arguments: &[String]) -> Result<(), Failed> {
    let path = arguments.first().ok_or_else(|| Failed("no path is named".to_owned()))?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(Failed::at("no threads"))?;
    runtime.spawn(carry(Path::new(path).to_owned()));
    child::serve(|_| Ok(()))?;
    runtime.shutdown_background();
    Ok(())
}

async fn carry(path: std::path::PathBuf) -> std::io::Result<()> {
    let mut stream = UnixStream::connect(path).await?;
    let mut bytes = [0; Record::LEN];
    loop {
        stream.read_exact(&mut bytes).await?;
        if let Some(Record::Received { frame, .. }) = Record::decode(&bytes) {
            let record = Record::Load { mailbox: Mailbox::Soft, frame };
            stream.write_all(&record.encode()).await?;
        }
    }
}

fn port(arguments: &[String]) -> Result<u16, Failed> {
    let port = arguments.first().and_then(|text| text.parse().ok());
    port.ok_or_else(|| Failed("no port is named".to_owned()))
}

/// The role of [`hear`].
pub const HEARS: &str = "zenoh-hears";
/// The role of [`put`].
pub const PUTS: &str = "zenoh-puts";
/// The role of [`route`].
pub const ROUTER: &str = "router";
/// The role of [`echo`].
pub const ECHO: &str = "link-echo";
/// Between two events.
pub const PAUSE: Span = Span::from_millis(1);
/// What gateways are to zenoh.
const ROLE_IN_ZENOH: &str = "router";
const KEY: &str = "cosmic/1/bench/event/c05abe7c00000000/west";
/// As long as an event of eight bytes is between gateways.
const ENVELOPE: usize = 56;
