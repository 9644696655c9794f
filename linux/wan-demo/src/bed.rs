//! What runs: two emulated segments, their gateways, what stands between these.

use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::Path;
use std::process::Command;
use std::time::Duration as Span;

use cosmic_gateway::config::{Ip, Mode};
use cosmic_gateway::ip;
use cosmic_page::Hub;

use crate::between::Between;
use crate::channels::{CHANNELS, COMMAND_ETAG, GATEWAYS_ETAG};
use crate::failed::{Failed, PATIENCE, name};
use crate::gateway::{Process, Status};
use crate::ground::Ground;
use crate::served::{Material, Served};

/// All of it.
pub struct Bed {
    _folder: tempfile::TempDir,
    /// Sensor, brake and diagnostics.
    pub west: Served,
    /// Another brake.
    pub east: Served,
    of_west: Process,
    of_east: Process,
    /// What stands between the gateways.
    pub between: Between,
    /// A node on IP, at the gateway of the west.
    pub desk: ip::Node,
    /// Where the gateway of the west listens on the loopback interface.
    port: u16,
}

impl Bed {
    /// Starts it, and waits until the gateways speak for their segments and know each other. If it is `watched`, they tell of
    /// each event.
    ///
    /// # Errors
    /// [`Failed`]
    pub async fn start(
        ground: &Ground,
        material: Material<'_>,
        delay: Span,
        watched: bool,
    ) -> Result<Self, Failed> {
        let failed = |what: String| Failed(what);
        let folder = tempfile::tempdir().map_err(|error| failed(format!("no folder: {error}")))?;
        let west = Served::start("west", folder.path(), material, &["sensor", "brake", "diagnostics"])?;
        let east = Served::start("east", folder.path(), material, &["brake"])?;
        let program = std::env::current_exe();
        let program = program.map_err(|error| failed(format!("where am I? {error}")))?;
        let files = ["west.toml", "east.toml"].map(|file| folder.path().join(file));
        let mut of_west = Process::start(Command::new(&program), "west", &files[0], watched)?;
        let mut of_east = Process::start(ground.far(&program), "east", &files[1], watched)?;
        let port = free_port()?;
        let between = Between::lay(ground, delay, port, of_east.id()).await?;
        let listens: Vec<_> =
            between.listens().into_iter().map(|address| SocketAddr::new(address, port)).collect();
        write(&files[0], &config(&west, material.cluster, &listens, None))?;
        of_west.begin()?;
        // In a namespace of its own every port is free.
        let listens = [SocketAddr::new(between.far(), free_port()?)];
        write(&files[1], &config(&east, material.cluster, &listens, Some(between.near())))?;
        of_east.begin()?;
        let ip = Ip { mode: Mode::Peer, connect: vec![format!("tcp/127.0.0.1:{port}")], ..Ip::default() };
        let desk = ip::Node::start(&ip, &name("test")?, &name("desk")?).await;
        let desk = desk.map_err(|error| failed(error.to_string()))?;
        let mut bed = Self { _folder: folder, west, east, of_west, of_east, between, desk, port };
        bed.settled().await?;
        Ok(bed)
    }

    async fn settled(&mut self) -> Result<(), Failed> {
        let is_settled = |status: Status| status.leads && status.known >= 2;
        let begun = tokio::time::Instant::now();
        while !(is_settled(self.of_west.status()?)
            && is_settled(self.of_east.status()?)
            && self.desk.others().1 >= 2)
        {
            if begun.elapsed() > PATIENCE {
                let patience = PATIENCE.as_secs();
                return Err(Failed(format!("the gateways did not find each other within {patience} s")));
            }
            tokio::time::sleep(Span::from_millis(20)).await;
        }
        Ok(())
    }

    /// Tells a page what crosses, from now on.
    pub fn watch(&self, hub: &Hub) {
        [&self.of_west, &self.of_east].into_iter().for_each(|process| process.watch(hub));
    }

    /// How `cosmic` reaches what crosses, in its words.
    pub fn link_on_ip(&self) -> String {
        format!("zenoh:tcp/127.0.0.1:{} --network test", self.port)
    }

    /// How the gateway of the east is.
    ///
    /// # Errors
    /// It has ended.
    pub fn status_of_east(&mut self) -> Result<Status, Failed> {
        self.of_east.status()
    }

    /// What became of events at the gateways until now.
    ///
    /// # Errors
    /// One has ended.
    pub async fn outcomes(&mut self) -> Result<Vec<(String, u64)>, Failed> {
        let mut all = Vec::new();
        for process in [&mut self.of_west, &mut self.of_east] {
            // What it tells next but one, it looks at from now on.
            let enough = process.status()?.told + 2;
            while process.status()?.told < enough {
                tokio::time::sleep(Span::from_millis(10)).await;
            }
            all.extend(process.status()?.outcomes);
        }
        Ok(all)
    }
}

fn write(file: &Path, text: &str) -> Result<(), Failed> {
    std::fs::write(file, text)
        .map_err(|error| Failed(format!("{} cannot be written: {error}", file.display())))
}

fn free_port() -> Result<u16, Failed> {
    let listener = TcpListener::bind((IpAddr::from([127, 0, 0, 1]), 0));
    let port = listener.and_then(|listener| Ok(listener.local_addr()?.port()));
    port.map_err(|error| Failed(format!("no port is free: {error}")))
}

fn config(segment: &Served, cluster: &Path, listen: &[SocketAddr], connect: Option<SocketAddr>) -> String {
    let endpoints = |all: &mut dyn Iterator<Item = &SocketAddr>| {
        all.map(|address| format!("\"tcp/{address}\"")).collect::<Vec<_>>().join(", ")
    };
    let (listen, connect) = (endpoints(&mut listen.iter()), endpoints(&mut connect.iter()));
    let (name, path) = (segment.name, segment.path.display());
    format!(
        r#"network = "test"
[ip]
listen = [{listen}]
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
    )
}
