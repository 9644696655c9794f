//! Emulated segments, served by a program of their own.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration as Span;

use cosmic_core::NodeUid;
use cosmic_core::can::TxNode;
use cosmic_linux::link::segment::SegmentLink;
use cosmic_linux::{Node, Tap};

use crate::failed::{Failed, PATIENCE};

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

    /// How `cosmic` reaches it, in its words.
    pub fn link(&self) -> String {
        format!("sim:{}", self.path.display())
    }

    /// What is on its bus.
    pub fn tap(&self) -> Tap {
        Tap::start(SegmentLink::new(&self.path))
    }
}
